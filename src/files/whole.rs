//! Atomic file writes: a file appears complete under its name, or not at all.

use std::ffi::OsStr;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::lock::LockedFile;
use super::manifest::Manifest;
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

/// Checks that an output file is none of the inputs and is not listed in a run's output folder.
///
/// # Errors
/// Fails if it is one of these, or if a list of files cannot be read.
pub fn check_output_file<'a>(
    path: &Path,
    inputs: impl IntoIterator<Item = &'a Path>,
) -> Result<(), FileError> {
    let Ok(found) = path.metadata() else { return Ok(()) };
    let is_same = |input: &Path| {
        input.metadata().is_ok_and(|data| (data.dev(), data.ino()) == (found.dev(), found.ino()))
    };
    if let Some(input) = inputs.into_iter().find(|input| is_same(input)) {
        let expected = format!("an output apart from the input {}", input.display());
        return Err(FileError::content(expected, "the same", path));
    }
    let absolute = path.canonicalize().map_err(FileError::io("read", path))?;
    for folder in absolute.ancestors().skip(1) {
        let Some(manifest) = Manifest::read(folder)? else { continue };
        if absolute.strip_prefix(folder).is_ok_and(|name| manifest.holds(name)) {
            let found = format!("one of {} in {}", manifest.kind, folder.display());
            return Err(FileError::content("a file that is no part of another output", found, path));
        }
    }
    Ok(())
}

/// Checks that an output file is outside a folder written by the same run, whose files could replace it.
///
/// # Errors
/// Fails if the file is in the folder.
pub fn check_outside(path: &Path, folder: &Path) -> Result<(), FileError> {
    let resolved = |path: &Path| path.canonicalize().or_else(|_| std::path::absolute(path));
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    match (resolved(parent), resolved(folder)) {
        (Ok(parent), Ok(folder)) if parent.starts_with(&folder) => {
            let expected = format!("a file outside of the output {}", folder.display());
            Err(FileError::content(expected, "one in it", path))
        }
        _ => Ok(()),
    }
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

/// Resolves `path` if it is a link to a file.
fn target(path: &Path) -> Result<PathBuf, FileError> {
    match path.metadata() {
        Ok(data) if !data.is_file() => {
            let found = if data.is_dir() { "a folder" } else { "a device or pipe" };
            Err(FileError::content("a regular file or none", found, path))
        }
        Ok(_) => path.canonicalize().map_err(FileError::io("read", path)),
        Err(_) => Ok(path.to_owned()),
    }
}
