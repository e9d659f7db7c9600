//! Moves finished files and folders to their final path, where possible in one step.
//!
//! Some folders cannot be renamed: mount points (EBUSY), and folders that stem from a lower layer of an
//! overlay (EXDEV). Their files are replaced one by one. JSON files, without which nothing reads the content,
//! go first and come last, so that a folder in between is incomplete rather than a mixture.

use std::collections::BTreeSet;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use rustix::fs::{CWD, RenameFlags, renameat_with};

use super::manifest::files_below;
use super::mounts::is_fixed;
use super::pending::remove;
use crate::error::FileError;

/// Moves a folder to a path. If a folder is there, both are swapped in one step, so the path is never empty.
/// If it cannot be renamed, its files `old` (relative paths) are replaced by the files of the new folder.
///
/// # Errors
/// Fails on an I/O error.
pub(in super::super) fn put(new: &Path, path: &Path, old: &BTreeSet<PathBuf>) -> Result<(), FileError> {
    let is_older = path.symlink_metadata().is_ok();
    if is_older && renameat_with(CWD, new, CWD, path, RenameFlags::EXCHANGE).is_ok() {
        return Ok(());
    }
    // Not every file system supports the exchange.
    let aside = new.with_extension("old");
    if is_older {
        match std::fs::rename(path, &aside) {
            Err(error) if is_fixed(&error) && path.is_dir() => return replace_files(new, path, old),
            renamed => renamed.map_err(FileError::io("replace", path))?,
        }
    }
    let renamed = match std::fs::rename(new, path) {
        Err(error) if is_fixed(&error) && !is_older => return replace_files(new, path, old),
        renamed => renamed.map_err(FileError::io("rename to", path)),
    };
    if is_older && renamed.is_err() {
        let _ = std::fs::rename(&aside, path); // the first error is the one to report
    }
    renamed
}

/// Replaces the files `old` in a folder by the files of a new one.
///
/// # Errors
/// Fails on an I/O error. The folder then lacks JSON files.
pub(in super::super) fn replace_files(
    new: &Path,
    path: &Path,
    old: &BTreeSet<PathBuf>,
) -> Result<(), FileError> {
    let files = files_below(new)?;
    let is_index = |name: &&PathBuf| name.extension().is_some_and(|extension| extension == "json");
    std::fs::create_dir_all(path).map_err(FileError::io("create", path))?;
    for name in old.iter().filter(is_index) {
        remove_listed(path, name)?;
    }
    for name in old.difference(&files).filter(|name| !is_index(name)) {
        remove_listed(path, name)?;
    }
    for name in files.iter().filter(|name| !is_index(name)) {
        move_entry(&new.join(name), &path.join(name))?;
    }
    files.iter().filter(is_index).try_for_each(|name| move_entry(&new.join(name), &path.join(name)))
}

/// Removes a file or an empty folder, and the folders above it that are then empty.
fn remove_listed(folder: &Path, name: &Path) -> Result<(), FileError> {
    let path = folder.join(name);
    let is_folder = path.symlink_metadata().is_ok_and(|data| data.is_dir());
    let removed = if is_folder { std::fs::remove_dir(&path) } else { std::fs::remove_file(&path) };
    match removed {
        Err(error) if !matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
            return Err(FileError::io("replace", &path)(error));
        }
        _ => {}
    }
    for above in name.ancestors().skip(1).filter(|above| *above != Path::new("")) {
        if std::fs::remove_dir(folder.join(above)).is_err() {
            break; // other files are in it
        }
    }
    Ok(())
}

/// Moves a file, a link or an empty folder. Between file systems, it is copied.
pub(in super::super) fn move_entry(from: &Path, to: &Path) -> Result<(), FileError> {
    let about = from.symlink_metadata().map_err(FileError::io("read", from))?;
    if about.is_dir() {
        return std::fs::create_dir_all(to).map_err(FileError::io("create", to));
    }
    if let Some(parent) = to.parent() {
        std::fs::create_dir_all(parent).map_err(FileError::io("create", parent))?;
    }
    match std::fs::rename(from, to) {
        Err(error) if error.kind() == ErrorKind::CrossesDevices && about.is_file() => {
            if to.is_symlink() {
                remove(to).map_err(FileError::io("replace", to))?; // it would be followed
            }
            super::whole::write_whole(to, |out| {
                let copied = std::fs::File::open(from).and_then(|mut file| std::io::copy(&mut file, out));
                copied.map(drop).map_err(FileError::io("write", to))
            })
        }
        Err(error) if error.kind() == ErrorKind::CrossesDevices => {
            let copied = std::fs::read_link(from).and_then(|target| {
                remove(to)?;
                std::os::unix::fs::symlink(target, to)
            });
            copied.map_err(FileError::io("link", to))
        }
        renamed => renamed.map_err(FileError::io("rename to", to)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Writes files with their names and a text as content.
    fn fill(folder: &Path, names: &[&str], text: &str) {
        for name in names {
            let path = folder.join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, format!("{name} {text}")).unwrap();
        }
    }

    #[test]
    fn files_are_replaced_one_by_one() {
        let folder = tempfile::tempdir().unwrap();
        let (new, path) = (folder.path().join("new"), folder.path().join("out"));
        let old = ["index.json", "a/b.png", "a/stale.png", "gone/c.png", "d"];
        fill(&path, &old, "old");
        std::fs::create_dir(path.join("e")).unwrap();
        let names = ["index.json", "a/b.png", "d/f.png", "e/g.json"];
        fill(&new, &names, "new");
        std::fs::create_dir_all(new.join("empty")).unwrap();
        std::os::unix::fs::symlink("nowhere", new.join("link")).unwrap();
        let listed = old.iter().chain(&["e"]).map(PathBuf::from).collect();
        replace_files(&new, &path, &listed).unwrap();
        let expected: BTreeSet<PathBuf> = names.iter().chain(&["empty", "link"]).map(PathBuf::from).collect();
        assert_eq!(files_below(&path).unwrap(), expected);
        assert!(
            names
                .iter()
                .all(|name| { std::fs::read_to_string(path.join(name)).unwrap() == format!("{name} new") })
        );
        assert_eq!(std::fs::read_link(path.join("link")).unwrap(), Path::new("nowhere"));
    }

    /// A kill at any moment leaves a folder without index.
    #[test]
    fn an_interrupted_replacement_has_no_index() {
        let folder = tempfile::tempdir().unwrap();
        let (new, path) = (folder.path().join("new"), folder.path().join("out"));
        fill(&path, &["index.json", "a/b.png"], "old");
        fill(&new, &["index.json", "a/b.png", "a/c.png"], "new");
        std::fs::create_dir_all(path.join("a/c.png/foreign")).unwrap();
        let listed = ["index.json", "a/b.png"].map(PathBuf::from).into();
        assert!(replace_files(&new, &path, &listed).is_err());
        assert!(!path.join("index.json").exists());
    }
}
