//! `cosmos-video`: videos for post-training Cosmos-Transfer2.5 multiview: `videos/CAMERA/CLIP.mp4` (recorded
//! images), `control_input_hdmap_bbox/CAMERA/CLIP.mp4` (boxes over the HD map),
//! `control_input_color/CAMERA/CLIP.mp4`, and `captions/CAMERA/CLIP.json`.

use std::collections::BTreeMap;
use std::path::Path;

use image::RgbImage;
use image::imageops::{FilterType, resize};
use point_skeleton::Maps;
use point_skeleton::conditions::{CameraConditions, ImageSize};
use point_skeleton::dataset::Recording;
use point_skeleton::scene::GroundTruthImages;
use pskel_sim::report::Video;
use rayon::prelude::*;
use serde_json::json;

use super::{LayoutWriter, Source, slots};
use crate::samples::Sample;
use crate::shard::Shard;
use crate::{ExportError, ExportOptions};

/// Frame rate of logs whose own is unknown, per second.
const DEFAULT_HZ: f64 = 10.0;

pub(super) struct Videos<'a> {
    source: &'a Source<'a>,
    clip: String,
    /// Folder of each camera in the order of the log's rig.
    folders: Vec<Option<String>>,
    /// By path in the export.
    videos: BTreeMap<String, Video>,
}

/// A frame of a video.
struct Picture {
    path: String,
    size: ImageSize,
    pixels: Vec<[u8; 3]>,
}

/// Checks that the encoder accepts the sizes of all maps.
pub(super) fn check(options: &ExportOptions, log: &Recording) -> Result<(), ExportError> {
    let (size, out_size) = (options.conditions.size, options.conditions.out_size);
    for rig in &log.rig {
        let camera = &rig.camera;
        let own = ImageSize { height: camera.height, width: camera.width };
        Video::check(Path::new(camera.name.as_str()), out_size.or(size).unwrap_or(own))?;
    }
    Ok(())
}

impl<'a> Videos<'a> {
    pub(super) fn new(source: &'a Source<'a>, clip: &str) -> Self {
        let names = slots::names(&source.recording().rig).into_iter();
        let folder = |name: &str| format!("ftheta_{}", name.replace(':', "_"));
        let folders = names.map(|name| name.map(folder)).collect();
        Self { source, clip: clip.to_owned(), folders, videos: BTreeMap::new() }
    }

    fn pictures(
        &self,
        sample: &Sample<'_>,
        maps: &CameraConditions,
        camera: usize,
    ) -> Result<Vec<Picture>, ExportError> {
        let log = self.source.recording();
        let rig = log.rig.iter().position(|rig| rig.camera.name == maps.name);
        let Some(folder) = rig.and_then(|rig| self.folders[rig].as_ref()) else { return Ok(Vec::new()) };
        let size = maps.size();
        let picture = |kind: &str, pixels: Vec<[u8; 3]>| {
            let path = format!("{kind}/{folder}/{}.mp4", self.clip);
            Picture { path, size, pixels }
        };
        let mut pictures = Vec::new();
        if let Some(boxes) = &maps.boxes {
            pictures.push(picture("control_input_hdmap_bbox", over(boxes, maps.map.as_deref())));
        }
        if let Some(color) = &maps.color {
            pictures.push(picture("control_input_color", color.clone()));
        }
        if let Some(record) = sample.images[camera].filter(|_| self.source.options.images) {
            let image = GroundTruthImages::new(self.source.log.reader()).of_record(record)?;
            let image: RgbImage = resize(&image, size.width, size.height, FilterType::Triangle);
            pictures.push(picture("videos", image.into_raw().as_chunks::<3>().0.to_vec()));
        }
        Ok(pictures)
    }
}

/// Returns boxes over the map.
fn over(boxes: &[[u8; 3]], map: Option<&[[u8; 3]]>) -> Vec<[u8; 3]> {
    let Some(map) = map else { return boxes.to_vec() };
    boxes.iter().zip(map).map(|(top, below)| if *top == [0; 3] { *below } else { *top }).collect()
}

impl LayoutWriter for Videos<'_> {
    fn add(&mut self, shard: &mut Shard, sample: &Sample<'_>, maps: &Maps) -> Result<(), ExportError> {
        let hz = self.source.fps().unwrap_or(DEFAULT_HZ);
        let cameras: Vec<_> = maps.cameras().iter().enumerate().collect();
        let pictures = cameras.par_iter().map(|(camera, maps)| self.pictures(sample, maps, *camera));
        let pictures: Vec<Vec<Picture>> = pictures.collect::<Result<_, _>>()?;
        let pictures: Vec<Picture> = pictures.into_iter().flatten().collect();
        for Picture { path, size, .. } in &pictures {
            if !self.videos.contains_key(path) {
                shard.check(path)?;
                self.videos.insert(path.clone(), Video::new(Path::new(path), *size, hz)?);
            }
        }
        let of_video: BTreeMap<&str, &Picture> = pictures.iter().map(|p| (p.path.as_str(), p)).collect();
        self.videos.par_iter_mut().try_for_each(|(path, video)| match of_video.get(path.as_str()) {
            Some(picture) => Ok(video.push(picture.size, &picture.pixels)?),
            None => Err(ExportError::Lacks {
                expected: "an image of every camera in every frame of a video",
                found: format!("none for {path} at {}", sample.state.name),
                log: self.source.recording().name.clone(),
            }),
        })
    }

    fn finish(self: Box<Self>, shard: &mut Shard) -> Result<(), ExportError> {
        let caption = self.source.log_caption();
        for (path, video) in self.videos {
            if let Some(bytes) = video.into_bytes()? {
                shard.put(path, &bytes)?;
            }
        }
        let text = format!("{:#}\n", json!({ "caption": caption }));
        for folder in self.folders.iter().flatten() {
            shard.put(format!("captions/{folder}/{}.json", self.clip), text.as_bytes())?;
        }
        Ok(())
    }
}
