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
