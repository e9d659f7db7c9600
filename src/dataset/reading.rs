//! Options for reading logs whose data do not say what they mean, or are incomplete.

use super::MissingData;
use crate::named;

/// Options for reading a log, where its data are ambiguous or incomplete.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReadOptions {
    /// Meaning of the ring column of sweeps.
    pub rings: RingMeaning,
    /// Whether recorded images have the lens distortion that the calibration states.
    pub distortion: ImageDistortion,
    /// What to do about missing and damaged parts.
    pub missing: MissingData,
}

/// Meaning of the ring column of sweeps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RingMeaning {
    /// Merged LiDARs if the directions of their points prove it, otherwise beams.
    #[default]
    Auto,
    /// Number of a LiDAR in a merged sweep.
    Device,
    /// Number of a beam.
    Beam,
}

named!(RingMeaning, "meaning of rings" {
    Auto => "auto", "Merged LiDARs if the directions of their points prove it, otherwise beams";
    Device => "device", "A LiDAR of a merged sweep; LiDAR 0 matches the boxes of moving actors";
    Beam => "beam", "A beam of one LiDAR";
});

/// Whether recorded images have the lens distortion that the calibration states.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ImageDistortion {
    /// As usual for the layout: nuPlan's images are distorted; nuScenes and Argoverse 2 provide rectified
    /// images.
    #[default]
    Usual,
    /// Images are as the lens recorded them.
    Apply,
    /// Images are rectified: the coefficients describe the lens before.
    Ignore,
}

named!(ImageDistortion, "image distortion" {
    Usual => "usual", "Applied in nuPlan, ignored in other layouts";
    Apply => "apply", "Images are as the lens recorded them";
    Ignore => "ignore", "Images are rectified, although coefficients are given";
});

impl ReadOptions {
    /// Names the options of ambiguous data that are not the default, for comparisons with an earlier reading;
    /// empty if all are.
    pub fn names(&self) -> Vec<&'static str> {
        let rings = match self.rings {
            RingMeaning::Auto => None,
            RingMeaning::Device => Some("ring-is device"),
            RingMeaning::Beam => Some("ring-is beam"),
        };
        let distortion = match self.distortion {
            ImageDistortion::Usual => None,
            ImageDistortion::Apply => Some("image-distortion apply"),
            ImageDistortion::Ignore => Some("image-distortion ignore"),
        };
        rings.into_iter().chain(distortion).collect()
    }
}
