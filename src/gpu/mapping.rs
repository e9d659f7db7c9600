//! Read-only memory-mapped files.

use std::path::Path;

use memmap2::{Advice, Mmap};

use crate::error::FileError;
use crate::files::input::open_regular;

/// The bytes of a file, paged in by the operating system on access.
///
/// Part of this module because mapping needs `unsafe`, which is confined to it, and because a device can
/// import the memory of a mapped file.
#[derive(Debug)]
pub struct MappedFile(Option<Mmap>);

impl MappedFile {
    /// Maps a whole file; an empty file has no bytes. The file must not be truncated while it is mapped:
    /// accessing the lost part terminates the process with a bus error. This program replaces its files only
    /// by renaming, which leaves existing mappings intact.
    ///
    /// # Errors
    /// Fails if the file cannot be opened or mapped.
    pub fn open(path: &Path) -> Result<Self, FileError> {
        let (file, length) = open_regular(path)?;
        if length == 0 {
            return Ok(Self(None)); // an empty mapping is an error of the system
        }
        // SAFETY: sound as long as no process writes to the file or truncates it, which the contract above
        // demands.
        let mapped = unsafe { Mmap::map(&file) };
        mapped.map(|map| Self(Some(map))).map_err(FileError::io("map", path))
    }

    /// Maps a file as [`MappedFile::open`], of which small parts far from each other are read: the operating
    /// system then reads nothing in advance.
    ///
    /// # Errors
    /// Fails as [`MappedFile::open`].
    pub fn open_sparse(path: &Path) -> Result<Self, FileError> {
        let mapped = Self::open(path)?;
        if let Some(map) = &mapped.0 {
            map.advise(Advice::Random).map_err(FileError::io("map", path))?;
        }
        Ok(mapped)
    }

    /// Returns the contents.
    pub fn as_bytes(&self) -> &[u8] {
        self.0.as_deref().unwrap_or_default()
    }
}

impl AsRef<[u8]> for MappedFile {
    fn as_ref(&self) -> &[u8] {
        self.as_bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mapped_bytes_match_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        std::fs::write(&path, [1, 2, 3]).unwrap();
        assert_eq!(MappedFile::open(&path).unwrap().as_bytes(), [1, 2, 3]);
        assert_eq!(MappedFile::open_sparse(&path).unwrap().as_bytes(), [1, 2, 3]);
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
