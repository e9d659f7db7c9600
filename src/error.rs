//! Errors of files: what was expected, what was found, and the file, last.

use std::path::{Path, PathBuf};

use crate::files::text::{printable, printable_path};

/// A file that cannot be read or written as it should.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The operating system said no.
    #[error("cannot {verb}: {}: {}", printable(&source.to_string()), printable_path(path))]
    Io {
        /// "read", "write", ...
        verb: &'static str,
        /// What the system said.
        source: std::io::Error,
        /// The file.
        path: PathBuf,
    },
    /// The content is not what the format says.
    #[error("expected {}, found {}: {}", printable(expected), printable(found), printable_path(path))]
    Content {
        /// What the format asks for.
        expected: String,
        /// What stands in the file.
        found: String,
        /// The file.
        path: PathBuf,
    },
}

impl FileError {
    /// For `map_err`: an I/O error with its file.
    pub fn io(verb: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |source| Self::Io { verb, source, path }
    }

    /// A wrong content with its file.
    pub fn content(expected: impl Into<String>, found: impl Into<String>, path: &Path) -> Self {
        Self::Content { expected: expected.into(), found: found.into(), path: path.to_owned() }
    }
}

/// Writes a whole file under a temporary name in the same folder, then renames it: nothing half-written is ever
/// seen under the final name. `fill` gets a buffered writer.
///
/// # Errors
/// Whatever `fill` returns, or the system at creating, flushing or renaming; the temporary file is gone then.
pub fn write_whole<E: From<FileError>>(
    path: &Path,
    fill: impl FnOnce(&mut std::io::BufWriter<&mut std::fs::File>) -> Result<(), E>,
) -> Result<(), E> {
    use std::io::Write;
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut builder = tempfile::Builder::new();
    builder.prefix(".pskel-").permissions(permissions());
    let mut file = builder.tempfile_in(folder).map_err(FileError::io("create", path))?;
    let mut writer = std::io::BufWriter::with_capacity(1 << 20, file.as_file_mut());
    fill(&mut writer)?;
    writer.flush().map_err(FileError::io("write", path))?;
    drop(writer);
    file.persist(path).map_err(|e| FileError::io("rename to", path)(e.error))?;
    Ok(())
}

/// Writes a value as indented JSON with a newline at the end, by [`write_whole`].
///
/// # Errors
/// The system's, at writing.
pub fn write_json(path: &Path, value: &impl serde::Serialize) -> Result<(), FileError> {
    use std::io::Write;
    write_whole(path, |out| {
        let written = serde_json::to_writer_pretty(&mut *out, value).map_err(std::io::Error::from);
        written.and_then(|()| out.write_all(b"\n")).map_err(FileError::io("write", path))
    })
}

/// Writes a whole folder under a temporary name beside `path`, then renames it: nothing half-written is ever seen
/// under the final name. `fill` gets the temporary folder. An older folder at `path` is replaced if it is empty or holds
/// a file named `marker`, which tells that it is one of ours.
///
/// # Errors
/// Whatever `fill` returns, something else at `path`, or the system; the temporary folder is gone then.
pub fn write_whole_folder<E: From<FileError>>(
    path: &Path,
    marker: &str,
    fill: impl FnOnce(&Path) -> Result<(), E>,
) -> Result<(), E> {
    let parent = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    write_whole_folder_by(path, marker, parent, fill)
}

/// As [`write_whole_folder`], with the temporary folder in `scratch`, a folder of the same file system. Whoever owns it
/// can clean up after a process that was killed.
///
/// # Errors
/// As [`write_whole_folder`].
pub fn write_whole_folder_by<E: From<FileError>>(
    path: &Path,
    marker: &str,
    scratch: &Path,
    fill: impl FnOnce(&Path) -> Result<(), E>,
) -> Result<(), E> {
    check_replaceable(path, marker)?;
    std::fs::create_dir_all(scratch).map_err(FileError::io("create", scratch))?;
    let mut builder = tempfile::Builder::new();
    builder.prefix(".pskel-");
    let beside = builder.tempdir_in(scratch).map_err(FileError::io("create a folder in", scratch))?;
    let new = beside.path().join("new");
    // A folder within the temporary one gets the mode of plain folders.
    std::fs::create_dir(&new).map_err(FileError::io("create", &new))?;
    fill(&new)?;
    Ok(put(&new, path)?)
}

/// Whether a folder may be written at a path: nothing is there, or an empty folder, or one that holds a file named
/// `marker`.
///
/// # Errors
/// Something else is there.
pub fn check_replaceable(path: &Path, marker: &str) -> Result<(), FileError> {
    let empty = || std::fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_none());
    if path.exists() && !path.join(marker).is_file() && !empty() {
        let expected = format!("no such folder yet, an empty one, or an older one with {marker}");
        return Err(FileError::content(expected, "other content", path));
    }
    Ok(())
}

/// As [`check_replaceable`], and what is there must be files of ours alone: whatever else somebody put there would go
/// with the older folder.
///
/// # Errors
/// Something else is there, or among our files.
pub fn check_only_ours(path: &Path, marker: &str, is_ours: impl Fn(&str) -> bool) -> Result<(), FileError> {
    check_replaceable(path, marker)?;
    if !path.exists() {
        return Ok(());
    }
    for entry in std::fs::read_dir(path).map_err(FileError::io("read", path))? {
        let entry = entry.map_err(FileError::io("read", path))?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if !is_ours(&name) {
            let expected = format!("nothing beside the files that belong to {marker}");
            return Err(FileError::content(expected, name, path));
        }
    }
    Ok(())
}

/// Renames a folder. One that is there changes places with it in one step, so that at every moment there is one.
fn put(new: &Path, path: &Path) -> Result<(), FileError> {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    let exchanged = path.exists() && renameat_with(CWD, new, CWD, path, RenameFlags::EXCHANGE).is_ok();
    if exchanged {
        return Ok(());
    }
    // Not every file system can do this.
    let old = new.with_file_name("old");
    let older = path.exists();
    if older {
        std::fs::rename(path, &old).map_err(FileError::io("replace", path))?;
    }
    std::fs::rename(new, path).map_err(|error| {
        if older {
            let _ = std::fs::rename(&old, path); // the error tells what went wrong before
        }
        FileError::io("rename to", path)(error)
    })
}

/// What a plain created file gets (the umask applies), not the private mode of temporary files.
fn permissions() -> std::fs::Permissions {
    use std::os::unix::fs::PermissionsExt;
    std::fs::Permissions::from_mode(0o666)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn a_failed_write_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        let result: Result<(), FileError> = write_whole(&path, |w| {
            w.write_all(b"half").unwrap();
            Err(FileError::content("more", "less", &path))
        });
        assert!(result.is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn folders_replace_their_own_kind_only() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let write = |text: &str| {
            write_whole_folder(&path, "mark", |new| {
                std::fs::write(new.join("mark"), text).map_err(FileError::io("write", new))?;
                if text == "bad" { Err(FileError::content("more", "less", new)) } else { Ok(()) }
            })
        };
        write("one").unwrap();
        write("two").unwrap();
        assert!(write("bad").is_err());
        assert_eq!(std::fs::read(path.join("mark")).unwrap(), b"two");
        std::fs::remove_file(path.join("mark")).unwrap();
        write("into an empty one").unwrap();
        std::fs::rename(path.join("mark"), path.join("other")).unwrap();
        assert!(write("three").unwrap_err().to_string().contains("an older one with mark"));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
