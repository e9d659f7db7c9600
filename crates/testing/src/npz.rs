//! Reads arrays from NPZ archives.

use std::io::Read;
use std::path::Path;

/// Array of an NPZ.
#[derive(Clone, Debug, PartialEq)]
pub struct Array<T> {
    pub shape: Vec<usize>,
    pub data: Vec<T>,
}

/// Reads one array of an archive.
pub fn read<T: npyz::Deserialize>(path: &Path, name: &str) -> Array<T> {
    let mut archive = zip::ZipArchive::new(std::fs::File::open(path).unwrap()).unwrap();
    let mut bytes = Vec::new();
    archive.by_name(&format!("{name}.npy")).unwrap().read_to_end(&mut bytes).unwrap();
    let file = npyz::NpyFile::new(bytes.as_slice()).unwrap();
    Array { shape: file.shape().iter().map(|n| *n as usize).collect(), data: file.into_vec().unwrap() }
}
