//! `sync.arrow`: times of frames, and the rows of other tables that belong to them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rustc_hash::FxHashMap;

use super::choose::SYNC;
use super::metadata::{self, LogMetadata};
use crate::dataset::DatasetError;
use crate::dataset::clock::Unit;
use crate::dataset::limits::MAX_TIME_US;
use crate::dataset::tables::ArrowFile;
use crate::error::FileError;
use crate::files::FileName;

/// Prefix of the table's own columns.
const OWN: &str = "sync.";

/// Maximum number of frames with the same row of lists, each of which has a copy of the lists. py123d names a
/// row for one frame.
const MAX_FRAMES_OF_ROW: usize = 64;

/// Frames of a log.
pub(super) struct Sync {
    pub(super) path: PathBuf,
    pub(super) about: LogMetadata,
    /// Microseconds, increasing.
    pub(super) times_us: Vec<i64>,
    /// Row of each frame by the key of a table.
    rows: BTreeMap<String, Vec<Option<i64>>>,
}

impl Sync {
    /// Reads the frames of a log.
    ///
    /// # Errors
    /// Fails if the file is missing or damaged, has no frames, or times do not increase.
    pub(super) fn read(log: &Path) -> Result<Self, DatasetError> {
        let path = log.join(SYNC);
        let file = ArrowFile::open(&path)?;
        let about: LogMetadata = metadata::read(&file)?;
        let keys: Vec<&str> = file.columns().filter(|name| !name.starts_with(OWN)).collect();
        let table = file.table(&[&["sync.timestamp_us"], keys.as_slice()].concat(), &[])?;
        let times_us = table.column("sync.timestamp_us")?.integers()?;
        check_times(&times_us, true, &path)?;
        if times_us.is_empty() {
            return Err(FileError::content("at least one frame", "none", &path).into());
        }
        let mut rows = BTreeMap::new();
        for key in keys {
            // It becomes the name of a file.
            FileName::new(key).map_err(|error| error.of("the key of a table").in_file(&path))?;
            rows.insert(key.to_owned(), table.column(key)?.integers_or_none()?);
        }
        Ok(Self { path, about, times_us, rows })
    }

    /// Keys of the tables.
    pub(super) fn keys(&self) -> impl Iterator<Item = &str> {
        self.rows.keys().map(String::as_str)
    }

    /// Returns rows as [`Sync::rows`], of a table whose rows hold lists.
    ///
    /// # Errors
    /// Fails too if a row belongs to more than [`MAX_FRAMES_OF_ROW`] frames.
    pub(super) fn rows_of_lists(&self, key: &str, count: u64) -> Result<Vec<Option<usize>>, FileError> {
        let rows = self.rows(key, count)?;
        let mut frames: FxHashMap<usize, usize> = FxHashMap::default();
        rows.iter().flatten().for_each(|row| *frames.entry(*row).or_default() += 1);
        match rows.iter().flatten().find(|row| frames[*row] > MAX_FRAMES_OF_ROW) {
            None => Ok(rows),
            Some(row) => {
                let expected = format!("a row in at most {MAX_FRAMES_OF_ROW} frames in column {key}");
                let found = format!("row {row} in {} frames", frames[row]);
                Err(FileError::content(expected, found, &self.path))
            }
        }
    }

    /// Returns the row of a table with `count` rows that belongs to each frame; all `None` if no column
    /// refers to the table.
    ///
    /// # Errors
    /// Fails if the table has no such row.
    pub(super) fn rows(&self, key: &str, count: u64) -> Result<Vec<Option<usize>>, FileError> {
        let Some(rows) = self.rows.get(key) else { return Ok(vec![None; self.times_us.len()]) };
        let check = |row: &Option<i64>| {
            let Some(row) = *row else { return Ok(None) };
            let known = usize::try_from(row).ok().filter(|row| (*row as u64) < count);
            let wrong = || {
                let expected = format!("rows of {key}.arrow below {count} in column {key}");
                FileError::content(expected, row.to_string(), &self.path)
            };
            known.map(Some).ok_or_else(wrong)
        };
        rows.iter().map(check).collect()
    }
}

/// Checks that times are within the limits and do not decrease; or increase, if `strictly`.
///
/// # Errors
/// Fails with the first wrong one.
pub(super) fn check_times(times_us: &[i64], strictly: bool, path: &Path) -> Result<(), FileError> {
    if let Some((row, t_us)) =
        times_us.iter().enumerate().find(|(_, t_us)| t_us.abs_diff(0) > MAX_TIME_US as u64)
    {
        let found = format!("{t_us} in row {row}{}", Unit::MICROS.hint(*t_us as f64));
        return Err(FileError::content("times in microseconds", found, path));
    }
    let is_wrong = |pair: &[i64]| if strictly { pair[0] >= pair[1] } else { pair[0] > pair[1] };
    match times_us.windows(2).position(is_wrong) {
        None => Ok(()),
        Some(row) => {
            let found = format!("{} before {} in row {}", times_us[row], times_us[row + 1], row + 1);
            Err(FileError::content("times that increase", found, path))
        }
    }
}
