//! Frames that a command uses, and where the ego is in them.

use std::fmt;
use std::str::FromStr;

use clap::Args;
use point_skeleton::scene::EgoOffset;

use super::numbers;

/// Frames of a recording.
#[derive(Clone, Copy, Debug, Default, Args)]
pub(crate) struct FrameArgs {
    /// Range of frames, numbered from 0 in log order, B excluded [default: all]
    #[arg(long, value_name = "A..B")]
    pub(crate) frames: Option<FrameRange>,
}

impl FrameArgs {
    /// Resolves the range for a log of `frames` frames; the default is all frames.
    pub(crate) fn of(self, frames: usize) -> anyhow::Result<std::ops::Range<usize>> {
        let Some(range) = self.frames else { return Ok(0..frames) };
        anyhow::ensure!(range.end <= frames, "expected --frames within 0..{frames}, found {range}");
        Ok(range.first..range.end)
    }

    /// Returns the range for logs of any length; `None` is all frames.
    pub(crate) fn of_any(self) -> Option<std::ops::Range<usize>> {
        self.frames.map(|range| range.first..range.end)
    }
}

/// Rate of samples.
#[derive(Clone, Copy, Debug, Default, Args)]
pub(crate) struct RateArgs {
    /// Sample at this rate (0.1 to 100 per second) over the time of the selected frames, instead of at the
    /// frames themselves; ego and actors are interpolated
    #[arg(long, value_name = "F", value_parser = numbers::rate_hz, allow_negative_numbers = true)]
    pub(crate) hz: Option<f64>,
}

/// Frames left out of training and of skeletons.
#[derive(Clone, Copy, Debug, Default, Args)]
pub(crate) struct HoldOutArgs {
    /// Held-out frames: every N-th, N - 1, 2 N - 1, ..; trainings and `build --every N` leave them out,
    /// `evaluate` and `fidelity` use them alone
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(2..))]
    pub(crate) hold_out: Option<u16>,
}

/// Displacement of the ego.
#[derive(Clone, Copy, Debug, Default, Args)]
pub(crate) struct MovedEgoArgs {
    /// Move the ego in its own frame, like forward_m=1,left_m=2,yaw_deg=5: meters forward, to the left and up
    /// (up_m), degrees to the left and of the front upward (pitch_deg)
    #[arg(long, value_name = "left_m=M,..")]
    pub(crate) ego_offset: Option<EgoOffset>,
}

/// Half-open, non-empty range of frames `A..B`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct FrameRange {
    first: usize,
    end: usize,
}

impl fmt::Display for FrameRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}..{}", self.first, self.end)
    }
}

impl FromStr for FrameRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| text.trim().parse::<usize>().ok();
        let ends = text.split_once("..").and_then(|(a, b)| Some((number(a)?, number(b)?)));
        match ends {
            Some((first, end)) if first < end => Ok(Self { first, end }),
            _ => Err("expected frames A..B with A < B (B is not among them)".to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parses_frame_ranges() {
        let range: FrameRange = "2..5".parse().unwrap();
        assert_eq!(FrameArgs { frames: Some(range) }.of(5).unwrap(), 2..5);
        assert_eq!(FrameArgs::default().of(5).unwrap(), 0..5);
        let message = FrameArgs { frames: Some(range) }.of(4).unwrap_err().to_string();
        assert!(message.contains("0..4, found 2..5"), "{message}");
        for text in ["", "3", "5..2", "2..2", "..3", "1..", "-1..3", "1..x"] {
            assert!(text.parse::<FrameRange>().is_err(), "{text}");
        }
    }
}
