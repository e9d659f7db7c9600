//! Features of other networks: NPY files `[N, D]`.

use std::path::Path;

use point_skeleton::cloud::npy::read_features;
use point_skeleton::error::FileError;
use point_skeleton::memory::{MemoryError, Need, Reservation, reserve};
use serde::Serialize;

use super::error::EvaluateError;
use crate::{FeatureSet, frechet_distance};

/// A Fréchet distance, with the sizes of its feature sets.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Distance {
    /// The distance, see [`frechet_distance`].
    pub(super) distance: f64,
    /// Row count of generated features.
    generated: usize,
    /// Row count of ground-truth features.
    truth: usize,
    /// Number of features per row.
    features: usize,
}

/// Returns the Fréchet distance between features of generated and ground-truth images.
pub(super) fn distance(generated: &Path, truth: &Path) -> Result<Distance, EvaluateError> {
    let (a, b) = (read(generated)?, read(truth)?);
    let _moments =
        reserve_moments(&a, &b).map_err(|error| FileError::io("compare", generated)(error.into()))?;
    let distance = frechet_distance(&a, &b).map_err(EvaluateError::in_files(format!(
        "{} and {}",
        generated.display(),
        truth.display()
    )))?;
    Ok(Distance { distance, generated: a.rows().len(), truth: b.rows().len(), features: a.columns() })
}

/// Reserves the memory of deviations, and of covariances or products and their eigenvectors.
fn reserve_moments(a: &FeatureSet, b: &FeatureSet) -> Result<Reservation, MemoryError> {
    const MATRICES: u64 = 6;
    let ([a_rows, b_rows], columns) = ([a, b].map(|set| set.rows().len()), a.columns());
    let side = columns.min(a_rows.max(b_rows)) as u64;
    let numbers = (a_rows * columns + b_rows * b.columns()) as u64;
    let bytes = numbers.saturating_add(MATRICES * side.saturating_mul(side)).saturating_mul(8);
    let what = || format!("a distance of {a_rows} and {b_rows} rows of {columns} features");
    reserve(bytes, || Need { what: what(), bytes, advice: "files of fewer rows or features need less" })
}

fn read(path: &Path) -> Result<FeatureSet, FileError> {
    let (columns, values) = read_features(path)?;
    FeatureSet::new(columns, values)
        .ok_or_else(|| FileError::content("whole rows of features", "a part of one", path))
}
