//! Files that describe a sweep, in T4: `info_filename` of `sample_data` names one with the number of columns
//! and, if LiDARs are merged, the points and the time of each.
//!
//! Format: <https://tier4.github.io/t4-devkit/schema/data>.

use std::path::Path;

use serde::Deserialize;

use crate::error::FileError;
use crate::files::input::is_there;
use crate::files::json;

/// Numbers of columns that a sweep may have.
const COLUMNS: std::ops::RangeInclusive<usize> = 3..=64;

/// Columns and sources of a sweep.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct SweepInfo {
    /// Number of `f32` per point; `None` if it is not stated.
    pub(super) columns: Option<usize>,
    sources: Vec<NumberedSource>,
}

/// Points of a LiDAR in a merged sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct NumberedSource {
    /// 0 for the LiDARs that are nearest to the time of the sweep.
    number: u16,
    first: usize,
    count: usize,
}

#[derive(Deserialize)]
struct InfoFile {
    #[serde(default)]
    stamp: Stamp,
    #[serde(default)]
    sources: Vec<Source>,
    num_pts_feats: Option<usize>,
}

#[derive(Deserialize)]
struct Source {
    idx_begin: usize,
    length: usize,
    #[serde(default)]
    stamp: Stamp,
}

#[derive(Clone, Copy, Default, Deserialize)]
struct Stamp {
    sec: i64,
    nanosec: i64,
}

impl Stamp {
    /// Returns the distance to another time, nanoseconds.
    fn distance(self, other: Self) -> i128 {
        let ns = |stamp: Self| i128::from(stamp.sec) * 1_000_000_000 + i128::from(stamp.nanosec);
        (ns(self) - ns(other)).abs()
    }
}

impl SweepInfo {
    /// Reads a file; `None` if it does not exist.
    ///
    /// # Errors
    /// Fails if it cannot be read or has another form, or if the number of columns is none that a sweep has.
    pub(super) fn read(path: &Path) -> Result<Option<Self>, FileError> {
        if !is_there(path)? {
            return Ok(None);
        }
        let file: InfoFile = json::read(path, "columns and sources of a sweep")?;
        if let Some(columns) = file.num_pts_feats.filter(|columns| !COLUMNS.contains(columns)) {
            let expected = format!("{} to {} numbers per point", COLUMNS.start(), COLUMNS.end());
            return Err(FileError::content(expected, format!("num_pts_feats {columns}"), path));
        }
        Ok(Some(Self::of(&file)))
    }

    fn of(file: &InfoFile) -> Self {
        let used: Vec<&Source> = file.sources.iter().filter(|source| source.length > 0).collect();
        let nearest = used.iter().map(|source| source.stamp.distance(file.stamp)).min();
        let number = |(place, source): (usize, &&Source)| NumberedSource {
            number: if Some(source.stamp.distance(file.stamp)) == nearest { 0 } else { place as u16 + 1 },
            first: source.idx_begin,
            count: source.length,
        };
        let sources = used.iter().enumerate().map(number).collect();
        Self { columns: file.num_pts_feats, sources }
    }

    /// Returns the number of the LiDAR that measured a point: 0 if it is nearest to the time of the sweep, so
    /// that its points fit the boxes of moving actors best. `None` if the sweep has no sources.
    pub(super) fn source(&self, row: usize) -> Option<u16> {
        let holds = |source: &&NumberedSource| {
            (source.first..source.first.saturating_add(source.count)).contains(&row)
        };
        let last = self.sources.len() as u16 + 1;
        (!self.sources.is_empty())
            .then(|| self.sources.iter().find(holds).map_or(last, |source| source.number))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<SweepInfo, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("0.json");
        std::fs::write(&path, text).unwrap();
        SweepInfo::read(&path).map(Option::unwrap).map_err(|error| error.to_string())
    }

    #[test]
    fn sources_at_the_time_of_the_sweep_are_the_first_lidar() {
        let info = read(
            r#"{"stamp": {"sec": 10, "nanosec": 5}, "num_pts_feats": 7, "sources": [
                {"sensor_token": "left", "idx_begin": 0, "length": 2,
                    "stamp": {"sec": 9, "nanosec": 999999999}},
                {"sensor_token": "none", "idx_begin": 2, "length": 0, "stamp": {"sec": 10, "nanosec": 5}},
                {"sensor_token": "top", "idx_begin": 2, "length": 1, "stamp": {"sec": 10, "nanosec": 4}},
                {"sensor_token": "right", "idx_begin": 3, "length": 2,
                    "stamp": {"sec": 10, "nanosec": 6}}]}"#,
        )
        .unwrap();
        assert_eq!(info.columns, Some(7));
        // The fifth point is beyond all sources.
        let numbers: Vec<Option<u16>> = (0..6).map(|row| info.source(row)).collect();
        assert_eq!(numbers, [1, 1, 0, 0, 0, 4].map(Some));
    }

    #[test]
    fn everything_may_be_left_out() {
        let info = read("{}").unwrap();
        assert_eq!((info.source(0), info), (None, SweepInfo::default()));
        assert_eq!(SweepInfo::read(Path::new("/nowhere/0.json")).unwrap(), None);
    }

    #[test]
    fn rejects_other_numbers_of_columns() {
        for columns in ["0", "2", "65"] {
            let message = read(&format!(r#"{{"num_pts_feats": {columns}}}"#)).unwrap_err();
            let expected = format!("expected 3 to 64 numbers per point, found num_pts_feats {columns}: ");
            assert!(message.starts_with(&expected) && message.ends_with("0.json"), "{message}");
        }
        assert!(read("[]").unwrap_err().contains("columns and sources of a sweep"));
    }
}
