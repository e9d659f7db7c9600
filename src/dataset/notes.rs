//! Counts of the items that a reader skips or misses.

use std::collections::BTreeMap;

/// Number of skipped or missing items by kind.
pub(super) type Notes = BTreeMap<String, usize>;

/// Counts skipped items.
pub(super) fn note(notes: &mut Notes, kind: &str, count: usize) {
    if count > 0 {
        *notes.entry(kind.to_owned()).or_default() += count;
    }
}
