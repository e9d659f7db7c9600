//! Checks that an output file replaces neither an input nor a part of another output.

use std::os::unix::fs::MetadataExt;
use std::path::Path;

use super::manifest::Manifest;
use super::whole::target;
use crate::error::FileError;

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

/// Checks early that a file can be written at the end of a run: that its folder exists, and that its path is a regular file or
/// none.
///
/// # Errors
/// Fails if that is not the case.
pub fn check_destination(path: &Path) -> Result<(), FileError> {
    let folder = parent(path);
    match folder.metadata() {
        Ok(data) if data.is_dir() => target(path).map(|_| ()),
        Ok(_) => Err(FileError::content("a file in a folder", "another file in its place", folder)),
        Err(error) => Err(FileError::io("read", folder)(error)),
    }
}

fn parent(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Checks that an output file is outside a folder written by the same run, whose files could replace it.
///
/// # Errors
/// Fails if the file is in the folder.
pub fn check_outside(path: &Path, folder: &Path) -> Result<(), FileError> {
    let resolved = |path: &Path| path.canonicalize().or_else(|_| std::path::absolute(path));
    match (resolved(parent(path)), resolved(folder)) {
        (Ok(parent), Ok(folder)) if parent.starts_with(&folder) => {
            let expected = format!("a file outside of the output {}", folder.display());
            Err(FileError::content(expected, "one in it", path))
        }
        _ => Ok(()),
    }
}
