//! Registry of this process's temporary paths, which are removed when a signal ends it.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError, RwLock};
use std::time::Duration;

static PENDING: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());
/// Shared by threads that move finished files to their names.
static MOVING: RwLock<()> = RwLock::new(());

/// Attempts to remove a folder while other threads may still create files in it.
const TRIES: usize = 20;
const PAUSE: Duration = Duration::from_millis(5);

/// Temporary path that is registered until this value is dropped.
#[derive(Debug)]
pub(in super::super) struct PendingPath(PathBuf);

impl PendingPath {
    /// Registers a path before anything is created there.
    pub(in super::super) fn new(path: &Path) -> Self {
        lock().insert(path.to_owned());
        Self(path.to_owned())
    }
}

impl Drop for PendingPath {
    fn drop(&mut self) {
        lock().remove(&self.0);
    }
}

/// Runs a short piece of work that a signal must not interrupt: [`remove_pending`] waits for its end. Not to
/// be nested.
pub(in super::super) fn finish_undisturbed<T>(work: impl FnOnce() -> T) -> T {
    let _moving = MOVING.read().unwrap_or_else(PoisonError::into_inner);
    work()
}

/// Removes all temporary files and folders of a process that is about to end. Afterwards, every thread that
/// begins or finishes a file blocks.
pub fn remove_pending() {
    let moving = MOVING.write().unwrap_or_else(PoisonError::into_inner);
    let pending = lock();
    for path in pending.iter() {
        for _ in 0..TRIES {
            if remove(path).is_ok() {
                break;
            }
            std::thread::sleep(PAUSE);
        }
    }
    std::mem::forget(pending);
    std::mem::forget(moving);
}

/// Removes a file, a link or a whole folder, if it exists.
pub(in super::super) fn remove(path: &Path) -> std::io::Result<()> {
    let is_folder = std::fs::symlink_metadata(path).is_ok_and(|data| data.is_dir());
    let removed = if is_folder { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
    match removed {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

fn lock() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    PENDING.lock().unwrap_or_else(PoisonError::into_inner)
}
