use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// One entry of a splat schedule.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SplatStep {
    /// Maximum camera depth of this entry, meters, inclusive.
    pub z_max_m: f32,
    /// Radius of a point up to that depth: it covers `(2·radius + 1)²` pixels.
    pub radius: u32,
}

/// Splat radius by depth: `z_max` strictly increasing, radii never increasing. Text form `15:2,35:1,100:0`.
#[derive(Clone, Debug, PartialEq)]
pub struct SplatSchedule(Vec<SplatStep>);

/// Reason for rejecting a schedule.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ScheduleError {
    /// Not of the form `Z:R,Z:R`.
    #[error("expected a splat schedule like 15:2,35:1,100:0, found {0:?}")]
    Form(String),
    /// `z_max` not positive, not increasing, or at least 2³⁰ m.
    #[error("expected positive, rising depths in the splat schedule, found {0}")]
    Depths(SplatSchedule),
    /// A radius that increases with depth or exceeds the limit.
    #[error("expected radii of at most {max} that never increase with depth, found \
        {schedule}", max = SplatSchedule::MAX_RADIUS)]
    Radii {
        /// Rejected schedule.
        schedule: SplatSchedule,
    },
    /// Too many entries.
    #[error("expected 1 to {max} entries in the splat schedule, found {0}", max = SplatSchedule::MAX_STEPS)]
    Count(usize),
}

impl SplatSchedule {
    /// Maximum radius, pixels: drivers guarantee points of 63 pixels.
    pub const MAX_RADIUS: u32 = 31;
    /// Upper bound of depths (exclusive): 2³⁰ m, since the depth buffer stores `z·2⁻³⁰`.
    pub const Z_LIMIT_M: f32 = 1_073_741_824.0;
    /// Maximum number of entries in the shaders.
    pub const MAX_STEPS: usize = 16;

    /// Validates the entries.
    ///
    /// # Errors
    /// Returns [`ScheduleError`] with the reason if an entry is invalid.
    pub fn new(steps: Vec<SplatStep>) -> Result<Self, ScheduleError> {
        if steps.is_empty() || steps.len() > Self::MAX_STEPS {
            return Err(ScheduleError::Count(steps.len()));
        }
        let schedule = Self(steps);
        let steps = &schedule.0;
        let rising = steps.windows(2).all(|w| w[0].z_max_m < w[1].z_max_m);
        if !rising || !steps.iter().all(|s| s.z_max_m > 0.0 && s.z_max_m < Self::Z_LIMIT_M) {
            return Err(ScheduleError::Depths(schedule));
        }
        let falling = steps.windows(2).all(|w| w[0].radius >= w[1].radius);
        if !falling || steps[0].radius > Self::MAX_RADIUS {
            return Err(ScheduleError::Radii { schedule });
        }
        Ok(schedule)
    }

    /// Returns the entries, nearest first; never empty.
    pub fn steps(&self) -> &[SplatStep] {
        &self.0
    }

    /// Returns the radius of the nearest points, which is the padding of the viewport.
    pub fn max_radius(&self) -> u32 {
        self.0.iter().map(|s| s.radius).max().unwrap_or(0)
    }

    /// Returns the depth beyond which nothing is drawn, meters.
    pub fn z_far_m(&self) -> f32 {
        self.0.last().map_or(0.0, |s| s.z_max_m)
    }

    /// Returns the depth up to which points have at least some radius, meters; 0 if none has.
    pub(super) fn reach_m(&self, radius: u32) -> f32 {
        self.0.iter().rev().find(|step| step.radius >= radius).map_or(0.0, |step| step.z_max_m)
    }

    /// Returns the radius at camera depth `z` in meters; `None` if the point is not drawn (also for NaN).
    pub fn radius_at(&self, z: f32) -> Option<u32> {
        if z > Z_NEAR_M { self.0.iter().find(|s| z <= s.z_max_m).map(|s| s.radius) } else { None }
    }
}

/// Near plane: points at or below this camera depth are not drawn, meters.
pub(super) const Z_NEAR_M: f32 = 1e-5;

/// Entries of the default schedule, which is for nuScenes: images 1600 pixels wide.
pub(crate) const DEFAULT_STEPS: [SplatStep; 3] = [
    SplatStep { z_max_m: 15.0, radius: 2 },
    SplatStep { z_max_m: 35.0, radius: 1 },
    SplatStep { z_max_m: 100.0, radius: 0 },
];

impl Default for SplatSchedule {
    fn default() -> Self {
        Self(DEFAULT_STEPS.to_vec())
    }
}

impl FromStr for SplatSchedule {
    type Err = ScheduleError;

    fn from_str(text: &str) -> Result<Self, ScheduleError> {
        let form = || ScheduleError::Form(text.to_owned());
        let step = |part: &str| {
            let (z, r) = part.split_once(':').ok_or_else(form)?;
            let z_max_m = z.trim().parse().map_err(|_| form())?;
            Ok(SplatStep { z_max_m, radius: r.trim().parse().map_err(|_| form())? })
        };
        Self::new(text.split(',').map(step).collect::<Result<_, _>>()?)
    }
}

/// Serializes to the text form.
impl Serialize for SplatSchedule {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for SplatSchedule {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

impl fmt::Display for SplatSchedule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, step) in self.0.iter().enumerate() {
            let comma = if i == 0 { "" } else { "," };
            write!(f, "{comma}{}:{}", step.z_max_m, step.radius)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_round_trips() {
        let schedule: SplatSchedule = "15:2,35:1,100:0".parse().unwrap();
        assert_eq!(schedule, SplatSchedule::default());
        assert_eq!(schedule.to_string(), "15:2,35:1,100:0");
        assert_eq!((schedule.max_radius(), schedule.z_far_m()), (2, 100.0));
    }

    #[test]
    fn rejects_invalid_text() {
        for text in [
            "",
            "15",
            "15:x",
            "35:1,15:2",
            "15:1,35:2",
            "15:1,15:0",
            "0:1",
            "-1:1",
            "inf:1",
            "2e9:1",
            "NaN:1",
            "9:32",
        ] {
            assert!(text.parse::<SplatSchedule>().is_err(), "{text}");
        }
    }

    #[test]
    fn radius_changes_at_inclusive_depths() {
        let schedule = SplatSchedule::default();
        let at = |z| schedule.radius_at(z);
        assert_eq!([at(1e-5), at(2e-5), at(15.0), at(15.001)], [None, Some(2), Some(2), Some(1)]);
        assert_eq!([at(100.0), at(100.01), at(f32::NAN), at(-1.0)], [Some(0), None, None, None]);
    }
}
