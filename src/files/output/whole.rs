//! Atomic file writes: a file appears complete under its name, or not at all.

use std::ffi::OsStr;
use std::fs::{File, OpenOptions};
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use super::mounts::{is_beside_read_only, is_fixed, is_mounted};
use super::pending::PendingPath;
use crate::error::FileError;
use crate::files::lock::LockedFile;

/// Suffix of temporary names.
const PARTIAL: &str = ".pskel-part";
/// Maximum length of the final name within the temporary name, bytes: file systems allow 255 bytes in total.
const MAX_NAME: usize = 200;
const BUFFER: usize = 1 << 20;

/// Writes a file under a temporary name in the same folder (`.NAME.pskel-part`), then renames it. `fill`
/// writes to a buffered writer. The temporary name depends only on the final one, so the next writer takes
/// over the temporary file of a killed process. Links are followed.
///
/// A file that is a mount point cannot be replaced by a rename, so the content is copied into it. If nothing
/// can be created beside an existing file, `fill` writes into it.
///
/// # Errors
/// Returns any error of `fill`. Fails if another process writes the same file, if the path is a folder,
/// device or pipe, or on an I/O error. The temporary file is removed then.
pub fn write_whole<E: From<FileError>>(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<&mut File>) -> Result<(), E>,
) -> Result<(), E> {
    let target = target(path)?;
    if target.is_file() && is_beside_read_only(&target) {
        return write_into(path, &target, fill);
    }
    let mut partial = PartialFile::create(&target, path)?;
    let mut writer = BufWriter::with_capacity(BUFFER, partial.file.file());
    fill(&mut writer)?;
    writer.flush().map_err(FileError::io("write", path))?;
    drop(writer);
    match std::fs::rename(&partial.path, &target) {
        Ok(()) => partial.is_renamed = true,
        Err(error) if is_fixed(&error) && is_mounted(&target) => {
            let from = partial.file.file();
            from.seek(SeekFrom::Start(0)).map_err(FileError::io("read", path))?;
            write_into(path, &target, |out| {
                std::io::copy(from, out).map(drop).map_err(FileError::io("write", path))
            })?;
        }
        Err(error) => return Err(FileError::io("rename to", path)(error).into()),
    }
    Ok(())
}

/// Writes into an existing file. It is empty after an error.
fn write_into<E: From<FileError>>(
    path: &Path,
    target: &Path,
    fill: impl FnOnce(&mut BufWriter<&mut File>) -> Result<(), E>,
) -> Result<(), E> {
    let opened = OpenOptions::new().write(true).truncate(true).open(target);
    let mut file = opened.map_err(FileError::io("write", path))?;
    let mut writer = BufWriter::with_capacity(BUFFER, &mut file);
    let filled = fill(&mut writer).and_then(|()| Ok(writer.flush().map_err(FileError::io("write", path))?));
    drop(writer.into_parts());
    if filled.is_err() {
        let _ = file.set_len(0); // the first error is the one to report
    }
    filled
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
        let mut partial = Self { file, path: partial, is_renamed: false, _pending: pending };
        partial.file.file().set_len(0).map_err(FileError::io("write", path))?;
        Ok(partial)
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

/// Resolves `path` if it is a link, also to a file that does not exist yet. Fails if it is a folder, device
/// or pipe.
pub(in super::super) fn target(path: &Path) -> Result<PathBuf, FileError> {
    match path.metadata() {
        Ok(data) if !data.is_file() => {
            let found = if data.is_dir() { "a folder" } else { "a device or pipe" };
            Err(FileError::content("a regular file or none", found, path))
        }
        Ok(_) => path.canonicalize().map_err(FileError::io("read", path)),
        Err(_) => Ok(created_at(path)),
    }
}

/// Returns where a file is created that does not exist: the path itself, or where it leads if it is a link.
pub(in super::super) fn created_at(path: &Path) -> PathBuf {
    /// As on Linux, so that links in a circle end.
    const MAX_LINKS: usize = 40;
    let mut place = path.to_owned();
    for _ in 0..MAX_LINKS {
        let Ok(link) = std::fs::read_link(&place) else { break };
        place = place.with_file_name(link);
    }
    place
}
