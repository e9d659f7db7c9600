//! NPZ writer, `maps.npz`: one array per map, `[V, H, W]` or `[V, H, W, 3]`, views in the set's order, −300
//! for empty depth; two arrays for the model tensor.
//!
//! # How it works
//! An NPZ is a ZIP of NPY files. All entries have the same timestamp and compression, so equal maps give
//! equal bytes.

use std::io::{Cursor, Write};
use std::path::Path;

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

use super::arrays::{Array, Scalar, arrays};
use crate::cloud::npy::write_header;
use crate::conditions::{ConditionError, ConditionSet};
use crate::error::FileError;
use crate::files::{FileKind, write_whole};

/// Deflate level; higher levels take several times longer for little gain on these maps.
const LEVEL: i64 = 3;

/// Archives of maps that begin with color. NumPy's archives have a field between the lengths and the name.
pub const COLOR_FIRST: FileKind =
    FileKind { name: "an archive of pskel", begin: b"PK\x03\x04", marks: &[b"\x09\0\0\0color.npy"] };

/// Writes all maps of a step. Arrays have the names of the maps; the model tensor is `points` `[V, 20, H, W]`
/// and `layout` `[V, 6, H, W]`.
///
/// # Errors
/// Returns an error if the cameras differ in size or the file cannot be written.
pub fn write(path: &Path, set: &ConditionSet) -> Result<(), ConditionError> {
    // Written to memory first: a ZipWriter that hits a full disk tries to write again when it is dropped.
    let archive =
        archive(&arrays(set, path)?).map_err(|e| FileError::io("write", path)(std::io::Error::other(e)))?;
    write_whole(path, |out| out.write_all(&archive).map_err(FileError::io("write", path)))?;
    Ok(())
}

fn archive(arrays: &[Array<'_>]) -> zip::result::ZipResult<Vec<u8>> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for array in arrays {
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            .compression_level(Some(LEVEL))
            .last_modified_time(DateTime::default())
            .unix_permissions(0o644)
            .large_file(array.bytes() as u64 > u64::from(u32::MAX) / 2);
        zip.start_file(format!("{}.npy", array.name), options)?;
        header(&mut zip, array)?;
        array.parts.iter().try_for_each(|part| zip.write_all(part))?;
    }
    Ok(zip.finish()?.into_inner())
}

fn header(out: &mut impl Write, array: &Array<'_>) -> std::io::Result<()> {
    let shape: Vec<u64> = array.shape.iter().map(|side| *side as u64).collect();
    match array.scalar {
        Scalar::F32 => write_header::<f32>(out, &shape),
        Scalar::U32 => write_header::<u32>(out, &shape),
        Scalar::U8 => write_header::<u8>(out, &shape),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conditions::write::test_set::test_set;
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
        assert!(message.contains("a common image size") && message.contains("right at 4x3"), "{message}");
    }
}
