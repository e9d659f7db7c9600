//! Safetensors writer, `conditions.safetensors`: one tensor per map as in an NPZ, with a description as text
//! metadata.
//!
//! # How it works
//! The file holds the length of its header, the JSON header, and the tensors one after the other. The crate
//! `safetensors` builds and checks the header; tensors are written as they are in memory. Keys are sorted, so
//! equal maps give equal bytes. Tensors of 4-byte numbers come first, which aligns all of them.

use std::borrow::Cow;
use std::collections::HashMap;
use std::io::Write;
use std::path::Path;

use safetensors::Dtype;
use safetensors::tensor::{Metadata, TensorInfo};

use super::arrays::{Array, Scalar, arrays};
use crate::conditions::{ConditionError, ConditionOptions, ConditionSet, MapKind};
use crate::error::FileError;
use crate::files::write_whole;

/// The header's length is a multiple of this, to align the tensors.
const ALIGNMENT: usize = 8;

/// Writes all maps of a step at `t_us` (microseconds). The metadata holds `cameras` (a JSON list of names),
/// `t_us`, `depth_bins` and, with model tensors, `depth_embedding`.
///
/// # Errors
/// Returns an error if the cameras differ in size or the file cannot be written.
pub fn write(
    path: &Path,
    set: &ConditionSet,
    t_us: i64,
    options: &ConditionOptions,
) -> Result<(), ConditionError> {
    let parts = encode(path, set, t_us, options)?;
    write_whole(path, |out| {
        parts.iter().try_for_each(|part| out.write_all(part).map_err(FileError::io("write", path)))
    })?;
    Ok(())
}

/// Returns the content of the file, in parts. `path` is the file that errors name.
///
/// # Errors
/// Returns an error if the cameras differ in size.
pub fn encode<'a>(
    path: &Path,
    set: &'a ConditionSet,
    t_us: i64,
    options: &ConditionOptions,
) -> Result<Vec<Cow<'a, [u8]>>, ConditionError> {
    let mut arrays = arrays(set, path)?;
    arrays.sort_by_key(|array| array.scalar == Scalar::U8);
    let failed = |error: &dyn std::fmt::Display| {
        FileError::io("write", path)(std::io::Error::other(error.to_string()))
    };
    let header = Metadata::new(Some(texts(set, t_us, options)), infos(&arrays)).map_err(|e| failed(&e))?;
    // Converted through a JSON value, whose keys are sorted; the metadata map has no defined order.
    let mut header = serde_json::to_value(&header).map_err(|e| failed(&e))?.to_string().into_bytes();
    header.resize(header.len().next_multiple_of(ALIGNMENT), b' ');
    let length = (header.len() as u64).to_le_bytes().to_vec();
    let head = [length, header].map(Cow::Owned);
    Ok(head.into_iter().chain(arrays.into_iter().flat_map(|array| array.parts)).collect())
}

fn texts(set: &ConditionSet, t_us: i64, options: &ConditionOptions) -> HashMap<String, String> {
    let names: Vec<&str> = set.cameras.iter().map(|camera| camera.name.as_str()).collect();
    let mut texts = HashMap::from([
        ("cameras".to_owned(), serde_json::json!(names).to_string()),
        ("t_us".to_owned(), t_us.to_string()),
        ("depth_bins".to_owned(), serde_json::json!(options.depth_bins).to_string()),
    ]);
    if options.maps.contains(MapKind::Tensor) {
        texts.insert("depth_embedding".to_owned(), options.depth_embedding.name().to_owned());
    }
    texts
}

fn infos(arrays: &[Array<'_>]) -> Vec<(String, TensorInfo)> {
    let mut end = 0;
    let info = |array: &Array<'_>| {
        let start = end;
        end += array.bytes();
        let dtype = match array.scalar {
            Scalar::F32 => Dtype::F32,
            Scalar::U32 => Dtype::U32,
            Scalar::U8 => Dtype::U8,
        };
        (array.name.to_owned(), TensorInfo { dtype, shape: array.shape.clone(), data_offsets: (start, end) })
    };
    arrays.iter().map(info).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conditions::write::test_set::test_set;
    use crate::conditions::{DepthEmbedding, MapSet, TensorEncoder};
    use safetensors::SafeTensors;

    fn options() -> ConditionOptions {
        ConditionOptions { maps: MapSet::of(&MapKind::ALL), ..ConditionOptions::default() }
    }

    /// Returns the test set with model tensors.
    fn set() -> ConditionSet {
        let mut set = test_set();
        let encoder = TensorEncoder::new(options().depth_bins, DepthEmbedding::Both);
        set.cameras.iter_mut().for_each(|camera| camera.tensor = encoder.encode(camera));
        set
    }

    #[test]
    fn written_tensors_read_back_and_repeat() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("conditions.safetensors");
        write(&path, &set(), 17, &options()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let file = SafeTensors::deserialize(&bytes).unwrap();
        let mut names = file.names();
        names.sort_unstable();
        assert_eq!(names, ["boxes", "class", "color", "depth", "instance", "layout", "map", "points"]);
        let second = &set().cameras[1];
        let points = file.tensor("points").unwrap();
        assert_eq!((points.dtype(), points.shape()), (Dtype::F32, &[2, 20, 4, 6][..]));
        let expected = &second.tensor.as_ref().unwrap().points;
        assert_eq!(&points.data()[20 * 24 * 4..], bytemuck::cast_slice::<f32, u8>(expected));
        assert_eq!(file.tensor("layout").unwrap().shape(), [2, 6, 4, 6]);
        let color = file.tensor("color").unwrap();
        assert_eq!((color.dtype(), color.shape()), (Dtype::U8, &[2, 4, 6, 3][..]));
        assert_eq!(&color.data()[72..], second.color.as_ref().unwrap().as_flattened());
        let depth = file.tensor("depth").unwrap();
        assert_eq!(depth.data()[..8], [(-300.0_f32).to_le_bytes(), 0.75_f32.to_le_bytes()].concat());
        assert_eq!(file.tensor("instance").unwrap().dtype(), Dtype::U32);
        for name in ["depth", "points", "instance"] {
            let offset = file.tensor(name).unwrap().data().as_ptr() as usize - bytes.as_ptr() as usize;
            assert_eq!(offset % 4, 0, "{name}");
        }
        let metadata = SafeTensors::read_metadata(&bytes).unwrap().1.metadata().clone().unwrap();
        assert_eq!((metadata["t_us"].as_str(), metadata["cameras"].as_str()), ("17", r#"["left","right"]"#));
        assert_eq!(metadata["depth_embedding"], "continuous");
        assert!(metadata["depth_bins"].contains(r#""far_m":100.0"#), "{metadata:?}");
        for _ in 0..8 {
            write(&path, &set(), 17, &options()).unwrap();
            assert_eq!(std::fs::read(&path).unwrap(), bytes);
        }
    }

    #[test]
    fn sizes_must_agree() {
        let mut set = set();
        set.cameras[1].width = 3;
        let path = Path::new("c.safetensors");
        let message = write(path, &set, 0, &options()).unwrap_err().to_string();
        assert!(message.contains("a common image size") && message.ends_with("c.safetensors"), "{message}");
    }
}
