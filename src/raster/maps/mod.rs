pub(super) mod map_set;
pub(super) mod plane;
pub mod reduce;

use std::collections::BTreeMap;
use std::time::Duration;

/// Maps of one view, row-major `height * width`; a map that was not requested has length 0.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SplatMaps {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Number of the winning point + 1, 0 where empty. Points are numbered across the job's instances in
    /// order.
    pub point: Vec<u32>,
    /// Camera depth in meters, `f32::INFINITY` where empty.
    pub depth_m: Vec<f32>,
    /// `r | g << 8 | b << 16 | class << 24` of the winning point, 0 where empty. Length 0
    /// if neither color nor class is requested.
    pub rgb_class: Vec<u32>,
    /// [`Instance::number`](super::Instance::number) of the winning point, 0 where empty.
    pub instance: Vec<u32>,
}

/// A line segment in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// One end, pixels: x to the right, y down, pixel centers at half-integers.
    pub from: [f32; 2],
    /// Other end, pixels.
    pub to: [f32; 2],
    /// Color.
    pub rgb: [u8; 3],
}

/// Time spent per named stage.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StageTimes(pub BTreeMap<&'static str, Duration>);

impl StageTimes {
    /// Adds time to a stage.
    pub fn add(&mut self, stage: &'static str, time: Duration) {
        *self.0.entry(stage).or_default() += time;
    }

    /// Adds all stage times of another.
    pub fn merge(&mut self, other: &Self) {
        for (stage, time) in &other.0 {
            self.add(stage, *time);
        }
    }
}
