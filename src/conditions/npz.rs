//! `maps.npz`: one array per map, `[V, H, W]` or `[V, H, W, 3]`, views in the set's order, −300 for empty depth.
//!
//! # How it works
//! An NPZ is a ZIP of NPY files. Every entry has the same time stamp and compression, so the same maps give the same
//! bytes.

use std::borrow::Cow;
use std::io::{Cursor, Write};
use std::path::Path;

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

use super::{CameraConditions, ConditionError, ConditionSet, EMPTY_DEPTH_M, MapKind};
use crate::cloud::npy::write_header;
use crate::error::{FileError, write_whole};

/// Level of deflate: higher ones take several times longer to gain little on these maps.
const LEVEL: i64 = 3;

/// Writes all maps of a step. Arrays are named as the maps.
///
/// # Errors
/// Cameras of differing size; the system's, at writing.
pub fn write(path: &Path, set: &ConditionSet) -> Result<(), ConditionError> {
    check_sizes(path, set)?;
    // In memory first: a ZipWriter that meets a full disk tries to write on when it is dropped.
    let archive = archive(set).map_err(|e| FileError::io("write", path)(std::io::Error::other(e)))?;
    write_whole(path, |out| out.write_all(&archive).map_err(FileError::io("write", path)))?;
    Ok(())
}

fn check_sizes(path: &Path, set: &ConditionSet) -> Result<(), ConditionError> {
    let Some(first) = set.cameras.first() else { return Ok(()) };
    let described = |camera: &CameraConditions| format!("{} at {}", camera.name, camera.size());
    match set.cameras.iter().find(|camera| camera.size() != first.size()) {
        None => Ok(()),
        Some(other) => Err(ConditionError::Sizes {
            first: described(first),
            other: described(other),
            path: path.to_owned(),
        }),
    }
}

fn archive(set: &ConditionSet) -> zip::result::ZipResult<Vec<u8>> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for kind in MapKind::ALL {
        // All cameras of a set have the same maps.
        let Some(maps) = set.cameras.iter().map(|camera| map_bytes(camera, kind)).collect::<Option<Vec<_>>>()
        else {
            continue;
        };
        let bytes: usize = maps.iter().map(|map| map.len()).sum();
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            .compression_level(Some(LEVEL))
            .last_modified_time(DateTime::default())
            .unix_permissions(0o644)
            .large_file(bytes as u64 > u64::from(u32::MAX) / 2);
        zip.start_file(format!("{}.npy", kind.name()), options)?;
        header(&mut zip, kind, set)?;
        maps.iter().try_for_each(|map| zip.write_all(map))?;
    }
    Ok(zip.finish()?.into_inner())
}

fn header(out: &mut impl Write, kind: MapKind, set: &ConditionSet) -> std::io::Result<()> {
    let (height, width) = set.cameras.first().map_or((0, 0), |c| (c.height, c.width));
    let shape = [set.cameras.len() as u64, height.into(), width.into(), 3];
    match kind {
        MapKind::Color | MapKind::Boxes | MapKind::Map => write_header::<u8>(out, &shape),
        MapKind::Depth => write_header::<f32>(out, &shape[..3]),
        MapKind::Class => write_header::<u8>(out, &shape[..3]),
        MapKind::Instance | MapKind::Point => write_header::<u32>(out, &shape[..3]),
    }
}

/// A map as the array holds it (the machines we run on are little-endian, as is the header); `None` where the camera
/// has no such map.
fn map_bytes(camera: &CameraConditions, kind: MapKind) -> Option<Cow<'_, [u8]>> {
    Some(match kind {
        MapKind::Color | MapKind::Boxes | MapKind::Map => Cow::Borrowed(camera.rgb(kind)?.as_flattened()),
        MapKind::Class => Cow::Borrowed(camera.class.as_ref()?.as_slice()),
        MapKind::Instance => Cow::Borrowed(bytemuck::cast_slice(camera.instance.as_ref()?)),
        MapKind::Point => Cow::Borrowed(bytemuck::cast_slice(camera.point.as_ref()?)),
        MapKind::Depth => {
            let metres = |d: &f32| if d.is_finite() { *d } else { EMPTY_DEPTH_M };
            Cow::Owned(camera.depth_m.as_ref()?.iter().flat_map(|d| metres(d).to_le_bytes()).collect())
        }
    })
}

#[cfg(test)]
mod tests {
    use super::super::test_set::test_set;
    use super::*;
    use std::io::Read;

    fn array<T: npyz::Deserialize>(path: &Path, name: &str) -> (Vec<u64>, Vec<T>) {
        let mut zip = zip::ZipArchive::new(std::fs::File::open(path).unwrap()).unwrap();
        let mut bytes = Vec::new();
        zip.by_name(&format!("{name}.npy")).unwrap().read_to_end(&mut bytes).unwrap();
        let file = npyz::NpyFile::new(bytes.as_slice()).unwrap();
        (file.shape().to_vec(), file.into_vec().unwrap())
    }

    #[test]
    fn written_maps_read_back_and_repeat() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("maps.npz");
        let set = test_set();
        write(&path, &set).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let shape = [2, 4, 6];
        let (found, color) = array::<u8>(&path, "color");
        assert_eq!(found, [2, 4, 6, 3]);
        assert_eq!(&color[72..], set.cameras[1].color.as_ref().unwrap().as_flattened());
        let (found, depth) = array::<f32>(&path, "depth");
        assert_eq!((found.as_slice(), depth[0], depth[1]), (shape.as_slice(), -300.0, 0.75));
        let (found, class) = array::<u8>(&path, "class");
        assert_eq!(
            (found.as_slice(), &class[..24]),
            (shape.as_slice(), &set.cameras[0].class.as_ref().unwrap()[..])
        );
        let (found, instance) = array::<u32>(&path, "instance");
        assert_eq!(
            (found.as_slice(), &instance[..24]),
            (shape.as_slice(), &set.cameras[0].instance.as_ref().unwrap()[..])
        );
        assert_eq!(array::<u8>(&path, "boxes").0, [2, 4, 6, 3]);
        let (found, map) = array::<u8>(&path, "map");
        assert_eq!(found, [2, 4, 6, 3]);
        assert_eq!(&map[72..], set.cameras[1].map.as_ref().unwrap().as_flattened());
        write(&path, &set).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), bytes);
    }

    #[test]
    fn sizes_must_agree() {
        let mut set = test_set();
        set.cameras[1].width = 3;
        let message = write(Path::new("maps.npz"), &set).unwrap_err().to_string();
        assert!(message.contains("--out-size") && message.contains("right at 4x3"), "{message}");
    }
}
