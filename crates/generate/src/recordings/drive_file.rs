//! Recordings as safetensors files, with one array per map.

use std::collections::HashMap;
use std::path::Path;

use bytemuck::{cast_slice, pod_collect_to_vec};
use point_skeleton::error::FileError;
use point_skeleton::files::input::read_table;
use point_skeleton::files::json;
use point_skeleton::files::write_whole;
use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};

use crate::{DriveFrame, DriveInfo, TrainingClip};

const ABOUT: &str = "drive";

impl TrainingClip {
    /// Writes the recording: `color`, `boxes`, `map`, `truth` (u8 `[F, V, H, W, 3]`), `bins` (u16 `[F, V, H,
    /// W]`), `action` (f32 `[F, 3]`) and `cameras` (f32 `[F, V, 16]`). The file metadata contain
    /// [`DriveInfo`] as JSON.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), FileError> {
        use std::io::Write;
        let failed = |error: String| FileError::io("write", path)(std::io::Error::other(error));
        let (frames, views) = (self.frames.len(), self.about.cameras.len());
        let (height, width) = (self.about.recipe.size.height as usize, self.about.recipe.size.width as usize);
        let rgb = |of: fn(&DriveFrame) -> &Vec<[u8; 3]>| -> Vec<u8> {
            self.frames.iter().flat_map(|frame| of(frame).as_flattened()).copied().collect()
        };
        let bins: Vec<u16> = self.frames.iter().flat_map(|frame| &frame.bins).copied().collect();
        let action: Vec<f32> = self.frames.iter().flat_map(|frame| frame.action).collect();
        let cameras: Vec<f32> = self.frames.iter().flat_map(|f| f.cameras.as_flattened()).copied().collect();
        let images = || vec![frames, views, height, width, 3];
        let arrays: [(&str, Dtype, Vec<usize>, Vec<u8>); 7] = [
            ("action", Dtype::F32, vec![frames, 3], cast_slice(&action).to_vec()),
            ("bins", Dtype::U16, vec![frames, views, height, width], cast_slice(&bins).to_vec()),
            ("boxes", Dtype::U8, images(), rgb(|f| &f.boxes)),
            ("cameras", Dtype::F32, vec![frames, views, 16], cast_slice(&cameras).to_vec()),
            ("color", Dtype::U8, images(), rgb(|f| &f.color)),
            ("map", Dtype::U8, images(), rgb(|f| &f.map)),
            ("truth", Dtype::U8, images(), rgb(|f| &f.truth)),
        ];
        let views: Vec<_> = arrays
            .iter()
            .map(|(name, dtype, shape, data)| {
                TensorView::new(*dtype, shape.clone(), data).map(|view| (*name, view))
            })
            .collect::<Result<_, _>>()
            .map_err(|e| failed(e.to_string()))?;
        let about = serde_json::to_string(&self.about).map_err(|e| failed(e.to_string()))?;
        let bytes = serialize(views, Some(HashMap::from([(ABOUT.to_owned(), about)])));
        let bytes = bytes.map_err(|e| failed(e.to_string()))?;
        write_whole(path, |out| out.write_all(&bytes).map_err(FileError::io("write", path)))
    }

    /// Reads a file written by [`TrainingClip::save`].
    ///
    /// # Errors
    /// Fails if the file cannot be read, or if its content is not a valid recording.
    pub fn open(path: &Path) -> Result<Self, FileError> {
        let bytes = read_table(path)?;
        let wrong = |found: String| FileError::content("a training clip", found, path);
        let (_, head) = SafeTensors::read_metadata(&bytes).map_err(|e| wrong(e.to_string()))?;
        let about = head.metadata().as_ref().and_then(|all| all.get(ABOUT)).map_or("", String::as_str);
        let about: DriveInfo = json::parsed(about.as_bytes()).map_err(wrong)?;
        let tensors = SafeTensors::deserialize(&bytes).map_err(|e| wrong(e.to_string()))?;
        let (views, pixels) = (about.cameras.len(), about.recipe.size.pixels());
        let tensor = |name: &str, dtype: Dtype, per_frame: usize| -> Result<&[u8], FileError> {
            let tensor = tensors.tensor(name).map_err(|e| wrong(e.to_string()))?;
            let frames = tensor.shape().first().copied().unwrap_or(0);
            // The format checks the product of a shape against its bytes, but a shape with a zero may contain
            // any other sizes.
            let values = frames.checked_mul(per_frame);
            let fits = tensor.dtype() == dtype && values == Some(tensor.shape().iter().product());
            if !fits {
                return Err(wrong(format!("{name} as {:?} {:?}", tensor.dtype(), tensor.shape())));
            }
            Ok(tensor.data())
        };
        let rgb = |name| tensor(name, Dtype::U8, views * pixels * 3).map(pod_collect_to_vec::<u8, [u8; 3]>);
        let [color, boxes, map, truth] = [rgb("color")?, rgb("boxes")?, rgb("map")?, rgb("truth")?];
        let bins: Vec<u16> = pod_collect_to_vec(tensor("bins", Dtype::U16, views * pixels)?);
        if let Some(bin) = bins.iter().find(|bin| **bin > about.recipe.bins.count) {
            return Err(wrong(format!("bin {bin} of {}", about.recipe.bins.count)));
        }
        let action: Vec<[f32; 3]> = pod_collect_to_vec(tensor("action", Dtype::F32, 3)?);
        let cameras: Vec<[f32; 16]> = pod_collect_to_vec(tensor("cameras", Dtype::F32, views * 16)?);
        let per = views * pixels;
        let counts = [color.len(), boxes.len(), map.len(), truth.len(), bins.len(), cameras.len() * pixels];
        if counts.iter().any(|count| *count != action.len() * per) {
            return Err(wrong(format!("arrays of {counts:?} pixels in {} frames", action.len())));
        }
        let part = |all: &[[u8; 3]], frame: usize| all[frame * per..(frame + 1) * per].to_vec();
        let frame = |(index, action): (usize, [f32; 3])| DriveFrame {
            color: part(&color, index),
            bins: bins[index * per..(index + 1) * per].to_vec(),
            boxes: part(&boxes, index),
            map: part(&map, index),
            truth: part(&truth, index),
            action,
            cameras: cameras[index * views..(index + 1) * views].to_vec(),
        };
        Ok(Self { frames: action.into_iter().enumerate().map(frame).collect(), about })
    }
}
