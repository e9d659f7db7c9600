//! Limited reads of regular files, and names in data that resolve to paths below the data's folder.
//!
//! Reading a device or waiting for a FIFO might never end. So the file type is checked before and after
//! opening, and files are opened without blocking.

use std::fs::{File, FileType, Metadata, OpenOptions};
use std::io::{ErrorKind, Read};
use std::os::unix::fs::{FileExt, FileTypeExt, OpenOptionsExt};
use std::path::{Component, Path, PathBuf};

use rustix::fs::OFlags;

use super::{NameError, sniff};
use crate::error::FileError;

/// Maximum size of an image in bytes.
pub const IMAGE_BYTES: u64 = 256 << 20;
/// Maximum size of a sweep in bytes.
pub const SWEEP_BYTES: u64 = 1 << 30;
/// Maximum size in bytes of a table, a map, weights, or a file of options.
pub const TABLE_BYTES: u64 = 16 << 30;

/// Folder with files that are named by data.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DataRoot {
    /// The folder.
    pub path: PathBuf,
    /// `true` if names may lead out of it.
    pub allow_outside: bool,
}

impl DataRoot {
    /// Expectation in the error for a path that leads out of the folder.
    pub const BELOW: &str = "a path below the data set's folder";

    /// Resolves a name from the data to a path. Backslashes, which Windows writes, separate folders unless a
    /// file has the name as written. Symbolic links may lead anywhere: they are trusted as much as the
    /// folder's owner.
    ///
    /// # Errors
    /// Fails if the name is empty, contains a NUL, or begins with a drive of Windows. Unless `allow_outside`
    /// is set, also fails if it is absolute or has a `..` component.
    pub fn resolve(&self, name: &str) -> Result<PathBuf, NameError> {
        let wrong =
            |expected: &str| Err(NameError { expected: expected.to_owned(), found: format!("{name:?}") });
        let is_windows = (name.contains('\\') || has_drive(name)) && !is_taken(&self.path.join(name));
        if is_windows && has_drive(name) {
            return wrong("a path below the data set's folder, without a drive of Windows");
        }
        let slashes = is_windows.then(|| name.replace('\\', "/"));
        let name = slashes.as_deref().unwrap_or(name);
        let mut parts = Path::new(name).components();
        if name.contains('\0') || !parts.clone().any(|part| matches!(part, Component::Normal(_))) {
            return wrong("the name of a file");
        }
        if !self.allow_outside && !parts.all(|part| matches!(part, Component::Normal(_) | Component::CurDir))
        {
            return wrong(Self::BELOW);
        }
        Ok(self.path.join(name))
    }
}

/// Returns whether a name begins like `C:\` or `C:/`.
fn has_drive(name: &str) -> bool {
    matches!(name.as_bytes(), [letter, b':', b'\\' | b'/', ..] if letter.is_ascii_alphabetic())
}

/// Opens a regular file for reading without blocking, and returns its length too.
///
/// # Errors
/// Fails if the file cannot be opened or is not a regular file, or if its content stands in for a file that
/// was not downloaded: a Git LFS or git-annex pointer, or an error page.
pub(crate) fn open_regular(path: &Path) -> Result<(File, u64), FileError> {
    // Opening some devices has side effects.
    check_kind(&std::fs::metadata(path).map_err(FileError::io("read", path))?, path)?;
    let flags = OFlags::NONBLOCK | OFlags::NOCTTY;
    let file = OpenOptions::new().read(true).custom_flags(flags.bits().cast_signed()).open(path);
    let file = file.map_err(FileError::io("read", path))?;
    // The file may have been replaced in between.
    let about = file.metadata().map_err(FileError::io("read", path))?;
    check_kind(&about, path)?;
    let mut head = [0; sniff::HEAD_BYTES];
    let bytes = file.read_at(&mut head, 0).map_err(FileError::io("read", path))?;
    match sniff::undownloaded(&head[..bytes]) {
        None => Ok((file, about.len())),
        Some(found) => Err(FileError::content("the content of the file", found, path)),
    }
}

/// Opens a regular file of at most `limit` bytes, and returns its length too.
///
/// # Errors
/// Fails as [`open_regular`], and if the file is longer than `limit`.
pub(crate) fn open_up_to(path: &Path, limit: u64) -> Result<(File, u64), FileError> {
    let (file, length) = open_regular(path)?;
    if length > limit {
        let expected = format!("a file of at most {limit} bytes");
        return Err(FileError::content(expected, format!("{length} bytes"), path));
    }
    Ok((file, length))
}

/// Reads a regular file of at most `limit` bytes. Bytes that are appended during the read are ignored.
///
/// # Errors
/// Fails if the file cannot be opened or is not a regular file, is longer than `limit` or cannot be read.
pub fn read_file(path: &Path, limit: u64) -> Result<Vec<u8>, FileError> {
    let (file, length) = open_up_to(path, limit)?;
    let mut bytes = Vec::new();
    let room = usize::try_from(length).is_ok_and(|length| bytes.try_reserve_exact(length).is_ok());
    if !room {
        return Err(FileError::io("read", path)(ErrorKind::OutOfMemory.into()));
    }
    file.take(length).read_to_end(&mut bytes).map_err(FileError::io("read", path))?;
    Ok(bytes)
}

/// Reads a table, a map, weights or a file of options: [`read_file`] of at most [`TABLE_BYTES`].
///
/// # Errors
/// Returns any error of [`read_file`].
pub fn read_table(path: &Path) -> Result<Vec<u8>, FileError> {
    read_file(path, TABLE_BYTES)
}

/// Reads a UTF-8 text with [`read_table`], without its byte order mark.
///
/// # Errors
/// Returns any error of [`read_file`]. Fails if the bytes are not UTF-8.
pub fn read_text(path: &Path) -> Result<String, FileError> {
    let bytes = read_table(path)?;
    utf8(&bytes).map(str::to_owned).map_err(|found| FileError::content("UTF-8 text", found, path))
}

/// Returns UTF-8 text without its byte order mark.
///
/// # Errors
/// Returns a description of other content.
pub fn utf8(bytes: &[u8]) -> Result<&str, String> {
    let other = |error: std::str::Utf8Error| match sniff::marked(bytes) {
        Some(found) => found.to_owned(),
        None => format!("a byte of another encoding at {}", error.valid_up_to()),
    };
    str::from_utf8(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)).map_err(other)
}

/// Returns whether a regular file exists at a path.
///
/// # Errors
/// Fails if the path is something other than a regular file, or if its metadata cannot be read.
pub fn is_there(path: &Path) -> Result<bool, FileError> {
    match std::fs::metadata(path) {
        Ok(about) => check_kind(&about, path).map(|()| true),
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => Ok(false),
        Err(error) => Err(FileError::io("read", path)(error)),
    }
}

/// Returns whether anything exists at a path, including a dangling link: reading it later reports what is
/// wrong.
pub fn is_taken(path: &Path) -> bool {
    std::fs::symlink_metadata(path).is_ok()
}

fn check_kind(about: &Metadata, path: &Path) -> Result<(), FileError> {
    if about.is_file() {
        return Ok(());
    }
    Err(FileError::content("a regular file", kind(about.file_type()), path))
}

fn kind(kind: FileType) -> &'static str {
    match kind {
        _ if kind.is_dir() => "a folder",
        _ if kind.is_fifo() => "a FIFO",
        _ if kind.is_socket() => "a socket",
        _ if kind.is_char_device() || kind.is_block_device() => "a device",
        _ => "something else",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;
    use std::os::unix::net::UnixListener;

    #[test]
    fn only_regular_files_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("file"), "text").unwrap();
        symlink("file", at("link")).unwrap();
        for name in ["file", "link"] {
            assert_eq!(read_file(&at(name), 4).unwrap(), b"text");
            assert!(is_there(&at(name)).unwrap());
        }
        let message = read_file(&at("file"), 3).unwrap_err().to_string();
        assert!(message.starts_with("expected a file of at most 3 bytes, found 4 bytes: "), "{message}");
        std::fs::create_dir(at("folder")).unwrap();
        rustix::fs::mknodat(rustix::fs::CWD, at("fifo"), rustix::fs::FileType::Fifo, 0o600.into(), 0)
            .unwrap();
        let _socket = UnixListener::bind(at("socket")).unwrap();
        for (path, found) in [
            (at("folder"), "a folder"),
            (at("fifo"), "a FIFO"),
            (at("socket"), "a socket"),
            ("/dev/zero".into(), "a device"),
        ] {
            let expected = format!("expected a regular file, found {found}: {}", path.display());
            assert_eq!(read_table(&path).unwrap_err().to_string(), expected);
            assert_eq!(is_there(&path).unwrap_err().to_string(), expected);
            assert!(is_taken(&path));
        }
        symlink("loop", at("loop")).unwrap();
        assert!(is_there(&at("loop")).is_err() && read_table(&at("loop")).is_err());
        assert!(is_taken(&at("loop")) && !is_taken(&at("none")));
        assert!(!is_there(&at("none")).unwrap() && !is_there(&at("file/none")).unwrap());
        assert!(read_table(&at("none")).unwrap_err().to_string().starts_with("cannot read: "));
    }

    /// Uses a sparse file, which takes no disk space.
    #[test]
    fn a_large_file_is_refused_before_memory_is_taken() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("large");
        File::create(&path).unwrap().set_len(1 << 42).unwrap();
        let message = read_table(&path).unwrap_err().to_string();
        assert!(message.contains("at most") && message.contains("found 4398046511104 bytes"), "{message}");
    }

    #[test]
    fn backslashes_separate_folders_unless_a_file_is_named_so() {
        let folder = tempfile::tempdir().unwrap();
        let root = DataRoot { path: folder.path().to_owned(), allow_outside: false };
        let open = DataRoot { allow_outside: true, ..root.clone() };
        let at = |name: &str| folder.path().join(name);
        assert_eq!(root.resolve(r"samples\CAM\a.jpg").unwrap(), at("samples/CAM/a.jpg"));
        assert_eq!(root.resolve(r"samples/CAM\a.jpg").unwrap(), at("samples/CAM/a.jpg"));
        assert_eq!(root.resolve(r".\a.jpg").unwrap(), at("a.jpg"));
        for name in [r"a\b.jpg", "D:x"] {
            std::fs::write(at(name), "").unwrap();
            assert_eq!(root.resolve(name).unwrap(), at(name));
        }
        for name in [r"..\..\x", r"a\..\..\x", r"\etc\passwd", r"\\server\share\x", "..\\x"] {
            let message = root.resolve(name).unwrap_err().to_string();
            assert!(message.contains(DataRoot::BELOW) && message.contains(&format!("{name:?}")), "{message}");
        }
        for name in [r"C:\data\a.jpg", "c:/data/a.jpg", r"C:\..\x"] {
            let message = root.resolve(name).unwrap_err().to_string();
            assert!(message.contains("without a drive of Windows"), "{message}");
            assert!(open.resolve(name).is_err());
        }
        for name in [r"\", r"..\..", "a\\\0"] {
            assert!(root.resolve(name).is_err(), "{name:?}");
        }
    }

    #[test]
    fn rejects_pointers_and_error_pages() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.jpg");
        for (text, found) in [
            ("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n", "a Git LFS pointer"),
            ("/annex/objects/MD5E-s1--a.jpg\n", "a git-annex pointer"),
            ("<!DOCTYPE html><title>Quota exceeded</title>", "an HTML page"),
        ] {
            std::fs::write(&path, text).unwrap();
            let message = read_file(&path, IMAGE_BYTES).unwrap_err().to_string();
            let expected = format!("expected the content of the file, found {found} (");
            assert!(message.starts_with(&expected) && message.ends_with("a.jpg"), "{message}");
        }
    }

    #[test]
    fn names_resolve_below_the_folder() {
        let root = DataRoot { path: "/data".into(), allow_outside: false };
        let open = DataRoot { allow_outside: true, ..root.clone() };
        for (name, path) in [("a/b.jpg", "/data/a/b.jpg"), ("./a", "/data/a"), ("a..b/..c", "/data/a..b/..c")]
        {
            assert_eq!(root.resolve(name).unwrap(), Path::new(path));
        }
        for (name, path) in
            [("/etc/passwd", "/etc/passwd"), ("../a", "/data/../a"), ("a/../../b", "/data/a/../../b")]
        {
            let message = root.resolve(name).unwrap_err().to_string();
            assert!(message.contains("below the data set's folder") && message.contains(name), "{message}");
            assert_eq!(open.resolve(name).unwrap(), Path::new(path));
        }
        for name in ["", ".", "..", "/", "a\0b"] {
            assert!(root.resolve(name).is_err() && open.resolve(name).is_err(), "{name:?}");
        }
    }
}
