//! Output folders: one process at a time writes one, and it replaces only what earlier runs wrote.
//!
//! # How it works
//! A folder lists the files that runs wrote into it (`.pskel-files`). A name may be written if nothing is there, or if
//! all files there are in the list. There are two kinds of folders:
//! - [`OutputFolder`] grows entry by entry (maps, rollouts, trainings). Entries are written under temporary names in
//!   `OUT/.pskel`, then renamed. Foreign files beside them stay.
//! - [`WholeFolder`] appears as a whole (skeletons, towns). It is written in `OUT.partial`, then changes places with an
//!   older one in one step, so readers see the old or the new one. Foreign files in the older one are refused.
//!
//! `.pskel` and `OUT.partial` hold the lock. They go with the run, by a signal too; those of a killed process go when
//! the next run opens the output.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::manifest::{Manifest, files_below};
use super::pending::remove;
use super::work::WorkFolder;
use crate::error::FileError;

const WORK: &str = ".pskel";

/// A folder that grows entry by entry.
#[derive(Debug)]
pub struct OutputFolder {
    path: PathBuf,
    manifest: Mutex<Manifest>,
    work: WorkFolder,
    /// Dropped last.
    _new: NewFolder,
}

/// A folder that goes again if it is empty on drop.
#[derive(Debug)]
struct NewFolder(Option<PathBuf>);

impl Drop for NewFolder {
    fn drop(&mut self) {
        if let Some(path) = &self.0 {
            let _ = std::fs::remove_dir(path); // fails where it is not empty
        }
    }
}

impl OutputFolder {
    /// Opens a folder for a kind of content (`maps`, `rollout`, ...); it is created where it is missing.
    ///
    /// # Errors
    /// Another process is at work there; a folder of another kind; one of `inputs`; the system's.
    pub fn open(path: &Path, kind: &str, inputs: &[&Path]) -> Result<Self, FileError> {
        check_apart(path, inputs)?;
        let new = NewFolder((!path.exists()).then(|| path.to_owned()));
        std::fs::create_dir_all(path).map_err(FileError::io("create", path))?;
        let work = WorkFolder::open(path.join(WORK), path)?;
        work.clear(|_| false)?;
        let manifest = Mutex::new(manifest_of(path, kind)?.unwrap_or(Manifest::new(kind)));
        Ok(Self { path: path.to_owned(), manifest, work, _new: new })
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether an earlier run has written into the folder.
    pub fn has_files(&self) -> bool {
        !self.manifest().is_empty()
    }

    /// Checks that names may be written, before any work is done: files and folders, relative to the folder.
    ///
    /// # Errors
    /// The first file of a name or below it that no earlier run wrote.
    pub fn check<N: AsRef<Path>>(&self, names: impl IntoIterator<Item = N>) -> Result<(), FileError> {
        let manifest = self.manifest();
        names.into_iter().try_for_each(|name| manifest.check(&self.path, name.as_ref()))
    }

    /// Path of a file that the caller writes next, now in the list.
    ///
    /// # Errors
    /// A file of that name that no earlier run wrote; the system's.
    pub fn claim(&self, name: impl AsRef<Path>) -> Result<PathBuf, FileError> {
        let name = name.as_ref();
        let mut manifest = self.manifest();
        manifest.check(&self.path, name)?;
        manifest.add(&self.path, [name.to_owned()].into())?;
        Ok(self.path.join(name))
    }

    /// Writes a whole folder below this one: `fill` gets a temporary one, which is renamed. An older one is replaced.
    ///
    /// # Errors
    /// Those of `fill`; files in the older one that no earlier run wrote; the system's.
    pub fn write_folder<E: From<FileError>>(
        &self,
        name: impl AsRef<Path>,
        fill: impl FnOnce(&Path) -> Result<(), E>,
    ) -> Result<(), E> {
        let name = name.as_ref();
        let flat = name.to_string_lossy().replace('/', "_");
        let new = self.work.path().join(flat);
        std::fs::create_dir(&new).map_err(FileError::io("create", &new))?;
        let written = fill(&new).and_then(|()| Ok(self.put(&new, name)?));
        let _ = remove(&new); // the older folder, or what `fill` left; the next owner removes it too
        written
    }

    fn put(&self, new: &Path, name: &Path) -> Result<(), FileError> {
        let mut manifest = self.manifest();
        manifest.check(&self.path, name)?;
        let files = files_below(new)?.iter().map(|file| name.join(file)).collect();
        manifest.add(&self.path, files)?;
        let path = self.path.join(name);
        if let Some(parent) = path.parent() {
            std::fs::create_dir_all(parent).map_err(FileError::io("create", parent))?;
        }
        put(new, &path)
    }

    /// Removes files and folders of earlier runs, where they exist.
    ///
    /// # Errors
    /// A file that no earlier run wrote: nothing is removed then; the system's.
    pub fn remove<N: AsRef<Path>>(
        &self,
        names: impl IntoIterator<Item = N> + Clone,
    ) -> Result<(), FileError> {
        self.check(names.clone())?;
        let mut manifest = self.manifest();
        for name in names {
            let path = self.path.join(name.as_ref());
            remove(&path).map_err(FileError::io("replace", &path))?;
            manifest.forget(name.as_ref());
        }
        Ok(())
    }

    /// Ends the run: the list of files is written anew, sorted and without those that were removed.
    ///
    /// # Errors
    /// The system's.
    pub fn close(self) -> Result<(), FileError> {
        let manifest = self.manifest();
        if manifest.is_empty() { Ok(()) } else { manifest.write(&self.path) }
    }

    fn manifest(&self) -> MutexGuard<'_, Manifest> {
        self.manifest.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A folder that appears as a whole.
#[derive(Debug)]
pub struct WholeFolder {
    path: PathBuf,
    kind: &'static str,
    work: WorkFolder,
}

impl WholeFolder {
    /// Begins a folder for a kind of content (`skeleton`, ...) at `path`.
    ///
    /// # Errors
    /// Another process is at work on it; something else at `path`; `path` is one of `inputs`; the system's.
    pub fn open(path: &Path, kind: &'static str, inputs: &[&Path]) -> Result<Self, FileError> {
        check_apart(path, inputs)?;
        check_whole(path, kind)?;
        let work = WorkFolder::open(work_of_whole(path), path)?;
        work.clear(|_| false)?;
        Ok(Self { path: path.to_owned(), kind, work })
    }

    /// A folder for temporary files, on the same file system.
    pub fn scratch(&self) -> &Path {
        self.work.path()
    }

    /// Writes the folder: `fill` gets an empty one, which then takes the place of an older one.
    ///
    /// # Errors
    /// Those of `fill`; something else at the path; the system's.
    pub fn write<E: From<FileError>>(self, fill: impl FnOnce(&Path) -> Result<(), E>) -> Result<(), E> {
        write_whole_by(&self.work, &self.path, self.kind, fill)
    }
}

/// Writes a [`WholeFolder`] in a work folder that the caller owns, [`work_of_whole`].
pub(crate) fn write_whole_by<E: From<FileError>>(
    work: &WorkFolder,
    path: &Path,
    kind: &str,
    fill: impl FnOnce(&Path) -> Result<(), E>,
) -> Result<(), E> {
    const NEW: &str = "new";
    let new = work.path().join(NEW);
    std::fs::create_dir(&new).map_err(FileError::io("create", &new))?;
    let written = fill(&new).and_then(|()| {
        Manifest::of(kind, &new)?.write(&new)?;
        check_whole(path, kind)?;
        Ok(put(&new, path)?)
    });
    let _ = remove(&new); // the older folder, or what `fill` left; the next owner removes it too
    written
}

/// Where a [`WholeFolder`] is written: `OUT.partial`.
pub(crate) fn work_of_whole(path: &Path) -> PathBuf {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    path.with_file_name(format!("{name}.partial"))
}

/// Path of an output without `.` in it; of a link to a folder the folder's, which would else be replaced itself.
pub(crate) fn resolved_output(path: PathBuf) -> PathBuf {
    let path: PathBuf = path.components().collect();
    if path.is_symlink() && path.is_dir() { path.canonicalize().unwrap_or(path) } else { path }
}

/// Checks that a whole folder may be written: nothing is at `path`, or an empty folder, or one of the same kind that holds
/// only what a run wrote.
///
/// # Errors
/// Something else is there.
pub fn check_whole(path: &Path, kind: &str) -> Result<(), FileError> {
    if path.file_name().is_none() {
        return Err(FileError::content(
            "the name of a folder to write",
            "a path that ends without one",
            path,
        ));
    }
    if path.is_symlink() {
        return Err(FileError::content("a folder or none", "a link", path));
    }
    if path.is_dir() {
        let manifest = manifest_of(path, kind)?.unwrap_or(Manifest::new(kind));
        return manifest.check(path, Path::new(""));
    }
    match path.symlink_metadata() {
        Ok(_) => Err(FileError::content("a folder or none", "a file", path)),
        Err(_) => Ok(()),
    }
}

/// The list of a folder, which must be of this kind.
fn manifest_of(path: &Path, kind: &str) -> Result<Option<Manifest>, FileError> {
    match Manifest::read(path)? {
        Some(manifest) if manifest.kind != kind => {
            let expected = format!("a folder of kind {kind}, or a new one");
            Err(FileError::content(expected, format!("one of kind {}", manifest.kind), path))
        }
        manifest => Ok(manifest),
    }
}

/// Checks that an output folder is none of the inputs.
fn check_apart(path: &Path, inputs: &[&Path]) -> Result<(), FileError> {
    let Ok(found) = path.canonicalize() else { return Ok(()) };
    match inputs.iter().find(|input| input.canonicalize().is_ok_and(|input| input == found)) {
        None => Ok(()),
        Some(input) => {
            let expected = format!("an output apart from the input {}", input.display());
            Err(FileError::content(expected, "the same", path))
        }
    }
}

/// Renames a folder. One that is there changes places with it in one step, so that at every moment there is one.
fn put(new: &Path, path: &Path) -> Result<(), FileError> {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    let is_older = path.symlink_metadata().is_ok();
    if is_older && renameat_with(CWD, new, CWD, path, RenameFlags::EXCHANGE).is_ok() {
        return Ok(());
    }
    // Not every file system can do this.
    let old = new.with_extension("old");
    if is_older {
        std::fs::rename(path, &old).map_err(FileError::io("replace", path))?;
    }
    let renamed = std::fs::rename(new, path).map_err(FileError::io("rename to", path));
    if is_older && renamed.is_err() {
        let _ = std::fs::rename(&old, path); // the error says what went wrong before
    }
    renamed
}
