//! Counts of the items that a reader skips or misses.

use std::collections::BTreeMap;

/// Number of skipped or missing items by kind.
pub(super) type Notes = BTreeMap<String, usize>;

/// Kind of the boxes whose stated number of points is not a number.
#[cfg(any(feature = "nuscenes", feature = "av2"))]
pub(super) const UNKNOWN_POINTS: &str = "boxes with an unknown number of LiDAR points";

/// Counts boxes whose category has an unknown name.
pub(super) fn note_unknown_category(notes: &mut Notes, category: &str, boxes: usize) {
    note(notes, &format!("boxes of the unknown category {category} (read as objects)"), boxes);
}

/// Counts skipped items.
pub(super) fn note(notes: &mut Notes, kind: &str, count: usize) {
    if count > 0 {
        *notes.entry(kind.to_owned()).or_default() += count;
    }
}
