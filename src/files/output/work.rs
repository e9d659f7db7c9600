//! Folders for temporary files, locked by the process that works in them.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::pending::{PendingPath, remove};
use crate::error::FileError;
use crate::files::lock::{LockContent, LockedFile};

const LOCK: &str = "lock";
/// Name of work folders inside an output folder.
pub(in super::super) const OWN_NAME: &str = ".pskel";
/// Attempts to lock a folder that another process is removing.
const TRIES: usize = 100;

/// Locked folder. Unless it is retained, it is removed with its content on drop or by a signal. Its lock file
/// has a signature that distinguishes folders of killed processes from foreign ones.
#[derive(Debug)]
pub struct WorkFolder {
    path: PathBuf,
    lock: Option<LockedFile>,
    /// `None` for a retained folder.
    pending: Option<PendingPath>,
}

impl WorkFolder {
    /// Creates and locks the folder at `path`, or takes over one left by a dead process, including its
    /// content. `owner` is the output that the work is for.
    ///
    /// # Errors
    /// Fails if another process uses it, if the path is a link or a folder without a signed lock, or on an
    /// I/O error. Nothing that was created is left then.
    pub fn open(path: PathBuf, owner: &Path) -> Result<Self, FileError> {
        let lock_path = path.join(LOCK);
        for _ in 0..TRIES {
            let is_new = create(&path)?;
            if !lock_path.is_file() && !is_empty(&path) {
                continue; // a foreign folder, or one that another process is locking
            }
            match LockedFile::open(&lock_path, owner) {
                Ok(mut lock) => {
                    if !is_own(&mut lock, &path).map_err(FileError::io("read", &lock_path))? {
                        break;
                    }
                    let signed = lock.sign();
                    let pending = Some(PendingPath::new(&path));
                    let work = Self { path, lock: Some(lock), pending };
                    // On a full disk, dropping `work` removes the folder.
                    signed.map_err(FileError::io("write", &lock_path))?;
                    return Ok(work);
                }
                Err(_) if !path.exists() => {}
                Err(error) => {
                    if is_new {
                        let _ = std::fs::remove_dir(&path); // the first error is the one to report
                    }
                    return Err(error);
                }
            }
        }
        Err(foreign("another folder", &path))
    }

    /// Returns the path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns whether the folder is retained on drop.
    pub(crate) fn is_retained(&self) -> bool {
        self.pending.is_none()
    }

    /// Sets whether the folder is retained on drop and when a signal ends the process.
    pub(crate) fn keep(&mut self, is_retained: bool) {
        if is_retained != self.is_retained() {
            self.pending = (!is_retained).then(|| PendingPath::new(&self.path));
        }
    }

    /// Removes everything except the lock and the entries for which `keeps` returns `true`.
    ///
    /// # Errors
    /// Fails if the folder cannot be read or an entry cannot be deleted.
    pub fn clear(&self, keeps: impl Fn(&str) -> bool) -> Result<(), FileError> {
        for entry in std::fs::read_dir(&self.path).map_err(FileError::io("read", &self.path))? {
            let entry = entry.map_err(FileError::io("read", &self.path))?;
            let name = entry.file_name();
            let name = name.to_string_lossy();
            if name != LOCK && !keeps(&name) {
                remove(&entry.path()).map_err(FileError::io("delete", &entry.path()))?;
            }
        }
        Ok(())
    }
}

impl Drop for WorkFolder {
    fn drop(&mut self) {
        if self.is_retained() {
            return;
        }
        // After a failure here, the next owner clears the folder, which it knows by its lock.
        if self.clear(|_| false).is_err() {
            return;
        }
        // The lock file is removed while it is locked, so no other process locks the removed file. If another
        // process has locked the folder since, it is not empty and stays.
        let _ = std::fs::remove_file(self.path.join(LOCK));
        let _ = std::fs::remove_dir(&self.path);
        drop(self.lock.take());
    }
}

/// Creates a folder and its parents. Returns whether it is new.
fn create(path: &Path) -> Result<bool, FileError> {
    if let Some(parent) = path.parent() {
        std::fs::create_dir_all(parent).map_err(FileError::io("create", path))?;
    }
    match std::fs::create_dir(path) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == ErrorKind::AlreadyExists => match path.symlink_metadata() {
            Ok(data) if data.is_symlink() => Err(foreign("a link", path)),
            Ok(data) if !data.is_dir() => Err(foreign("a file", path)),
            _ => Ok(false),
        },
        Err(error) => Err(FileError::io("create", path)(error)),
    }
}

/// Returns whether a locked folder is one of an unfinished run. A process that was killed before it signed
/// its lock leaves an empty lock and nothing else. Of earlier versions, which wrote a number alone, only
/// folders with a name that no other program uses are recognized.
fn is_own(lock: &mut LockedFile, path: &Path) -> std::io::Result<bool> {
    Ok(match lock.content()? {
        LockContent::Signed => true,
        LockContent::Number => path.ends_with(OWN_NAME),
        LockContent::Empty => std::fs::read_dir(path)?.count() == 1,
        LockContent::Other => false,
    })
}

fn is_empty(path: &Path) -> bool {
    std::fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_none())
}

fn foreign(found: &str, path: &Path) -> FileError {
    FileError::content("a folder of an unfinished run, or none", found, path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_owner_at_a_time_and_the_folder_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("work");
        let open = || WorkFolder::open(path.clone(), Path::new("out"));
        let work = open().unwrap();
        assert!(open().unwrap_err().to_string().starts_with("output is locked by"));
        std::fs::create_dir(path.join("new")).unwrap();
        drop(work);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        // A retained folder is taken over with its content.
        let mut work = open().unwrap();
        std::fs::write(path.join("checkpoint"), "1").unwrap();
        work.keep(true);
        drop(work);
        let work = open().unwrap();
        work.clear(|name| name == "checkpoint").unwrap();
        assert!(path.join("checkpoint").is_file());
        drop(work);
        assert!(path.join("checkpoint").is_file() == path.exists());
    }

    #[test]
    fn a_foreign_folder_is_not_touched() {
        // Without a lock, with a lock file of another program, and with one that is empty.
        for lock in [None, Some("4711"), Some("")] {
            let folder = tempfile::tempdir().unwrap();
            std::fs::write(folder.path().join("notes"), "mine").unwrap();
            lock.map_or(Ok(()), |text| std::fs::write(folder.path().join(LOCK), text)).unwrap();
            let message =
                WorkFolder::open(folder.path().to_owned(), Path::new("out")).unwrap_err().to_string();
            assert!(message.starts_with("expected a folder of an unfinished run, or none"), "{message}");
            assert_eq!(std::fs::read(folder.path().join("notes")).unwrap(), b"mine");
            assert_eq!(std::fs::read_to_string(folder.path().join(LOCK)).ok().as_deref(), lock);
        }
    }

    #[test]
    fn links_are_not_followed() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("other")).unwrap();
        drop(WorkFolder::open(at("other/work"), Path::new("out")).unwrap());
        std::os::unix::fs::symlink("other", at("link")).unwrap();
        std::os::unix::fs::symlink("nothing", at("dangling")).unwrap();
        for name in ["link", "dangling"] {
            let message = WorkFolder::open(at(name), Path::new("out")).unwrap_err().to_string();
            assert!(message.contains("found a link"), "{message}");
            assert!(at(name).is_symlink() && !at("nothing").exists());
        }
    }

    /// A process that was killed before it signed its lock.
    #[test]
    fn a_folder_with_only_an_empty_lock_is_taken_over() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("work");
        std::fs::create_dir(&path).unwrap();
        std::fs::write(path.join(LOCK), "").unwrap();
        drop(WorkFolder::open(path.clone(), Path::new("out")).unwrap());
        assert!(!path.exists());
    }

    /// Threads replace processes here: locks belong to open files.
    #[test]
    fn owners_take_turns() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("work");
        let inside = std::sync::atomic::AtomicUsize::new(0);
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    for _ in 0..300 {
                        let Ok(work) = WorkFolder::open(path.clone(), Path::new("out")) else { continue };
                        use std::sync::atomic::Ordering::SeqCst;
                        assert_eq!(inside.fetch_add(1, SeqCst), 0);
                        std::fs::write(path.join("file"), "1").unwrap();
                        inside.fetch_sub(1, SeqCst);
                        drop(work);
                    }
                });
            }
        });
        assert!(!path.exists());
    }
}
