//! Folders for temporary files, locked by the process that works in them.

use std::path::{Path, PathBuf};

use super::lock::LockedFile;
use super::pending::{PendingPath, remove};
use crate::error::FileError;

const LOCK: &str = "lock";
/// Attempts to lock a folder that another process is removing.
const TRIES: usize = 100;

/// Locked folder. Unless it is retained, it is removed with its content on drop or by a signal.
#[derive(Debug)]
pub struct WorkFolder {
    path: PathBuf,
    lock: Option<LockedFile>,
    /// `None` for a retained folder.
    pending: Option<PendingPath>,
}

impl WorkFolder {
    /// Creates and locks the folder at `path`, or takes over one left by a dead process, including its content.
    /// `owner` is the output that the work is for.
    ///
    /// # Errors
    /// Fails if another process uses it, if the folder is not a work folder, or on an I/O error.
    pub fn open(path: PathBuf, owner: &Path) -> Result<Self, FileError> {
        let lock_path = path.join(LOCK);
        for _ in 0..TRIES {
            std::fs::create_dir_all(&path).map_err(FileError::io("create", &path))?;
            let is_empty = || std::fs::read_dir(&path).is_ok_and(|mut entries| entries.next().is_none());
            if !lock_path.is_file() && !is_empty() {
                continue; // a foreign folder, or one that another process is locking
            }
            match LockedFile::open(&lock_path, owner) {
                Ok(mut lock) => {
                    let signed = lock.sign();
                    let pending = Some(PendingPath::new(&path));
                    let work = Self { path, lock: Some(lock), pending };
                    // On a full disk, dropping `work` removes the folder.
                    signed.map_err(FileError::io("write", &lock_path))?;
                    return Ok(work);
                }
                Err(_) if !path.exists() => {}
                Err(error) => return Err(error),
            }
        }
        Err(FileError::content("a folder of an unfinished run, or none", "another folder", &path))
    }

    /// Returns the path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns whether the folder is retained on drop.
    pub(crate) fn is_kept(&self) -> bool {
        self.pending.is_none()
    }

    /// Sets whether the folder is retained on drop and when a signal ends the process.
    pub(crate) fn keep(&mut self, is_kept: bool) {
        if is_kept != self.is_kept() {
            self.pending = (!is_kept).then(|| PendingPath::new(&self.path));
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
        if self.is_kept() {
            return;
        }
        // After a failure here, the next owner clears the folder.
        let _ = self.clear(|_| false);
        // The lock file is removed while it is locked, so no other process locks the removed file. If another process
        // has locked the folder since, it is not empty and stays.
        let _ = std::fs::remove_file(self.path.join(LOCK));
        let _ = std::fs::remove_dir(&self.path);
        drop(self.lock.take());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_owner_at_a_time_and_nothing_is_left() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("work");
        let open = || WorkFolder::open(path.clone(), Path::new("out"));
        let work = open().unwrap();
        assert!(
            open().unwrap_err().to_string().starts_with("expected no other process at work on this output")
        );
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
    fn a_foreign_folder_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("notes"), "mine").unwrap();
        assert!(WorkFolder::open(folder.path().to_owned(), Path::new("out")).is_err());
        assert_eq!(std::fs::read(folder.path().join("notes")).unwrap(), b"mine");
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
