//! Items that a reader skips or misses, and the policy for missing parts (`gaps`).

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::ego_jumps::{JUMPS, count_jumps};
use crate::dataset::{DatasetError, Gap, MissingData, Recording};
use crate::error::FileError;
use crate::files::input::is_there;

/// Kind of a gap: a camera without an image for a frame.
pub(in super::super) const NO_IMAGE: &str = "missing camera images";
/// Kind of a gap: a box with a side that is zero, negative or nearly zero.
pub(in super::super) const FLAT_BOX: &str = "boxes without a size";
/// Kind of a gap: a frame to which no sweep belongs.
pub(in super::super) const NO_SWEEP: &str = "frames without a LiDAR sweep of their own";
/// Kind of a gap: a sweep or an image whose pose, sensor or calibration is missing.
pub(in super::super) const DANGLING_DATA: &str = "sweeps and images that refer to a missing record";
/// Kind of a gap: a box whose track or category is missing.
pub(in super::super) const DANGLING_BOX: &str = "boxes that refer to a missing record";
/// Kind of a gap: a log of the test split, for instance.
pub(in super::super) const NO_ANNOTATIONS: &str = "logs without annotations";
const NO_SWEEP_FILE: &str = "missing sweep files";
const NO_IMAGE_FILE: &str = "missing image files";

/// Items that a reader skips or misses.
#[derive(Debug, Default)]
pub(in super::super) struct Notes {
    /// Number of items by kind.
    pub(in super::super) counts: Counts,
    /// Missing parts, which are also counted.
    pub(in super::super) gaps: Vec<Gap>,
}

impl Notes {
    pub(in super::super) fn new() -> Self {
        Self::default()
    }

    /// Counts a missing part of the log.
    pub(in super::super) fn gap(&mut self, gap: Gap) {
        note(self, gap.kind, 1);
        self.gaps.push(gap);
    }
}

/// Moves the notes of a reader to its log, removes sweeps and images whose files do not exist, and applies
/// the policy.
///
/// # Errors
/// Fails with [`MissingData::Error`] if anything is missing.
pub(in super::super) fn settle(log: &mut Recording, notes: Notes) -> Result<(), DatasetError> {
    (log.notes, log.gaps) = (notes.counts, notes.gaps);
    let gaps = missing_files(log);
    let missing: BTreeSet<&Path> = gaps.iter().filter_map(Gap::file).collect();
    for frame in log.frames.iter_mut().filter(|_| !missing.is_empty()) {
        frame.sweeps.retain(|sweep| !missing.contains(sweep.path.as_path()));
        frame.images.retain(|image| !missing.contains(image.path.as_path()));
        frame.between_images.retain(|image| !missing.contains(image.path.as_path()));
    }
    gaps.iter().for_each(|gap| count(&mut log.notes, gap.kind, 1));
    let jumps = count_jumps(log);
    count(&mut log.notes, JUMPS, jumps);
    log.gaps.extend(gaps);
    match log.gaps.first() {
        Some(first) if log.reading.missing == MissingData::Error => {
            Err(DatasetError::Missing { first: first.clone(), further: log.gaps.len() - 1 })
        }
        _ => Ok(()),
    }
}

/// Returns the files of a log that do not exist, each once. Other things than regular files, and files that
/// cannot be looked up, are left for their readers.
fn missing_files(log: &Recording) -> Vec<Gap> {
    let files = log.frames.iter().flat_map(|frame| {
        let sweeps = frame.sweeps.iter().map(|sweep| (&sweep.path, NO_SWEEP_FILE));
        let images = frame.images.iter().chain(&frame.between_images);
        sweeps.chain(images.map(|image| (&image.path, NO_IMAGE_FILE)))
    });
    // Several frames may share an image.
    let mut seen = BTreeSet::new();
    let files: Vec<(&PathBuf, &'static str)> = files.filter(|(path, _)| seen.insert(*path)).collect();
    let found: Vec<Result<bool, FileError>> = files.par_iter().map(|(path, _)| is_there(path)).collect();
    let missing = files.into_iter().zip(found).filter(|(_, found)| matches!(found, Ok(false)));
    missing.map(|((path, kind), _)| Gap::missing(kind, path.clone())).collect()
}

/// Kind of the boxes whose stated number of points is not a number.
pub(in super::super) const UNKNOWN_POINTS: &str = "boxes with an unknown number of LiDAR points";

/// Counts boxes whose category has an unknown name.
pub(in super::super) fn note_unknown_category(notes: &mut Notes, category: &str, boxes: usize) {
    note(notes, &format!("boxes of the unknown category {category} (read as objects)"), boxes);
}

/// Counts skipped items.
pub(in super::super) fn note(notes: &mut Notes, kind: &str, count: usize) {
    self::count(&mut notes.counts, kind, count);
}

/// Number of items by kind.
pub(in super::super) type Counts = BTreeMap<String, usize>;

/// Adds to the count of a kind.
pub(in super::super) fn count(counts: &mut Counts, kind: &str, number: usize) {
    if number > 0 {
        *counts.entry(kind.to_owned()).or_default() += number;
    }
}
