//! Statistics of observed values: deviations and ranges.

use serde::{Deserialize, Serialize};

/// Statistics of an absolute error, with its final signed value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Deviation {
    /// Mean absolute value over all instants.
    pub mean: f64,
    /// Maximum absolute value over all instants.
    pub max: f64,
    /// Signed value at the last instant.
    pub end: f64,
}

/// Range of observed values.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Range {
    /// Minimum.
    pub min: f64,
    /// Maximum.
    pub max: f64,
}

impl Range {
    /// Extends a range to include a value.
    pub(super) fn with(range: Option<Self>, value: f64) -> Self {
        let range = range.unwrap_or(Self { min: value, max: value });
        Self { min: range.min.min(value), max: range.max.max(value) }
    }
}

impl Deviation {
    /// Adds the `count`th value.
    pub(super) fn add(&mut self, value: f64, count: usize) {
        self.mean += (value.abs() - self.mean) / count as f64;
        self.max = self.max.max(value.abs());
        self.end = value;
    }
}
