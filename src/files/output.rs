//! Output folders: each is locked by one process, which replaces only files written by earlier runs.
//!
//! # How it works
//! A folder lists the files written into it by runs (`.pskel-files`). A name may be written if it does not exist, or
//! if all files at or below it are listed. There are two kinds of folders:
//! - [`OutputFolder`] grows entry by entry (maps, rollouts, trainings). Whole-folder entries are written under
//!   temporary names in `OUT/.pskel`, then renamed. Foreign files beside them stay.
//! - [`WholeFolder`] appears as a whole (skeletons, towns). It is written in `OUT.partial`, then swapped with an
//!   older folder in one step, so readers see either the old or the new one. It is refused if the older folder has
//!   foreign files.
//!
//! `.pskel` and `OUT.partial` hold the lock. They are removed when the run ends, also by a signal. After a killed
//! process, the next run that opens the output removes them.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::manifest::{Manifest, files_below};
use super::pending::remove;
use super::work::WorkFolder;
use crate::error::FileError;

const WORK: &str = ".pskel";

/// Output folder that grows entry by entry.
#[derive(Debug)]
pub struct OutputFolder {
    path: PathBuf,
    manifest: Mutex<Manifest>,
    work: WorkFolder,
    /// Dropped last.
    _new: NewFolder,
}

/// Folder that is removed on drop if it is empty.
#[derive(Debug)]
struct NewFolder(Option<PathBuf>);

impl Drop for NewFolder {
    fn drop(&mut self) {
        if let Some(path) = &self.0 {
            let _ = std::fs::remove_dir(path); // fails if it is not empty
        }
    }
}

impl OutputFolder {
    /// Opens a folder for a kind of content (`maps`, `rollout`, ...), and creates it if it does not exist.
    ///
    /// # Errors
    /// Fails if another process uses the folder, if it has another kind or is one of `inputs`, or on an I/O error.
    pub fn open(path: &Path, kind: &str, inputs: &[&Path]) -> Result<Self, FileError> {
        check_apart(path, inputs)?;
        let new = NewFolder((!path.exists()).then(|| path.to_owned()));
        std::fs::create_dir_all(path).map_err(FileError::io("create", path))?;
        let work = WorkFolder::open(path.join(WORK), path)?;
        work.clear(|_| false)?;
        let manifest = Mutex::new(manifest_of(path, kind)?.unwrap_or(Manifest::new(kind)));
        Ok(Self { path: path.to_owned(), manifest, work, _new: new })
    }

    /// Returns the path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Checks that names of files and folders, relative to this folder, may be written; for use before any work is
    /// done.
    ///
    /// # Errors
    /// Returns an error that names the first file at or below a name that no earlier run wrote.
    pub fn check<N: AsRef<Path>>(&self, names: impl IntoIterator<Item = N>) -> Result<(), FileError> {
        let manifest = self.manifest();
        names.into_iter().try_for_each(|name| manifest.check(&self.path, name.as_ref()))
    }

    /// Adds a file to the list and returns the path where the caller may write it.
    ///
    /// # Errors
    /// Fails if a file of that name exists that no earlier run wrote, or on an I/O error.
    pub fn claim(&self, name: impl AsRef<Path>) -> Result<PathBuf, FileError> {
        let name = name.as_ref();
        let mut manifest = self.manifest();
        manifest.check(&self.path, name)?;
        manifest.add(&self.path, [name.to_owned()].into())?;
        Ok(self.path.join(name))
    }

    /// Writes a whole folder below this one: `fill` writes a temporary folder, which is then renamed and replaces an
    /// older one.
    ///
    /// # Errors
    /// Returns any error of `fill`. Fails if the older folder has files that no earlier run wrote, or on an I/O
    /// error.
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
        let _ = remove(&new); // the older folder, or leftovers of `fill`; the next owner removes them too
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

    /// Removes files and folders of earlier runs if they exist.
    ///
    /// # Errors
    /// Fails without removing anything if a file was not written by an earlier run. Fails on an I/O error.
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

    /// Ends the run: rewrites the list of files, sorted and without the removed ones.
    ///
    /// # Errors
    /// Fails if the list cannot be written.
    pub fn close(self) -> Result<(), FileError> {
        let manifest = self.manifest();
        if manifest.is_empty() { Ok(()) } else { manifest.write(&self.path) }
    }

    fn manifest(&self) -> MutexGuard<'_, Manifest> {
        self.manifest.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Output folder that appears as a whole.
#[derive(Debug)]
pub struct WholeFolder {
    path: PathBuf,
    kind: &'static str,
    work: WorkFolder,
}

impl WholeFolder {
    /// Opens a work folder for content of a kind (`skeleton`, ...) that is to appear at `path`.
    ///
    /// # Errors
    /// Fails if another process writes this output, if [`check_whole`] rejects `path`, if `path` is one of `inputs`,
    /// or on an I/O error.
    pub fn open(path: &Path, kind: &'static str, inputs: &[&Path]) -> Result<Self, FileError> {
        check_apart(path, inputs)?;
        check_whole(path, kind)?;
        let work = WorkFolder::open(work_of_whole(path), path)?;
        work.clear(|_| false)?;
        Ok(Self { path: path.to_owned(), kind, work })
    }

    /// Returns a folder for temporary files on the same file system.
    pub fn scratch(&self) -> &Path {
        self.work.path()
    }

    /// Writes the folder: `fill` writes into an empty folder, which then replaces an older one.
    ///
    /// # Errors
    /// Returns any error of `fill`. Fails if [`check_whole`] rejects the path, or on an I/O error.
    pub fn write<E: From<FileError>>(self, fill: impl FnOnce(&Path) -> Result<(), E>) -> Result<(), E> {
        write_whole_by(&self.work, &self.path, self.kind, fill)
    }
}

/// Writes a [`WholeFolder`] by means of a work folder that the caller has opened at [`work_of_whole`].
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
    let _ = remove(&new); // the older folder, or leftovers of `fill`; the next owner removes them too
    written
}

/// Returns the path of the work folder of a [`WholeFolder`], `OUT.partial`.
pub(crate) fn work_of_whole(path: &Path) -> PathBuf {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    path.with_file_name(format!("{name}.partial"))
}

/// Removes `.` components from an output path, and resolves a link to a folder, so that the link itself is not
/// replaced.
pub fn resolved_output(path: PathBuf) -> PathBuf {
    let path: PathBuf = path.components().collect();
    if path.is_symlink() && path.is_dir() { path.canonicalize().unwrap_or(path) } else { path }
}

/// Checks that a whole folder may be written at `path`: it does not exist, is empty, or is a folder of the same kind
/// that holds only files written by runs.
///
/// # Errors
/// Fails if anything else exists at the path, if the path has no file name, or on an I/O error.
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

/// Reads the list of a folder, and fails if it has another kind.
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

/// Renames a folder. If the target exists, both are swapped in one step, so the path is never empty.
fn put(new: &Path, path: &Path) -> Result<(), FileError> {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    let is_older = path.symlink_metadata().is_ok();
    if is_older && renameat_with(CWD, new, CWD, path, RenameFlags::EXCHANGE).is_ok() {
        return Ok(());
    }
    // Not every file system supports the exchange.
    let old = new.with_extension("old");
    if is_older {
        std::fs::rename(path, &old).map_err(FileError::io("replace", path))?;
    }
    let renamed = std::fs::rename(new, path).map_err(FileError::io("rename to", path));
    if is_older && renamed.is_err() {
        let _ = std::fs::rename(&old, path); // the first error is the one to report
    }
    renamed
}
