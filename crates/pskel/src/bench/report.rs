use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::time::Duration;

use point_skeleton::conditions::ImageSize;
use point_skeleton::raster::RasterizerInfo;
use serde::Serialize;

use super::measure::TimedFrame;

/// Output of `--json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Report {
    #[serde(flatten)]
    pub(super) info: RasterizerInfo,
    /// Points of all clouds.
    pub(super) points: u64,
    /// Maximum number of cameras in a frame.
    pub(super) cameras: usize,
    /// Rendered size of the cameras.
    pub(super) size: String,
    /// Size to which maps are reduced.
    pub(super) out_size: Option<ImageSize>,
    /// Number of timed frames.
    pub(super) frames: usize,
    pub(super) frame_ms: Spread,
    /// Median over the frames, by stage name.
    pub(super) stages_ms: BTreeMap<&'static str, f64>,
    /// Points times frames, divided by the total time of all frames.
    pub(super) points_per_s: f64,
    /// Peak memory in 10⁶ bytes; `None` if the system does not report it.
    pub(super) peak_rss_mb: Option<f64>,
    /// Pixels of the last frame with a depth; `None` without depth maps.
    pub(super) filled: Option<u64>,
}

/// Spread of times: min, median, max.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Spread {
    pub(super) min: f64,
    pub(super) median: f64,
    pub(super) max: f64,
}

impl Spread {
    /// Computes the spread of numbers, in their unit; zeros if there are none.
    pub(super) fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let mut values: Vec<f64> = values.into_iter().collect();
        values.sort_by(f64::total_cmp);
        let (Some(&min), Some(&max)) = (values.first(), values.last()) else {
            return Self { min: 0.0, median: 0.0, max: 0.0 };
        };
        let half = values.len() / 2;
        let median =
            if values.len() % 2 == 1 { values[half] } else { (values[half - 1] + values[half]) / 2.0 };
        Self { min, median, max }
    }
}

/// Returns the spread of frame times, milliseconds.
pub(super) fn frame_ms(frames: &[TimedFrame]) -> Spread {
    Spread::of(frames.iter().map(|frame| ms(frame.took)))
}

/// Returns the median time of every stage over the frames, milliseconds. A stage that a frame lacks counts as zero.
pub(super) fn stages_ms(frames: &[TimedFrame]) -> BTreeMap<&'static str, f64> {
    let names: BTreeSet<&'static str> = frames.iter().flat_map(|f| f.stages.0.keys().copied()).collect();
    let median = |name: &'static str| {
        let of_frame = |f: &TimedFrame| f.stages.0.get(name).copied().map_or(0.0, ms);
        Spread::of(frames.iter().map(of_frame)).median
    };
    names.into_iter().map(|name| (name, median(name))).collect()
}

/// Returns the throughput in points per second.
pub(super) fn points_per_s(points: u64, frames: &[TimedFrame]) -> f64 {
    let seconds = frames.iter().map(|frame| frame.took).sum::<Duration>().as_secs_f64();
    points as f64 * frames.len() as f64 / seconds.max(1e-9)
}

fn ms(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

impl Report {
    /// Formats the table for the terminal. `notes` are appended to the lines that their keys name.
    pub(super) fn table(&self, notes: &BTreeMap<&str, String>) -> String {
        let mut table = String::new();
        // Writing to a string cannot fail.
        let mut line = |name: &str, value: &str| {
            let note = notes.get(name).map(|note| format!(" ({note})")).unwrap_or_default();
            let _ = writeln!(table, "{name:<12} {value}{note}");
        };
        line("device", &self.info.device);
        line("driver", &self.info.driver);
        line("rasterizer", self.info.rasterizer);
        line("points", &self.points.to_string());
        line("cameras", &self.cameras.to_string());
        line("size", &self.size);
        line("out size", &self.out_size.map_or("not reduced".to_owned(), |size| size.to_string()));
        line("frames", &self.frames.to_string());
        let Spread { min, median, max } = self.frame_ms;
        line("frame", &format!("min {min:.2}, median {median:.2}, max {max:.2} ms"));
        let mut stages: Vec<(&&str, &f64)> = self.stages_ms.iter().collect();
        stages.sort_by(|a, b| b.1.total_cmp(a.1));
        for (name, stage_ms) in stages {
            let share = 100.0 * stage_ms / median.max(1e-9);
            line(&format!("  {name}"), &format!("{stage_ms:>9.2} ms {share:>5.1} %"));
        }
        line("points/s", &format!("{:.1} million", self.points_per_s / 1e6));
        line("memory", &self.peak_rss_mb.map_or("not known".to_owned(), |mb| format!("{mb:.0} MB at most")));
        line("filled", &self.filled.map_or("no depth map".to_owned(), |pixels| format!("{pixels} pixels")));
        table
    }

    /// Formats a one-line summary.
    pub(super) fn summary(&self) -> String {
        format!(
            "drew {} frames of {} points in {} cameras by {} on {}: {:.2} ms a frame, {:.1} million points/s",
            self.frames,
            self.points,
            self.cameras,
            self.info.rasterizer,
            self.info.device,
            self.frame_ms.median,
            self.points_per_s / 1e6
        )
    }
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
        TimedFrame { begun: Duration::ZERO, finished: took, took, stages: times }
    }

    #[test]
    fn the_median_is_the_middle_or_between_the_two_in_the_middle() {
        let spread = |values: &[f64]| {
            let Spread { min, median, max } = Spread::of(values.iter().copied());
            [min, median, max]
        };
        assert_eq!(spread(&[5.0, 1.0, 3.0]), [1.0, 3.0, 5.0]);
        assert_eq!(spread(&[4.0, 1.0, 2.0, 100.0]), [1.0, 3.0, 100.0]);
        assert_eq!(spread(&[7.0]), [7.0; 3]);
        assert_eq!(spread(&[]), [0.0; 3]);
    }

    #[test]
    fn figures_of_frames() {
        let frames = [
            frame(100, &[("splat", 60), ("copy", 30)]),
            frame(300, &[("splat", 80)]),
            frame(200, &[("splat", 70)]),
        ];
        assert_eq!(frame_ms(&frames), Spread { min: 100.0, median: 200.0, max: 300.0 });
        // Two of three frames have no copy stage.
        assert_eq!(stages_ms(&frames), BTreeMap::from([("copy", 0.0), ("splat", 70.0)]));
        assert!((points_per_s(1000, &frames) - 5000.0).abs() < 1e-6);
        assert!(points_per_s(1000, &[frame(0, &[])]).is_finite());
    }

    fn report() -> Report {
        Report {
            info: RasterizerInfo { rasterizer: "cpu", device: "host".into(), driver: "plain".into() },
            points: 4_000_000,
            cameras: 6,
            size: "900x1600".into(),
            out_size: None,
            frames: 20,
            frame_ms: Spread { min: 10.0, median: 20.0, max: 40.0 },
            stages_ms: BTreeMap::from([("copy", 5.0), ("splat", 15.0)]),
            points_per_s: 2e8,
            peak_rss_mb: None,
            filled: Some(77),
        }
    }

    #[test]
    fn the_table_has_a_line_for_everything() {
        let notes = BTreeMap::from([("points", "3 not finite".to_owned())]);
        let table = report().table(&notes);
        for text in [
            "device       host\n",
            "points       4000000 (3 not finite)\n",
            "frame        min 10.00, median 20.00, max 40.00 ms\n",
            "  splat          15.00 ms  75.0 %\n  copy            5.00 ms  25.0 %\n",
            "points/s     200.0 million\n",
            "memory       not known\n",
            "filled       77 pixels\n",
        ] {
            assert!(table.contains(text), "{table}\nexpected {text}");
        }
        let summary = report().summary();
        assert!(
            summary.contains("20 frames of 4000000 points in 6 cameras by cpu on host: 20.00 ms"),
            "{summary}"
        );
    }

    #[test]
    fn json_has_the_names_of_the_command_line() {
        let json = serde_json::to_value(report()).unwrap();
        assert_eq!((&json["rasterizer"], &json["driver"]), (&"cpu".into(), &"plain".into()));
        assert_eq!(json["frame_ms"], serde_json::json!({"min": 10.0, "median": 20.0, "max": 40.0}));
        assert_eq!(
            (&json["out_size"], &json["peak_rss_mb"]),
            (&serde_json::Value::Null, &serde_json::Value::Null)
        );
    }
}
