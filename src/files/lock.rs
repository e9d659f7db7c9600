//! Files that only one process at a time has open.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{ErrorKind, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::Path;

use rustix::fs::OFlags;

use crate::error::FileError;

/// Attempts to open a file while another process removes its folder or name.
const TRIES: usize = 100;

/// Empty file that is locked by this process.
#[derive(Debug)]
pub(super) struct LockedFile(File);

impl LockedFile {
    /// Creates the file, or takes over one left by a dead process. `owner` is the output that the file protects.
    ///
    /// # Errors
    /// Fails if another process holds the lock, if a link, folder or device has that name, or on an I/O error.
    pub(super) fn open(path: &Path, owner: &Path) -> Result<Self, FileError> {
        for _ in 0..TRIES {
            if let Some(file) = attempt(path, owner)? {
                return Ok(file);
            }
        }
        Err(busy(owner, "one that keeps removing its lock"))
    }

    /// Returns the file.
    pub(super) fn file(&mut self) -> &mut File {
        &mut self.0
    }

    /// Writes the process id, which other processes show in their messages.
    pub(super) fn sign(&mut self) -> std::io::Result<()> {
        self.0.write_all(std::process::id().to_string().as_bytes())
    }
}

impl Drop for LockedFile {
    fn drop(&mut self) {
        // Closing unlocks too, but not while a child process that is being spawned still holds a copy of the file.
        let _ = self.0.unlock();
    }
}

/// Tries to lock the file once. `None` if the name was removed or replaced meanwhile.
fn attempt(path: &Path, owner: &Path) -> Result<Option<LockedFile>, FileError> {
    let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK;
    let mut options = OpenOptions::new();
    options.read(true).write(true).create(true).truncate(false).mode(0o666);
    let opened = options.custom_flags(flags.bits().cast_signed()).open(path);
    let mut file = match opened {
        Err(error) if error.kind() == ErrorKind::NotFound && path.parent().is_some_and(Path::exists) => {
            return Ok(None);
        }
        opened => opened.map_err(FileError::io("create", path))?,
    };
    let opened = file.metadata().map_err(FileError::io("read", path))?;
    if !opened.is_file() {
        return Err(FileError::content("a regular file", "something else", path));
    }
    match file.try_lock() {
        // Some network file systems have no locks. Files are still replaced atomically there.
        Err(TryLockError::Error(error)) if error.kind() == ErrorKind::Unsupported => {}
        Err(TryLockError::Error(error)) => return Err(FileError::io("lock", path)(error)),
        Err(TryLockError::WouldBlock) => return Err(busy(owner, &holder(&mut file))),
        Ok(()) => {}
    }
    let file = LockedFile(file);
    match std::fs::symlink_metadata(path) {
        Ok(named) if (named.dev(), named.ino()) == (opened.dev(), opened.ino()) => {
            file.0.set_len(0).map_err(FileError::io("write", path))?;
            Ok(Some(file))
        }
        _ => Ok(None),
    }
}

fn busy(owner: &Path, found: &str) -> FileError {
    FileError::Busy { found: found.to_owned(), path: owner.to_owned() }
}

/// Describes the process that holds a lock, with its id if the lock file has one.
fn holder(file: &mut File) -> String {
    let mut text = String::new();
    let read = file.seek(SeekFrom::Start(0)).and_then(|_| file.take(20).read_to_string(&mut text));
    let number = read.ok().and_then(|_| text.parse::<u32>().ok());
    number.map_or("one that holds its lock".to_owned(), |number| format!("process {number}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_held_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lock");
        let mut held = LockedFile::open(&path, Path::new("out")).unwrap();
        held.sign().unwrap();
        let message = LockedFile::open(&path, Path::new("out")).unwrap_err().to_string();
        let expected = format!(
            "expected no other process at work on this output, found process {}: out",
            std::process::id()
        );
        assert_eq!(message, expected);
        drop(held);
        LockedFile::open(&path, Path::new("out")).unwrap();
    }

    #[test]
    fn links_and_folders_are_no_locks() {
        let folder = tempfile::tempdir().unwrap();
        let (target, link) = (folder.path().join("target"), folder.path().join("link"));
        std::fs::write(&target, "precious").unwrap();
        std::os::unix::fs::symlink(&target, &link).unwrap();
        assert!(LockedFile::open(&link, &link).is_err());
        assert!(LockedFile::open(folder.path(), &link).is_err());
        assert_eq!(std::fs::read(&target).unwrap(), b"precious");
    }
}
