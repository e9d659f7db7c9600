//! Features of other networks: NPY files `[N, D]`.

use std::path::Path;

use point_skeleton::cloud::npy::read_features;
use point_skeleton::error::FileError;
use point_skeleton::memory::{MemoryError, Need, Reservation, reserve};

use super::error::EvaluateError;
use crate::{Distance, FeatureSet, frechet_distance};

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
    Ok(Distance { distance, generated: a.len(), truth: b.len(), features: a.columns() })
}

/// Reserves the memory of deviations, and of covariances or products and their eigenvectors.
fn reserve_moments(a: &FeatureSet, b: &FeatureSet) -> Result<Reservation, MemoryError> {
    const MATRICES: u64 = 6;
    let side = a.columns().min(a.len().max(b.len())) as u64;
    let numbers = (a.values().len() + b.values().len()) as u64;
    let bytes = numbers.saturating_add(MATRICES * side.saturating_mul(side)).saturating_mul(8);
    let what = || format!("a distance of {} and {} rows of {} features", a.len(), b.len(), a.columns());
    reserve(bytes, || Need { what: what(), bytes, advice: "files of fewer rows or features need less" })
}

fn read(path: &Path) -> Result<FeatureSet, FileError> {
    let (columns, values) = read_features(path)?;
    FeatureSet::new(columns, values)
        .ok_or_else(|| FileError::content("whole rows of features", "a part of one", path))
}
