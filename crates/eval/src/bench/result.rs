use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use point_skeleton::conditions::ImageSize;
use point_skeleton::error::FileError;
use point_skeleton::files::OutputFile;
use point_skeleton::raster::RasterizerInfo;
use serde::Serialize;

use super::measure::{Measured, TimedFrame};
use super::options::BenchOptions;
use super::workload::Workload;
use super::{memory, trace};

/// Result of a measurement.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BenchResult {
    /// Rasterizer, device and driver.
    #[serde(flatten)]
    pub info: RasterizerInfo,
    /// Points of all clouds.
    pub points: u64,
    /// Maximum number of cameras in a frame.
    pub cameras: usize,
    /// Distinct rendered sizes of the cameras, `HxW` separated by commas.
    pub size: String,
    /// Size to which maps are reduced.
    pub out_size: Option<ImageSize>,
    /// Number of timed frames.
    pub frames: usize,
    /// Times of the frames, milliseconds.
    pub frame_ms: Spread,
    /// Median over the frames, by stage name, milliseconds.
    pub stages_ms: BTreeMap<&'static str, f64>,
    /// Points times frames, divided by the total time of all frames.
    pub points_per_s: f64,
    /// Peak memory in 10⁶ bytes; `None` if the system does not report it.
    pub peak_rss_mb: Option<f64>,
    /// Pixels of the last frame with a depth; `None` without depth maps.
    pub filled: Option<u64>,
    /// Points that were never rendered because they are not finite.
    #[serde(skip)]
    pub non_finite: usize,
    /// Timed frames.
    #[serde(skip)]
    pub timed: Vec<TimedFrame>,
    /// Names of the workload's frames.
    #[serde(skip)]
    pub names: Vec<String>,
    /// Frames in flight.
    #[serde(skip)]
    pub in_flight: usize,
}

impl BenchResult {
    pub(super) fn new(
        workload: &Workload,
        points: usize,
        options: &BenchOptions,
        info: RasterizerInfo,
        measured: Measured,
    ) -> Self {
        let (frames, points) = (&measured.frames, points as u64);
        Self {
            info,
            points,
            cameras: workload.cameras(),
            size: workload.sizes(),
            out_size: options.conditions.out_size,
            frames: frames.len(),
            frame_ms: frame_ms(frames),
            stages_ms: stages_ms(frames),
            points_per_s: points_per_s(points, frames),
            peak_rss_mb: memory::peak_rss_bytes().map(|bytes| bytes as f64 / 1e6),
            filled: measured.filled,
            non_finite: workload.non_finite,
            names: workload.frames.iter().map(|frame| frame.name.clone()).collect(),
            in_flight: options.in_flight,
            timed: measured.frames,
        }
    }

    /// Writes all timed frames and their stages in the Chrome trace event format.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn write_trace(&self, file: &OutputFile) -> Result<(), FileError> {
        trace::write(file, &self.timed, self.in_flight, &self.names)
    }
}

/// Spread of times: min, median, max.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Minimum.
    pub min: f64,
    /// Median.
    pub median: f64,
    /// The number that 99 % do not exceed.
    pub p99: f64,
    /// Maximum.
    pub max: f64,
}

impl Spread {
    /// Computes the spread of numbers, in their unit; zeros if there are none.
    fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let mut values: Vec<f64> = values.into_iter().collect();
        values.sort_by(f64::total_cmp);
        let (Some(&min), Some(&max)) = (values.first(), values.last()) else {
            return Self { min: 0.0, median: 0.0, p99: 0.0, max: 0.0 };
        };
        let half = values.len() / 2;
        let median =
            if values.len() % 2 == 1 { values[half] } else { (values[half - 1] + values[half]) / 2.0 };
        let p99 = values[(values.len() * 99).div_ceil(100) - 1];
        Self { min, median, p99, max }
    }
}

/// Returns the spread of frame times, milliseconds.
fn frame_ms(frames: &[TimedFrame]) -> Spread {
    Spread::of(frames.iter().map(|frame| ms(frame.took)))
}

/// Returns the median time of every stage over the frames, milliseconds. A stage that a frame lacks counts as
/// zero.
fn stages_ms(frames: &[TimedFrame]) -> BTreeMap<&'static str, f64> {
    let names: BTreeSet<&'static str> = frames.iter().flat_map(|f| f.stages.0.keys().copied()).collect();
    let median = |name: &'static str| {
        let of_frame = |f: &TimedFrame| f.stages.0.get(name).copied().map_or(0.0, ms);
        Spread::of(frames.iter().map(of_frame)).median
    };
    names.into_iter().map(|name| (name, median(name))).collect()
}

/// Returns the throughput in points per second.
fn points_per_s(points: u64, frames: &[TimedFrame]) -> f64 {
    let seconds = frames.iter().map(|frame| frame.took).sum::<Duration>().as_secs_f64();
    points as f64 * frames.len() as f64 / seconds.max(1e-9)
}

fn ms(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

#[cfg(test)]
mod tests {
    use super::*;
    use point_skeleton::raster::StageTimes;

    fn frame(took_ms: u64, stages: &[(&'static str, u64)]) -> TimedFrame {
        let mut times = StageTimes::default();
        for (name, ms) in stages {
            times.add(name, Duration::from_millis(*ms));
        }
        let took = Duration::from_millis(took_ms);
        TimedFrame { index: 0, begun: Duration::ZERO, finished: took, took, stages: times }
    }

    #[test]
    fn computes_min_median_and_max() {
        let spread = |values: &[f64]| {
            let Spread { min, median, max, .. } = Spread::of(values.iter().copied());
            [min, median, max]
        };
        assert_eq!(spread(&[5.0, 1.0, 3.0]), [1.0, 3.0, 5.0]);
        assert_eq!(spread(&[4.0, 1.0, 2.0, 100.0]), [1.0, 3.0, 100.0]);
        assert_eq!(spread(&[7.0]), [7.0; 3]);
        assert_eq!(spread(&[]), [0.0; 3]);
    }

    #[test]
    fn summarizes_frame_and_stage_times() {
        let frames = [
            frame(100, &[("splat", 60), ("copy", 30)]),
            frame(300, &[("splat", 80)]),
            frame(200, &[("splat", 70)]),
        ];
        assert_eq!(frame_ms(&frames), Spread { min: 100.0, median: 200.0, p99: 300.0, max: 300.0 });
        // Two of three frames have no copy stage.
        assert_eq!(stages_ms(&frames), BTreeMap::from([("copy", 0.0), ("splat", 70.0)]));
        assert!((points_per_s(1000, &frames) - 5000.0).abs() < 1e-6);
        assert!(points_per_s(1000, &[frame(0, &[])]).is_finite());
    }

    #[test]
    fn one_in_a_hundred_exceeds_the_99th_percentile() {
        let p99 = |count: u32| Spread::of((1..=count).rev().map(f64::from)).p99;
        assert_eq!([p99(1), p99(99), p99(100), p99(101), p99(1000)], [1.0, 99.0, 99.0, 100.0, 990.0]);
    }
}
