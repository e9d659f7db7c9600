//! Atomic file writes: a file appears complete under its name, or not at all.

use std::ffi::OsStr;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use super::lock::LockedFile;
use super::pending::PendingPath;
use crate::error::FileError;

/// Suffix of temporary names.
const PARTIAL: &str = ".pskel-part";
/// Number of bytes of the final name in the temporary name: file systems allow 255 bytes in total.
const MAX_NAME: usize = 200;
const BUFFER: usize = 1 << 20;

/// Writes a file under a temporary name in the same folder (`.NAME.pskel-part`), then renames it. `fill` writes to a
/// buffered writer. The temporary name depends only on the final one, so the next writer takes over the temporary
/// file of a killed process. Links are followed.
///
/// # Errors
/// Returns any error of `fill`. Fails if another process writes the same file, if the path is a folder, device or
/// pipe, or on an I/O error. The temporary file is removed then.
pub fn write_whole<E: From<FileError>>(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<&mut File>) -> Result<(), E>,
) -> Result<(), E> {
    let target = target(path)?;
    let mut partial = PartialFile::create(&target, path)?;
    let mut writer = BufWriter::with_capacity(BUFFER, partial.file.file());
    fill(&mut writer)?;
    writer.flush().map_err(FileError::io("write", path))?;
    drop(writer);
    std::fs::rename(&partial.path, &target).map_err(FileError::io("rename to", path))?;
    partial.is_renamed = true;
    Ok(())
}

/// Writes a value as indented JSON with a final newline, using [`write_whole`].
///
/// # Errors
/// Returns any error of [`write_whole`].
pub fn write_json(path: &Path, value: &impl serde::Serialize) -> Result<(), FileError> {
    write_whole(path, |out| {
        let written = serde_json::to_writer_pretty(&mut *out, value).map_err(std::io::Error::from);
        written.and_then(|()| out.write_all(b"\n")).map_err(FileError::io("write", path))
    })
}

/// File under its temporary name, removed on drop unless renamed.
struct PartialFile {
    file: LockedFile,
    path: PathBuf,
    is_renamed: bool,
    _pending: PendingPath,
}

impl PartialFile {
    fn create(target: &Path, path: &Path) -> Result<Self, FileError> {
        let name = target.file_name().unwrap_or_default().as_bytes();
        let name = &name[..name.len().min(MAX_NAME)];
        let name = [b".".as_slice(), name, PARTIAL.as_bytes()].concat();
        let partial = target.with_file_name(OsStr::from_bytes(&name));
        let pending = PendingPath::new(&partial);
        let file = LockedFile::open(&partial, path)?;
        Ok(Self { file, path: partial, is_renamed: false, _pending: pending })
    }
}

impl Drop for PartialFile {
    fn drop(&mut self) {
        if !self.is_renamed {
            // The caller reports the error that occurred before.
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Resolves `path` if it is a link to a file. Fails if it is a folder, device or pipe.
pub(super) fn target(path: &Path) -> Result<PathBuf, FileError> {
    match path.metadata() {
        Ok(data) if !data.is_file() => {
            let found = if data.is_dir() { "a folder" } else { "a device or pipe" };
            Err(FileError::content("a regular file or none", found, path))
        }
        Ok(_) => path.canonicalize().map_err(FileError::io("read", path)),
        Err(_) => Ok(path.to_owned()),
    }
}
