//! What tables of sensors add their data to.

use std::path::{Path, PathBuf};

use super::ego::Ego;
use super::sync::Sync;
use crate::dataset::Frame;
use crate::error::FileError;
use crate::files::NameError;
use crate::files::input::DataRoot;

/// Frames to which tables add their data.
pub(super) struct Target<'a> {
    pub(super) sync: &'a Sync,
    /// Row of `sync` of each frame.
    pub(super) rows: &'a [usize],
    pub(super) ego: &'a Ego,
    /// Folder of the files that tables name.
    pub(super) root: Option<&'a DataRoot>,
    pub(super) frames: &'a mut [Frame],
}

/// Resolves the path in a row of a table.
pub(super) fn resolve(root: &DataRoot, name: &str, row: usize, table: &Path) -> Result<PathBuf, FileError> {
    let wrong =
        |error: NameError| FileError::content(error.expected, format!("{} in row {row}", error.found), table);
    root.resolve(name).map_err(wrong)
}
