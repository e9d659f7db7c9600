//! Depth bins: depth as one of `n` classes, linear or logarithmic, computed in `f32` as the condition
//! contract requires.

use crate::{named, named_in_files};
use serde::{Deserialize, Serialize};

/// Spacing of the depth bins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BinScale {
    /// Bins of equal width.
    #[default]
    Linear,
    /// Finer near the camera: 85 % of the bins for the nearest 60 % of the range, logarithmic in both parts.
    Log,
}

named!(BinScale, "scale of depth bins" {
    Linear => "linear", "Bins of equal width";
    Log => "log",
        "Finer near the camera: 85 % of the bins for the nearest 60 % of the range, logarithmic in both \
            parts";
});
named_in_files!(BinScale);

/// Depth bins; bin 0 is "empty".
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DepthBins {
    /// Spacing of the bins.
    pub scale: BinScale,
    /// Number of bins, at least 2.
    pub count: u16,
    /// Far end of the last bin, meters.
    pub far_m: f32,
    /// Exponent of the near part of [`BinScale::Log`].
    pub gamma: f32,
}

impl Default for DepthBins {
    fn default() -> Self {
        Self { scale: BinScale::Linear, count: 256, far_m: 100.0, gamma: 1.0 }
    }
}

/// Keeps denominators off zero. Added to 32 or more it vanishes in `f32`, so depths at such a `far_m` get bin
/// `n`.
const EPSILON: f32 = 1e-6;

impl DepthBins {
    /// Returns the bin of a camera depth in meters: 1 to `count`, or 0 for an empty pixel (infinite, NaN, or
    /// not positive, as the −300 in files).
    #[inline]
    pub fn bin(&self, depth_m: f32) -> u16 {
        match self.scale {
            BinScale::Linear => self.linear_bin(depth_m),
            BinScale::Log if is_empty(depth_m) => 0,
            BinScale::Log => self.log_bin(depth_m.min(self.far_m)),
        }
    }

    /// Returns the bin of each depth in a map, in meters, as [`DepthBins::bin`] does.
    pub fn bins(&self, depth_m: &[f32]) -> Vec<u16> {
        match self.scale {
            // A loop of its own, which compiles to vectors.
            BinScale::Linear => depth_m.iter().map(|depth_m| self.linear_bin(*depth_m)).collect(),
            BinScale::Log => depth_m.iter().map(|depth_m| self.bin(*depth_m)).collect(),
        }
    }

    /// Calculates the bin of an empty pixel too, so that there is no branch.
    #[inline]
    fn linear_bin(&self, depth_m: f32) -> u16 {
        let steps = f32::from(self.count) - 1.0;
        let within_m = depth_m.min(self.far_m).max(0.0);
        let bin = (within_m / (self.far_m + EPSILON) * steps) as i32 as u16 + 1;
        if is_empty(depth_m) { 0 } else { bin }
    }

    fn log_bin(&self, depth_m: f32) -> u16 {
        let near_m = 0.6 * self.far_m;
        // Same as Python's `round()`: ties go to the even number.
        let near_bins =
            (0.85 * f64::from(self.count)).round_ties_even().min(f64::from(self.count) - 1.0) as u16;
        let far_bins = self.count - near_bins;
        if depth_m <= near_m {
            let part = ln_1p(depth_m) / (ln_1p(near_m) + EPSILON);
            let part = if self.gamma == 1.0 { part } else { part.powf(self.gamma) };
            return (part * (f32::from(near_bins) - 1.0)) as u16 + 1;
        }
        let part = ln_1p(depth_m - near_m) / (ln_1p(self.far_m - near_m) + EPSILON);
        (part * (f32::from(far_bins) - 1.0)) as u16 + 1 + near_bins
    }

    /// Returns the 16-bit PNG value of a bin; the bins are spread over the whole range.
    pub(crate) fn png_value(&self, bin: u16) -> u16 {
        bin * (u16::MAX / self.count)
    }

    /// Returns the color of every bin (`count + 1` colors): black for 0, then the TURBO colormap at `(bin −
    /// 1) / (count − 1)`.
    pub fn colors(&self) -> Vec<[u8; 3]> {
        use colorgrad::Gradient;
        let turbo = colorgrad::preset::turbo();
        let color = |bin: u16| {
            let [r, g, b, _] = turbo.at(f32::from(bin) / (f32::from(self.count) - 1.0)).to_rgba8();
            [r, g, b]
        };
        std::iter::once([0; 3]).chain((0..self.count).map(color)).collect()
    }
}

fn is_empty(depth_m: f32) -> bool {
    !(depth_m.is_finite() && depth_m > 0.0)
}

/// `ln(1 + x)` in `f64`, rounded once to `f32`, so that the result does not depend on the platform's
/// `log1pf`.
fn ln_1p(x: f32) -> f32 {
    f64::from(x).ln_1p() as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINEAR: DepthBins = DepthBins { scale: BinScale::Linear, count: 256, far_m: 50.0, gamma: 1.0 };
    const LOG: DepthBins = DepthBins { scale: BinScale::Log, ..LINEAR };

    #[test]
    fn ends_of_the_range() {
        for bins in [LINEAR, LOG] {
            for empty in [f32::INFINITY, f32::NAN, -300.0, 0.0] {
                assert_eq!(bins.bin(empty), 0);
            }
            assert_eq!(bins.bin(1e-5), 1);
            assert_eq!(bins.bin(50.0), bins.bin(1e9));
            let depths = [f32::NAN, 20.0, f32::INFINITY, 31.0, -300.0, 1e-5, 1e9, 0.0, -0.1, f32::MIN];
            assert_eq!(bins.bins(&depths), depths.map(|depth_m| bins.bin(depth_m)));
        }
        let most = DepthBins { count: u16::MAX, ..LINEAR };
        assert_eq!(most.bins(&[1e9, f32::NEG_INFINITY]), [u16::MAX, 0]);
        // 50 + 1e-6 is 50 in f32.
        assert_eq!(LINEAR.bin(50.0), 256);
        assert_eq!(LOG.bin(30.0), 217);
        assert_eq!(LOG.bin(30.01), 219);
    }

    #[test]
    fn bins_never_fall_with_depth() {
        for bins in [LINEAR, LOG] {
            let mut last = 0;
            for i in 1..6000 {
                let bin = bins.bin(i as f32 * 0.01);
                assert!(bin >= last && bin <= 256);
                last = bin;
            }
        }
    }

    #[test]
    fn png_and_preview() {
        assert_eq!((LINEAR.png_value(0), LINEAR.png_value(1), LINEAR.png_value(256)), (0, 255, 65_280));
        let colors = LINEAR.colors();
        assert_eq!((colors.len(), colors[0]), (257, [0; 3]));
        // Near is dark blue, the middle is green, far is dark red.
        let ([_, _, b], [_, g, _], [r, _, _]) = (colors[20], colors[128], colors[250]);
        assert!(b > 120 && g > 240 && r > 120, "{:?} {:?} {:?}", colors[20], colors[128], colors[250]);
    }
}
