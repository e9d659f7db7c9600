//! Features of other networks: NPY files `[N, D]`.

use std::path::Path;

use point_skeleton::cloud::npy::read_features;
use point_skeleton::error::FileError;

use super::error::EvaluateError;
use crate::{Distance, FeatureSet, frechet_distance};

/// Returns the Fréchet distance between features of generated and ground-truth images.
pub(super) fn distance(generated: &Path, truth: &Path) -> Result<Distance, EvaluateError> {
    let (a, b) = (read(generated)?, read(truth)?);
    let distance = frechet_distance(&a, &b).map_err(EvaluateError::in_files(format!(
        "{} and {}",
        generated.display(),
        truth.display()
    )))?;
    Ok(Distance { distance, generated: a.len(), truth: b.len(), features: a.columns() })
}

fn read(path: &Path) -> Result<FeatureSet, FileError> {
    let (columns, values) = read_features(path)?;
    FeatureSet::new(columns, values)
        .ok_or_else(|| FileError::content("whole rows of features", "a part of one", path))
}
