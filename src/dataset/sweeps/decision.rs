//! What the numbers of a log's sweeps mean, decided once.

use std::sync::OnceLock;

use super::SweepRows;
use super::devices::{Evidence, majority};
use crate::dataset::{Recording, RingMeaning, Sweep, SweepRecord};
use crate::error::FileError;

/// Number of sweeps that decide, evenly spaced over the log.
const SWEEPS: usize = 5;

/// Meaning of the numbers in all sweeps of a log.
#[derive(Debug)]
pub(in crate::dataset) struct RingDecision {
    meaning: RingMeaning,
    /// What most sweeps say; `None` if their numbers cannot be LiDAR numbers.
    found: OnceLock<Option<Evidence>>,
}

impl RingDecision {
    /// Creates a decision that is due.
    pub(in crate::dataset) fn new(meaning: RingMeaning) -> Self {
        Self { meaning, found: OnceLock::new() }
    }

    /// Reads a sweep of the log, and decides with the first one that may contain LiDAR numbers.
    ///
    /// # Errors
    /// Returns any error of `read` for the sweep itself. Fails if it has no point with finite coordinates.
    pub(in crate::dataset) fn read(
        &self,
        log: &Recording,
        record: &SweepRecord,
        read: impl Fn(&SweepRecord) -> Result<SweepRows, FileError>,
    ) -> Result<Sweep, FileError> {
        let rows = read(record)?;
        let found = match self.meaning {
            RingMeaning::Auto if rows.may_be_merged() => {
                self.found.get_or_init(|| of_log(log, &read)).or_else(|| rows.evidence())
            }
            _ => None,
        };
        rows.finish_as(self.meaning, found, &record.path)
    }
}

/// Returns what most of a few sweeps of a log say. Sweeps that cannot be read do not count. Must not wait for
/// other threads, which may wait for this decision.
fn of_log(log: &Recording, read: impl Fn(&SweepRecord) -> Result<SweepRows, FileError>) -> Option<Evidence> {
    let records: Vec<_> = log.frames.iter().flat_map(|frame| &frame.sweeps).collect();
    let count = records.len().min(SWEEPS);
    let chosen = (0..count).map(|i| records[(2 * i + 1) * records.len() / (2 * count)]);
    let found: Vec<Evidence> = chosen.filter_map(|record| read(record).ok()?.evidence()).collect();
    majority(&found)
}
