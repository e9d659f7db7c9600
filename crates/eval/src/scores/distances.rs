use serde::Serialize;

use super::super::{
    FeatureSet, FrechetError, RandomConvNet, WINDOW_FRAMES, frechet_distance, window_features,
};

/// Features of rollouts, for distances over all of them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CollectedFeatures {
    seed: Option<u64>,
    /// Features of images, `[N, 64]`.
    generated: FeatureSet,
    truth: FeatureSet,
    /// Features of video windows, `[N, 128]`.
    generated_windows: FeatureSet,
    truth_windows: FeatureSet,
}

/// A Fréchet distance, with the sizes of its feature sets.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Distance {
    /// The distance, see [`frechet_distance`].
    pub distance: f64,
    /// Row count of generated features.
    pub generated: usize,
    /// Row count of ground-truth features.
    pub truth: usize,
    /// Number of features per row.
    pub features: usize,
}

/// Distances between generated and ground-truth images and videos.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Distances {
    /// Network of the features, with its seed.
    pub network: String,
    /// Distance of images, like FID. `None` with less than two images of either kind.
    pub images: Option<Distance>,
    /// Distance of videos, like FVD, over all windows of [`WINDOW_FRAMES`] frames with stride 1. `None` with
    /// less than two windows of either kind.
    pub videos: Option<Distance>,
    /// Number of frames per window.
    pub window_frames: usize,
}

impl CollectedFeatures {
    /// Collects the features of a rollout, by camera and step. The sets are compared as a whole, so generated
    /// images without ground truth count, too.
    pub(crate) fn of(
        net: &RandomConvNet,
        generated: &[Vec<Option<Vec<f64>>>],
        truth: &[Vec<Option<Vec<f64>>>],
    ) -> Self {
        let images = |cameras: &[Vec<Option<Vec<f64>>>]| {
            let mut set = FeatureSet::default();
            cameras.iter().flatten().flatten().for_each(|row| {
                set.push(row);
            });
            set
        };
        let windows = |cameras: &[Vec<Option<Vec<f64>>>]| {
            let mut set = FeatureSet::default();
            cameras.iter().for_each(|frames| {
                set.append(&window_features(frames));
            });
            set
        };
        Self {
            seed: Some(net.seed()),
            generated: images(generated),
            truth: images(truth),
            generated_windows: windows(generated),
            truth_windows: windows(truth),
        }
    }

    /// Adds the features of another rollout. Returns `false` and adds nothing if they are of a network with
    /// another seed.
    pub fn append(&mut self, other: &Self) -> bool {
        let fits = self.seed.is_none() || other.seed.is_none() || self.seed == other.seed;
        if fits {
            self.seed = self.seed.or(other.seed);
            self.generated.append(&other.generated);
            self.truth.append(&other.truth);
            self.generated_windows.append(&other.generated_windows);
            self.truth_windows.append(&other.truth_windows);
        }
        fits
    }

    /// Replaces the features of ground-truth images by features from other rollouts.
    #[must_use]
    pub fn with_truth_of(self, reference: &Self) -> Self {
        let Self { truth, truth_windows, .. } = reference.clone();
        Self { truth, truth_windows, ..self }
    }

    /// Computes the distances over all rollouts so far.
    ///
    /// # Errors
    /// Returns an error if features have no distance; too few rows give `None` instead.
    pub fn distances(&self) -> Result<Distances, FrechetError> {
        Ok(Distances {
            network: format!("RandomConvNet, seed {}", self.seed.unwrap_or_default()),
            images: distance(&self.generated, &self.truth)?,
            videos: distance(&self.generated_windows, &self.truth_windows)?,
            window_frames: WINDOW_FRAMES,
        })
    }
}

fn distance(generated: &FeatureSet, truth: &FeatureSet) -> Result<Option<Distance>, FrechetError> {
    let features = generated.columns();
    let of = |distance| Distance { distance, generated: generated.len(), truth: truth.len(), features };
    match frechet_distance(generated, truth) {
        Err(FrechetError::Rows(..)) => Ok(None),
        found => found.map(of).map(Some),
    }
}
