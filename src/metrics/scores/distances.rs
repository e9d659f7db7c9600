use serde::Serialize;

use super::super::{
    FeatureSet, FrechetError, RandomConvNet, WINDOW_FRAMES, frechet_distance, window_features,
};

/// Features of rollouts, of which distances are taken together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CollectedFeatures {
    seed: Option<u64>,
    /// Of images, `[N, 64]`.
    generated: FeatureSet,
    truth: FeatureSet,
    /// Of windows of videos, `[N, 128]`.
    generated_windows: FeatureSet,
    truth_windows: FeatureSet,
}

/// A Fréchet distance and what it was taken of.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Distance {
    /// See [`frechet_distance`].
    pub distance: f64,
    /// Rows of generated features.
    pub generated: usize,
    /// Rows of true features.
    pub truth: usize,
    /// Numbers a row.
    pub features: usize,
}

/// Distances of generated images and videos from true ones.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Distances {
    /// What features are of: the network and its seed.
    pub network: String,
    /// As FID: of images. `None` with less than two of a kind.
    pub images: Option<Distance>,
    /// As FVD: of all windows of [`WINDOW_FRAMES`] frames, by one frame each. `None` where rollouts are shorter.
    pub videos: Option<Distance>,
    /// Frames a window.
    pub window_frames: usize,
}

impl CollectedFeatures {
    /// Of a rollout, by camera and step. Truth is compared as a whole: images without truth count, too.
    pub(super) fn of(
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

    /// Adds those of another rollout. `false`, and nothing is added, if they are of a network of another seed.
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

    /// Of all rollouts so far together.
    ///
    /// # Errors
    /// Features that have no distance; too few of them are none.
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
