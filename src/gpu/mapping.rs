//! Read-only memory-mapped files.

use std::path::Path;

use memmap2::Mmap;

use crate::error::FileError;
use crate::files::input::open_regular;

/// A file as bytes, read by the operating system as they are touched.
///
/// It stands here, beside Vulkan, because mapping needs `unsafe`, which only this module may use, and because a
/// mapped file is memory that a device can import.
#[derive(Debug)]
pub struct MappedFile(Option<Mmap>);

impl MappedFile {
    /// Maps a whole file; an empty one has no bytes. The file must not be shortened while it is mapped: touching
    /// the lost part ends the process with a bus error. This program only ever replaces its files by renaming,
    /// which leaves mapped ones as they are.
    ///
    /// # Errors
    /// The file cannot be opened or mapped.
    pub fn open(path: &Path) -> Result<Self, FileError> {
        let (file, length) = open_regular(path)?;
        if length == 0 {
            return Ok(Self(None)); // the system refuses to map nothing
        }
        // SAFETY: sound as long as nobody writes into the file or shortens it, which the contract above asks for.
        let mapped = unsafe { Mmap::map(&file) };
        mapped.map(|map| Self(Some(map))).map_err(FileError::io("map", path))
    }

    /// The content.
    pub fn as_bytes(&self) -> &[u8] {
        self.0.as_deref().unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn content_is_that_of_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        std::fs::write(&path, [1, 2, 3]).unwrap();
        assert_eq!(MappedFile::open(&path).unwrap().as_bytes(), [1, 2, 3]);
        std::fs::write(folder.path().join("empty"), []).unwrap();
        assert!(MappedFile::open(&folder.path().join("empty")).unwrap().as_bytes().is_empty());
    }

    #[test]
    fn errors_name_the_file() {
        let folder = tempfile::tempdir().unwrap();
        for path in [folder.path().join("missing"), folder.path().to_owned()] {
            let text = MappedFile::open(&path).unwrap_err().to_string();
            assert!(text.ends_with(&path.display().to_string()), "{text}");
        }
    }
}
