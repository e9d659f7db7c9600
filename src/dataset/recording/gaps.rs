//! Missing and damaged parts of logs: one policy for all readers.
//!
//! # How it works
//! A reader records the parts that it misses ([`Gap`]), and lists its files without looking at them.
//! `notes::settle` finds the files that do not exist, and then either leaves out all missing parts or ends
//! with an error. Damaged files are found when they are read:
//! [`Recording::unless_damaged`](crate::dataset::Recording::unless_damaged).

use std::fmt;
use std::path::{Path, PathBuf};

use crate::files::text::{printable, printable_path};
use crate::{named, named_in_files};

/// What to do about missing and damaged parts of a log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MissingData {
    /// Skip and count them.
    #[default]
    Skip,
    /// Fail with the first one.
    Error,
}

named!(MissingData, "policy for missing data" {
    Skip => "skip", "Skip and count them";
    Error => "error", "Fail with the first";
});
named_in_files!(MissingData);

/// Missing part of a log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Gap {
    /// Kind, as in [`Recording::notes`](crate::dataset::Recording::notes).
    pub kind: &'static str,
    /// The part.
    pub place: GapPlace,
}

/// Location of a gap.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum GapPlace {
    /// File that the log names and that does not exist, or a missing folder of files.
    File(PathBuf),
    /// Record of a table that is missing or has to be skipped.
    Record {
        /// The record.
        record: String,
        /// The file of the table, or the folder of the log.
        path: PathBuf,
    },
}

impl Gap {
    /// Creates a gap in a table.
    pub(in super::super) fn record(kind: &'static str, record: impl Into<String>, path: &Path) -> Self {
        Self { kind, place: GapPlace::Record { record: record.into(), path: path.to_owned() } }
    }

    /// Creates the gap of a record `by` whose reference to another table leads nowhere; `path` is the file of
    /// that table.
    pub(in super::super) fn dangling(
        kind: &'static str,
        by: &str,
        table: &str,
        token: &str,
        path: &Path,
    ) -> Self {
        Self::record(kind, format!("{by}, whose {table} {token} is missing"), path)
    }

    /// Creates the gap of a file that does not exist.
    pub(in super::super) fn missing(kind: &'static str, path: PathBuf) -> Self {
        Self { kind, place: GapPlace::File(path) }
    }

    /// Returns the missing file; `None` for other gaps.
    pub fn file(&self) -> Option<&Path> {
        match &self.place {
            GapPlace::File(path) => Some(path),
            GapPlace::Record { .. } => None,
        }
    }
}

/// Formats as `kind: record: file`.
impl fmt::Display for Gap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.place {
            GapPlace::File(path) => write!(f, "{}: {}", self.kind, printable_path(path)),
            GapPlace::Record { record, path } => {
                write!(f, "{}: {}: {}", self.kind, printable(record), printable_path(path))
            }
        }
    }
}
