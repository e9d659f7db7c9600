//! Rates and sizes that video generators expect of their clips.

use point_skeleton::conditions::{ConditionOptions, ImageSize};
use point_skeleton::dataset::{Frame, Recording, RigCamera};
use point_skeleton::scene::frame_rate_hz;

use crate::ExportError;

/// Relative difference from the expected rate that is accepted.
const RATE_TOLERANCE: f64 = 0.1;
/// Longest step between key frames, relative to the median one: a longer one is a gap.
const MAX_STEP: f64 = 1.5;
/// Largest difference between the times of a sample and its recorded image, in periods of the samples. Half a
/// period is enough if the log has an image per sample; the rest is for jitter.
const IMAGE_PERIODS: f64 = 0.6;

/// Clips of a generator: all rules but those of its files.
#[derive(Debug)]
pub(crate) struct ClipRules {
    /// Rate, samples per second.
    hz: f64,
    /// The rate as text, for messages.
    expected_rate: &'static str,
    /// Samples in a clip.
    pub(crate) length: usize,
    /// Width of the maps if no size is requested, pixels. The height then follows from the cameras.
    width: u32,
    /// Smallest size.
    min: ImageSize,
    /// Whether other widths are rejected.
    is_width_fixed: bool,
    /// The sizes as text, for messages.
    expected_size: &'static str,
    /// Whether maps have to be written at the size at which they are rendered.
    is_unreduced: bool,
}

/// Clips of StreetCrafter. Its loader crops and resizes images to 1024x576, or to 576x320 in low resolution.
pub(crate) const STREETCRAFTER: ClipRules = ClipRules {
    hz: 10.0,
    expected_rate: "samples at 10 Hz with the layout streetcrafter (--hz 10, or key frames at 9 to 11 Hz)",
    length: 25,
    width: 1024,
    min: ImageSize { height: 320, width: 576 },
    is_width_fixed: false,
    expected_size: "a --size of at least 320x576 with the layout streetcrafter",
    is_unreduced: true,
};

/// Clips of FreeVS. Its loader takes images as they are; its networks have a fixed size.
pub(crate) const FREEVS: ClipRules = ClipRules {
    hz: 5.0,
    expected_rate: "samples at 5 Hz with the layout freevs (--hz 5, or key frames at 4.5 to 5.5 Hz)",
    length: 6,
    width: 960,
    min: ImageSize { height: 384, width: 960 },
    is_width_fixed: true,
    expected_size: "a size of 960 columns and at least 384 rows with the layout freevs",
    is_unreduced: false,
};

impl ClipRules {
    /// Checks a rate.
    ///
    /// # Errors
    /// Fails if it is not near the generator's.
    pub(crate) fn check_hz(&self, hz: Option<f64>) -> Result<(), ExportError> {
        let found = match hz {
            None => "images between key frames",
            Some(hz) if !self.is_near(hz) => "another rate",
            Some(_) => return Ok(()),
        };
        Err(ExportError::Options { expected: self.expected_rate, found })
    }

    fn is_near(&self, hz: f64) -> bool {
        ((1.0 - RATE_TOLERANCE) * self.hz..=(1.0 + RATE_TOLERANCE) * self.hz).contains(&hz)
    }

    /// Checks the requested sizes.
    ///
    /// # Errors
    /// Fails if the generator cannot use them.
    pub(crate) fn check_size(&self, options: &ConditionOptions) -> Result<(), ExportError> {
        if self.is_unreduced && options.out_size.is_some() {
            let expected = "--size alone with the layout streetcrafter, whose masks are not reduced";
            return Err(ExportError::Options { expected, found: "--out-size" });
        }
        let Some(ImageSize { height, width }) = options.out_size.or(options.size) else { return Ok(()) };
        let is_small = height < self.min.height || width < self.min.width;
        if is_small || self.is_width_fixed && width != self.width {
            return Err(ExportError::Options { expected: self.expected_size, found: "another size" });
        }
        Ok(())
    }

    /// Checks the key frames of a log that become samples.
    ///
    /// # Errors
    /// Fails if their rate is not near the generator's, or if there are gaps.
    pub(crate) fn check_frames(&self, frames: &[Frame], log: &Recording) -> Result<(), ExportError> {
        let found = match frame_rate_hz(frames) {
            None => "no sequence of key frames".to_owned(),
            Some(hz) if !self.is_near(hz) => format!("key frames at {hz:.1} Hz"),
            Some(hz) => {
                let steps = frames.windows(2).map(|pair| (pair[1].t_us - pair[0].t_us) as f64 * 1e-6);
                let longest_s = steps.fold(0.0, f64::max);
                if longest_s * hz <= MAX_STEP {
                    return Ok(());
                }
                format!("key frames that are {longest_s:.1} s apart")
            }
        };
        Err(ExportError::Lacks { expected: self.expected_rate, found, log: log.name.clone() })
    }

    /// Returns the size of a log's maps if none is requested: the cameras' at the generator's width.
    ///
    /// # Errors
    /// Fails if the cameras differ in shape, or if they are too wide for the generator.
    pub(crate) fn size(&self, log: &Recording) -> Result<ImageSize, ExportError> {
        let height = |rig: &RigCamera| {
            let height = u64::from(self.width) * u64::from(rig.camera.height);
            (2 * height / u64::from(rig.camera.width)).div_ceil(2) as u32 // rounded
        };
        let lacks = |expected, rig: &RigCamera| {
            let found = format!("{}x{} ({})", rig.camera.height, rig.camera.width, rig.camera.name);
            Err(ExportError::Lacks { expected, found, log: log.name.clone() })
        };
        let Some(first) = log.rig.first() else { return Ok(self.min) };
        let size = ImageSize { height: height(first), width: self.width };
        if let Some(other) = log.rig.iter().find(|rig| height(rig) != size.height) {
            return lacks("cameras whose images all have one shape, or --size,", other);
        }
        if size.height < self.min.height {
            return lacks("cameras whose images are less wide, or --size,", first);
        }
        Ok(size)
    }

    /// Returns whether an image belongs to a sample at a rate.
    pub(crate) fn is_timely(image_us: i64, sample_us: i64, hz: f64) -> bool {
        image_us.abs_diff(sample_us) as f64 <= IMAGE_PERIODS * 1e6 / hz
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sizes(size: Option<[u32; 2]>, out_size: Option<[u32; 2]>) -> ConditionOptions {
        let of = |[height, width]: [u32; 2]| ImageSize { height, width };
        ConditionOptions { size: size.map(of), out_size: out_size.map(of), ..ConditionOptions::default() }
    }

    #[test]
    fn sizes_are_checked() {
        for (rules, size, out_size, is_accepted) in [
            (STREETCRAFTER, None, None, true),
            (STREETCRAFTER, Some([576, 1024]), None, true),
            (STREETCRAFTER, Some([320, 576]), None, true),
            (STREETCRAFTER, Some([319, 576]), None, false),
            (STREETCRAFTER, Some([900, 1600]), Some([576, 1024]), false),
            (FREEVS, None, None, true),
            (FREEVS, Some([384, 960]), None, true),
            (FREEVS, Some([383, 960]), None, false),
            (FREEVS, Some([540, 961]), None, false),
            (FREEVS, Some([900, 1600]), Some([540, 960]), true),
            (FREEVS, Some([540, 960]), Some([270, 480]), false),
        ] {
            let checked = rules.check_size(&sizes(size, out_size));
            assert_eq!(checked.is_ok(), is_accepted, "{size:?} {out_size:?}");
        }
    }

    #[test]
    fn rates_are_checked() {
        for (rules, hz, is_accepted) in [
            (STREETCRAFTER, Some(9.0), true),
            (STREETCRAFTER, Some(11.0), true),
            (STREETCRAFTER, Some(8.9), false),
            (STREETCRAFTER, Some(12.0), false),
            (FREEVS, Some(5.0), true),
            (FREEVS, Some(10.0), false),
            (FREEVS, None, false),
        ] {
            assert_eq!(rules.check_hz(hz).is_ok(), is_accepted, "{hz:?}");
        }
    }

    #[test]
    fn images_belong_to_samples_within_a_part_of_the_period() {
        assert!(ClipRules::is_timely(1_000_000, 1_060_000, 10.0));
        assert!(!ClipRules::is_timely(1_061_000, 1_000_000, 10.0));
    }
}
