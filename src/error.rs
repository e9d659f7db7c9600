//! File errors. Messages list the expected content, the found content and the file, in this order.

use std::path::{Path, PathBuf};

use crate::files::text::{printable, printable_path};

/// Error of a file that cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The operating system reported an error.
    #[error("cannot {verb}: {}: {}", printable(&source.to_string()), printable_path(path))]
    Io {
        /// "read", "write", ...
        verb: &'static str,
        /// Error reported by the operating system.
        source: std::io::Error,
        /// The file.
        path: PathBuf,
    },
    /// Another process writes the same output.
    #[error("output is locked by {found}: {}", printable_path(path))]
    Busy {
        /// Description of the process.
        found: String,
        /// The output.
        path: PathBuf,
    },
    /// The content violates the format.
    #[error("expected {}, found {}: {}", printable(expected), printable(found), printable_path(path))]
    Content {
        /// Content required by the format.
        expected: String,
        /// Content found in the file.
        found: String,
        /// The file.
        path: PathBuf,
    },
}

impl FileError {
    /// Returns a closure for `map_err` that creates an I/O error for a file.
    pub fn io(verb: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |source| Self::Io { verb, source, path }
    }

    /// Creates an error of unexpected content for a file.
    pub fn content(expected: impl Into<String>, found: impl Into<String>, path: &Path) -> Self {
        Self::Content { expected: expected.into(), found: found.into(), path: path.to_owned() }
    }
}

/// Formats an error with its causes, one per line, except causes that are already part of the text.
pub fn with_causes(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(error.source(), |cause| cause.source());
    causes.map(ToString::to_string).fold(error.to_string(), |text, cause| match text.contains(&cause) {
        true => text,
        false => format!("{text}\n  caused by: {cause}"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("no points")]
    struct Outer(#[from] Inner);

    #[derive(Debug, thiserror::Error)]
    #[error("{0}")]
    struct Inner(#[from] FileError);

    #[test]
    fn causes_appear_once() {
        let file = FileError::io("read", Path::new("a"))(std::io::Error::other("gone"));
        let error = Outer::from(Inner::from(file));
        assert_eq!(with_causes(&error), "no points\n  caused by: cannot read: gone: a");
    }
}
