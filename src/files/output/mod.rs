//! Output folders: each is locked by one process, which replaces only files written by earlier runs.
//!
//! # How it works
//! A folder lists the files written into it by runs (`.pskel-files`). A name may be written if it does not
//! exist, or if all files at or below it are listed. There are two kinds of folders:
//! - [`OutputFolder`] grows entry by entry (maps, rollouts, trainings). Whole-folder entries are written
//!   under temporary names in `OUT/.pskel`, then renamed. Foreign files beside them stay.
//! - [`WholeFolder`](super::WholeFolder) appears as a whole (skeletons, towns). It is written in
//!   `OUT.partial`, then swapped with an older folder in one step, so readers see either the old or the new
//!   one. It is refused if the older folder has foreign files.
//!
//! Folders that cannot be renamed are replaced file by file (`place`). A mount point has the work folder of a
//! whole folder inside. Links below an output folder are foreign: they are neither followed nor replaced.
//!
//! `.pskel` and `OUT.partial` hold the lock. They are removed when the run ends, also by a signal. After a
//! killed process, the next run that opens the output removes them.

pub(super) mod manifest;
pub(super) mod mounts;
pub(super) mod output_file;
pub(super) mod pending;
pub(super) mod place;
pub(super) mod shared_folder;
pub(super) mod whole;
pub(super) mod whole_folder;
pub(super) mod work;

use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use self::manifest::{Manifest, check_no_linked_folder, files_below, refusal};
use self::pending::{finish_undisturbed, remove};
use super::Inputs;

use self::work::{OWN_NAME, WorkFolder};
use super::resolved::resolved;
use crate::error::FileError;

/// Kinds of whole folders that accept no other output: it would be a foreign file for the next run that
/// writes them.
const CLOSED: [&str; 2] = [SKELETON, TEMPLATES];
/// Kind of a skeleton.
pub(crate) const SKELETON: &str = "skeleton";
/// Kind of a template library.
pub(crate) const TEMPLATES: &str = "templates";

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
    /// Fails if another process uses the folder, if it has another kind, if it is one of `inputs` or a part
    /// of one, if it is in a skeleton or a template library, if it is a link that leads nowhere, or on an I/O
    /// error.
    pub fn open(path: &Path, kind: &str, inputs: &Inputs) -> Result<Self, FileError> {
        check_place(path, inputs)?;
        if path.is_symlink() && !path.exists() {
            return Err(FileError::content("a folder or none", "a link that leads nowhere", path));
        }
        let new = NewFolder((!path.exists()).then(|| path.to_owned()));
        std::fs::create_dir_all(path).map_err(FileError::io("create", path))?;
        let work = WorkFolder::open(path.join(OWN_NAME), path)?;
        work.clear(|_| false)?;
        let manifest = Mutex::new(manifest_of(path, kind)?.unwrap_or(Manifest::new(kind)));
        Ok(Self { path: path.to_owned(), manifest, work, _new: new })
    }

    /// Returns the path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Checks that names of files and folders, relative to this folder, may be written; for use before any
    /// work is done.
    ///
    /// # Errors
    /// Returns an error that names the first file at or below a name that no earlier run wrote, or a link in
    /// its place.
    pub fn check<N: AsRef<Path>>(&self, names: impl IntoIterator<Item = N>) -> Result<(), FileError> {
        let manifest = self.manifest();
        names.into_iter().try_for_each(|name| self.check_one(&manifest, name.as_ref()))
    }

    /// Checks a name. A link is never what a run wrote, even if its name is listed.
    fn check_one(&self, manifest: &Manifest, name: &Path) -> Result<(), FileError> {
        manifest.check(&self.path, name)?;
        let path = self.path.join(name);
        if path.is_symlink() { Err(refusal(&path)) } else { Ok(()) }
    }

    /// Returns the path of a folder below this one that is an output of its own, with its own list and lock.
    ///
    /// # Errors
    /// Fails if it, or a folder on the way to it, is a link.
    pub fn folder(&self, name: impl AsRef<Path>) -> Result<PathBuf, FileError> {
        own_folder(&self.path, name)
    }

    /// Adds a file to the list and returns the path where the caller may write it.
    ///
    /// # Errors
    /// Fails if a file of that name exists that no earlier run wrote, if it is a link, or on an I/O error.
    pub fn claim(&self, name: impl AsRef<Path>) -> Result<PathBuf, FileError> {
        let name = name.as_ref();
        let mut manifest = self.manifest();
        self.check_one(&manifest, name)?;
        manifest.add(&self.path, [name.to_owned()].into())?;
        Ok(self.path.join(name))
    }

    /// Writes a whole folder below this one: `fill` writes a temporary folder, which is then renamed and
    /// replaces an older one.
    ///
    /// # Errors
    /// Returns any error of `fill`. Fails if the older folder has files that no earlier run wrote, or on an
    /// I/O error.
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
        self.check_one(&manifest, name)?;
        let files = files_below(new)?.iter().map(|file| name.join(file)).collect();
        manifest.add(&self.path, files)?;
        let path = self.path.join(name);
        if let Some(parent) = path.parent() {
            std::fs::create_dir_all(parent).map_err(FileError::io("create", parent))?;
        }
        let older = files_below(&path)?;
        finish_undisturbed(|| place::put(new, &path, &older))
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
            remove_emptied(&path).map_err(FileError::io("replace", &path))?;
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

/// Returns the path of a folder below an output folder that is an output of its own, with its own list and
/// lock.
///
/// # Errors
/// Fails if it, or a folder on the way to it, is a link.
pub fn own_folder(folder: &Path, name: impl AsRef<Path>) -> Result<PathBuf, FileError> {
    check_no_linked_folder(folder, &name.as_ref().join("file"))?;
    Ok(folder.join(name))
}

/// Removes a file or folder if it exists. A mount point stays, as an empty folder.
fn remove_emptied(path: &Path) -> std::io::Result<()> {
    match remove(path) {
        Err(error) if error.kind() == std::io::ErrorKind::ResourceBusy => {
            let is_empty = std::fs::read_dir(path)?.next().is_none();
            if is_empty { Ok(()) } else { Err(error) }
        }
        removed => removed,
    }
}

/// Removes `.` components from an output path, and resolves a link to a folder, so that the link itself is
/// not replaced.
pub fn resolved_output(path: PathBuf) -> PathBuf {
    let path: PathBuf = path.components().collect();
    if path.is_symlink() && path.is_dir() { path.canonicalize().unwrap_or(path) } else { path }
}

/// Checks, before any work, that an output folder that grows may be at a path.
///
/// # Errors
/// Fails if the path is one of `inputs` or a part of one, or if it is in a skeleton or a template library.
pub fn check_place(path: &Path, inputs: &Inputs) -> Result<(), FileError> {
    inputs.check_folder(path)?;
    check_above(path)
}

/// Checks that an output is not below a folder whose kind is [`CLOSED`].
pub(super) fn check_above(path: &Path) -> Result<(), FileError> {
    let place = resolved(path);
    let above = place.ancestors().skip(1);
    // Content of a work folder is temporary, also at a mount point.
    for folder in above.take_while(|folder| !folder.ends_with(OWN_NAME)) {
        // Folders above are the user's: a list that cannot be read is none of ours.
        let Ok(Some(manifest)) = Manifest::read(folder) else { continue };
        if CLOSED.contains(&manifest.kind.as_str()) {
            let expected = format!("an output outside of the {} {}", manifest.kind, folder.display());
            return Err(FileError::content(expected, "one in it", path));
        }
    }
    Ok(())
}

/// Reads the list of a folder, and fails if it has another kind.
pub(super) fn manifest_of(path: &Path, kind: &str) -> Result<Option<Manifest>, FileError> {
    match Manifest::read(path)? {
        Some(manifest) if manifest.kind != kind => {
            let expected = format!("a folder of kind {kind}, or a new one");
            Err(FileError::content(expected, format!("one of kind {}", manifest.kind), path))
        }
        manifest => Ok(manifest),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    fn write(folder: &OutputFolder, name: &str, text: &str) -> Result<(), FileError> {
        folder.write_folder(name, |new| {
            std::fs::write(new.join("a.png"), text).map_err(FileError::io("write", new))
        })
    }

    #[test]
    fn nothing_is_written_into_a_skeleton() {
        let folder = tempfile::tempdir().unwrap();
        let skeleton = folder.path().join("sk");
        std::fs::create_dir(&skeleton).unwrap();
        std::fs::write(skeleton.join("a.points"), "").unwrap();
        Manifest::of("skeleton", &[], &skeleton).unwrap().write(&skeleton).unwrap();
        for name in ["maps", "new/maps", "../sk/maps", "../none/../sk/maps"] {
            let opened = OutputFolder::open(&skeleton.join(name), "maps", &Inputs::default());
            let message = opened.unwrap_err().to_string();
            assert!(message.starts_with("expected an output outside of the skeleton "), "{message}");
        }
        OutputFolder::open(&skeleton.join("../maps"), "maps", &Inputs::default()).unwrap();
        std::fs::create_dir(skeleton.join(OWN_NAME)).unwrap();
        check_above(&skeleton.join(OWN_NAME).join("new")).unwrap();
    }

    #[test]
    fn links_in_the_folder_are_not_followed() {
        let (folder, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let path = folder.path().join("out");
        let open = || OutputFolder::open(&path, "maps", &Inputs::default());
        let files = open().unwrap();
        std::fs::write(files.claim("index").unwrap(), "1").unwrap();
        write(&files, "steps/0", "1").unwrap();
        files.close().unwrap();
        std::fs::create_dir(other.path().join("0")).unwrap();
        for name in ["0/a.png", "index", "lock"] {
            std::fs::write(other.path().join(name), "precious").unwrap();
        }
        std::fs::remove_dir_all(path.join("steps")).unwrap();
        std::fs::remove_file(path.join("index")).unwrap();
        symlink(other.path(), path.join("steps")).unwrap();
        symlink(other.path().join("index"), path.join("index")).unwrap();
        let files = open().unwrap();
        for refused in [
            files.claim("index").err(),
            files.claim("steps/0/a.png").err(),
            files.folder("steps").err(),
            files.folder("steps/0").err(),
            files.check(["steps"]).err(),
            files.remove(["steps/0"]).err(),
            write(&files, "steps/0", "2").err(),
        ] {
            let message = refused.unwrap().to_string();
            assert!(message.contains("found a link: "), "{message}");
        }
        drop(files);
        // A link in place of the work folder.
        symlink(other.path(), path.join(OWN_NAME)).unwrap();
        assert!(open().unwrap_err().to_string().contains("found a link"));
        for name in ["0/a.png", "index", "lock"] {
            assert_eq!(std::fs::read(other.path().join(name)).unwrap(), b"precious");
        }
        assert_eq!(std::fs::read_dir(other.path()).unwrap().count(), 3);
    }
}
