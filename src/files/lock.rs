//! Files that only one process at a time has open.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Error, ErrorKind, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use rustix::fs::OFlags;
use rustix::io::Errno;

use crate::error::FileError;

/// Attempts to open a file while another process removes its folder or name.
const TRIES: usize = 100;
/// Beginning of a signed lock file; the process id follows.
const SIGNATURE: &str = "pskel work ";

/// Whether a file system without locks was found.
static UNLOCKED: AtomicBool = AtomicBool::new(false);

/// Returns whether this process has written to a file system without locks, where several processes can write
/// to one output at a time.
pub fn lacks_locks() -> bool {
    UNLOCKED.load(Ordering::Relaxed)
}

/// File that is locked by this process.
#[derive(Debug)]
pub(super) struct LockedFile(File);

/// Content of a lock file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LockContent {
    /// Nothing: a process was killed before it signed the file.
    Empty,
    /// The signature of this program.
    Signed,
    /// A process id alone, as earlier versions and other programs write it.
    Number,
    /// Anything else.
    Other,
}

impl LockedFile {
    /// Creates the file, or takes over one left by a dead process with its content. `owner` is the output
    /// that the file protects.
    ///
    /// # Errors
    /// Fails if another process holds the lock, if a link, folder or device has that name, or on an I/O
    /// error. A file that was created is removed then.
    pub(super) fn open(path: &Path, owner: &Path) -> Result<Self, FileError> {
        for _ in 0..TRIES {
            if let Some(file) = attempt(path, owner)? {
                return Ok(file);
            }
        }
        Err(busy(owner, "a process that keeps removing its lock"))
    }

    /// Returns the file.
    pub(super) fn file(&mut self) -> &mut File {
        &mut self.0
    }

    /// Returns what the content says about the process that wrote it.
    pub(super) fn content(&mut self) -> std::io::Result<LockContent> {
        let mut text = Vec::new();
        self.0.seek(SeekFrom::Start(0))?;
        (&self.0).take(40).read_to_end(&mut text)?;
        Ok(match &text[..] {
            [] => LockContent::Empty,
            text if text.starts_with(SIGNATURE.as_bytes()) => LockContent::Signed,
            text if text.iter().all(u8::is_ascii_digit) => LockContent::Number,
            _ => LockContent::Other,
        })
    }

    /// Writes a signature with the process id, which other processes show in their messages. An older
    /// signature is overwritten without a moment where none exists.
    pub(super) fn sign(&mut self) -> std::io::Result<()> {
        let text = format!("{SIGNATURE}{}\n", std::process::id());
        self.0.seek(SeekFrom::Start(0))?;
        self.0.write_all(text.as_bytes())?;
        self.0.set_len(text.len() as u64)
    }
}

impl Drop for LockedFile {
    fn drop(&mut self) {
        // Closing unlocks too, but not while a child process that is being spawned still holds a copy of the
        // file.
        let _ = self.0.unlock();
    }
}

/// Tries to lock the file once. `None` if the name was removed or replaced meanwhile.
fn attempt(path: &Path, owner: &Path) -> Result<Option<LockedFile>, FileError> {
    let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK;
    let mut options = OpenOptions::new();
    options.read(true).write(true).mode(0o666).custom_flags(flags.bits().cast_signed());
    let (opened, is_new) = match options.create_new(true).open(path) {
        Err(error) if error.kind() == ErrorKind::AlreadyExists => {
            (options.create_new(false).open(path), false)
        }
        created => (created, true),
    };
    let mut file = match opened {
        Err(error) if error.kind() == ErrorKind::NotFound && path.parent().is_some_and(Path::exists) => {
            return Ok(None);
        }
        Err(error) if Errno::from_io_error(&error) == Some(Errno::LOOP) => {
            return Err(FileError::content("a regular file", "a link", path));
        }
        opened => opened.map_err(FileError::io("create", path))?,
    };
    let opened = file.metadata().map_err(FileError::io("read", path))?;
    if !opened.is_file() {
        return Err(FileError::content("a regular file", "something else", path));
    }
    if opened.nlink() > 1 {
        return Err(FileError::content("a temporary file of pskel", "a hard link to another file", path));
    }
    match file.try_lock() {
        Err(TryLockError::Error(error)) if has_no_locks(&error) => UNLOCKED.store(true, Ordering::Relaxed),
        Err(TryLockError::Error(error)) => {
            if is_new {
                let _ = std::fs::remove_file(path); // the first error is the one to report
            }
            return Err(FileError::io("lock", path)(error));
        }
        Err(TryLockError::WouldBlock) => return Err(busy(owner, &holder(&mut file))),
        Ok(()) => {}
    }
    let file = LockedFile(file);
    match std::fs::symlink_metadata(path) {
        Ok(named) if (named.dev(), named.ino()) == (opened.dev(), opened.ino()) => Ok(Some(file)),
        _ => Ok(None),
    }
}

/// Returns whether an error says that the file system has no locks: NFS without a lock service (ENOLCK), file
/// systems in user space and on clusters (ENOSYS, EOPNOTSUPP, EINVAL). Files are still replaced atomically
/// there.
fn has_no_locks(error: &Error) -> bool {
    let number = Errno::from_io_error(error);
    number
        .is_some_and(|number| [Errno::NOLCK, Errno::NOSYS, Errno::OPNOTSUPP, Errno::INVAL].contains(&number))
}

fn busy(owner: &Path, found: &str) -> FileError {
    FileError::Busy { found: found.to_owned(), path: owner.to_owned() }
}

/// Describes the process that holds a lock, with its id if the lock file has one.
fn holder(file: &mut File) -> String {
    let mut text = String::new();
    let read = file.seek(SeekFrom::Start(0)).and_then(|_| file.take(40).read_to_string(&mut text));
    let number = read.ok().and_then(|_| text.strip_prefix(SIGNATURE)?.trim_end().parse::<u32>().ok());
    number.map_or("another process".to_owned(), |number| format!("process {number}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_locked_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lock");
        let mut held = LockedFile::open(&path, Path::new("out")).unwrap();
        held.sign().unwrap();
        let message = LockedFile::open(&path, Path::new("out")).unwrap_err().to_string();
        let expected = format!("output is locked by process {}: out", std::process::id());
        assert_eq!(message, expected);
        drop(held);
        LockedFile::open(&path, Path::new("out")).unwrap();
    }

    #[test]
    fn rejects_links_and_folders_as_locks() {
        let folder = tempfile::tempdir().unwrap();
        let (target, link) = (folder.path().join("target"), folder.path().join("link"));
        std::fs::write(&target, "precious").unwrap();
        std::os::unix::fs::symlink(&target, &link).unwrap();
        assert!(LockedFile::open(&link, &link).is_err());
        let hard = folder.path().join("hard");
        std::fs::hard_link(&target, &hard).unwrap();
        let message = LockedFile::open(&hard, &link).unwrap_err().to_string();
        assert!(message.contains("found a hard link to another file: "), "{message}");
        assert!(LockedFile::open(folder.path(), &link).is_err());
        assert_eq!(std::fs::read(&target).unwrap(), b"precious");
    }
}
