//! Time differences.

/// Returns the seconds between two times in microseconds.
pub(super) fn seconds(from_us: i64, to_us: i64) -> f64 {
    to_us.saturating_sub(from_us) as f64 / 1e6
}
