//! Output folders that appear as a whole.

use std::path::{Path, PathBuf};

use super::manifest::Manifest;
use super::pending::{finish_undisturbed, remove};
use super::work::{OWN_NAME, WorkFolder};
use super::{check_above, manifest_of};
use super::{mounts, place};
use crate::error::FileError;
use crate::files::Inputs;

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
    /// Fails if another process writes this output, if [`check_whole`] rejects `path`, or on an I/O error.
    pub fn open(path: &Path, kind: &'static str, inputs: &Inputs) -> Result<Self, FileError> {
        check_whole(path, kind, inputs)?;
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
        write_whole_by(&self.work, &self.path, (self.kind, &[]), fill)
    }
}

/// Writes a [`WholeFolder`] of a kind and with fingerprints of its inputs, by means of a work folder that the
/// caller has opened at [`work_of_whole`].
pub(crate) fn write_whole_by<E: From<FileError>>(
    work: &WorkFolder,
    path: &Path,
    (kind, inputs): (&str, &[String]),
    fill: impl FnOnce(&Path) -> Result<(), E>,
) -> Result<(), E> {
    const NEW: &str = "new";
    let new = work.path().join(NEW);
    std::fs::create_dir(&new).map_err(FileError::io("create", &new))?;
    let written = fill(&new).and_then(|()| {
        let manifest = Manifest::of(kind, inputs, &new)?;
        manifest.write(&new)?;
        check_whole(path, kind, &Inputs::default())?;
        Ok(finish_undisturbed(|| put(&new, path, &manifest))?)
    });
    let _ = remove(&new); // the older folder, or leftovers of `fill`; the next owner removes them too
    written
}

/// Moves a new folder to its path. Where that is a mount point or another folder that cannot be renamed, its
/// files are replaced one by one; until that is done, the list has both the old and the new ones.
fn put(new: &Path, path: &Path, manifest: &Manifest) -> Result<(), FileError> {
    let older = if path.is_dir() { Manifest::read(path)? } else { None };
    let older = older.unwrap_or(Manifest::new(&manifest.kind));
    if !is_replaced_by_files(path, new) {
        return place::put(new, path, older.paths());
    }
    manifest.clone().with(&older).write(path)?;
    place::replace_files(new, path, older.paths())?;
    manifest.write(path)
}

/// Returns whether a folder exists and cannot be renamed. `scratch` is a folder on its file system.
fn is_replaced_by_files(path: &Path, scratch: &Path) -> bool {
    // A folder with content is never replaced by a rename; other errors come first.
    path.is_dir()
        && matches!(std::fs::rename(path, scratch),
        Err(error) if mounts::is_fixed(&error) || is_above(&error))
}

/// Returns whether an error of a rename says that the target is below the source.
fn is_above(error: &std::io::Error) -> bool {
    error.kind() == std::io::ErrorKind::InvalidInput
}

/// Returns the path of the work folder of a [`WholeFolder`]: `OUT.partial`, or `OUT/.pskel` if `OUT` is a
/// mount point or if nothing can be created beside it.
pub(crate) fn work_of_whole(path: &Path) -> PathBuf {
    if has_work_inside(path) {
        return path.join(OWN_NAME);
    }
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    path.with_file_name(format!("{name}.partial"))
}

fn has_work_inside(path: &Path) -> bool {
    path.is_dir() && !path.is_symlink() && (mounts::is_mounted(path) || mounts::is_beside_read_only(path))
}

/// Checks that a whole folder may be written at `path`: it does not exist, is empty, or is a folder of the
/// same kind that holds only files written by runs, and it neither is nor contains an input.
///
/// # Errors
/// Fails if anything else exists at the path, if the path has no file name, if it is in a skeleton or a
/// template library, or on an I/O error.
pub fn check_whole(path: &Path, kind: &str, inputs: &Inputs) -> Result<(), FileError> {
    let is_inside = has_work_inside(path);
    if path.file_name().is_none() && !is_inside {
        return Err(FileError::content(
            "the name of a folder to write",
            "a path that ends without one",
            path,
        ));
    }
    if path.is_symlink() {
        return Err(FileError::content("a folder or none", "a link", path));
    }
    check_above(path)?;
    if path.is_dir() {
        let manifest = manifest_of(path, kind).or_else(|error| inputs.check_same(path).and(Err(error)))?;
        let manifest = manifest.unwrap_or(Manifest::new(kind));
        match is_inside {
            true => manifest.check_mounted(path, OWN_NAME)?,
            false => manifest.check(path, Path::new(""))?,
        }
        return inputs.check_whole(path);
    }
    match path.symlink_metadata() {
        Ok(_) => Err(FileError::content("a folder or none", "a file", path)),
        Err(_) => Ok(()),
    }
}

/// Returns the fingerprints of the inputs that a folder of a kind was made from; none if they are unknown.
///
/// # Errors
/// Fails if the list of files cannot be read or is of another kind.
pub(crate) fn inputs_of_whole(path: &Path, kind: &str) -> Result<Vec<String>, FileError> {
    Ok(manifest_of(path, kind)?.map(|manifest| manifest.inputs).unwrap_or_default())
}
