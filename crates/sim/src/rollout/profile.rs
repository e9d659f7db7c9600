use std::collections::BTreeMap;
use std::time::Duration;

use point_skeleton::error::FileError;
use point_skeleton::files::{FileKind, OutputFile};
use point_skeleton::raster::{RasterizerInfo, StageTimes};
use serde::Serialize;

use super::generator::GenerationTimes;

/// Times of a step, seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct StepTimes {
    /// Policies of ego and actors.
    pub(super) policies_s: f64,
    /// Selecting clouds, submitting points to the rasterizer and rendering layouts.
    pub(super) begin_s: f64,
    /// Waiting until all maps are in memory.
    pub(super) finish_s: f64,
    /// The LiDAR sweep.
    pub(super) lidar_s: f64,
    /// Forecasts with their maps.
    pub(super) forecast_s: f64,
    /// Visible actors, and other data of the step's line.
    pub(super) observe_s: f64,
    /// Generator times, at planning steps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) generated: Option<GenerationTimes>,
    /// Waiting until the writer thread can take this step.
    pub(super) wait_s: f64,
}

impl StepTimes {
    /// Returns the time of policies and conditions, which every closed loop needs.
    pub(super) fn loop_s(&self) -> f64 {
        self.policies_s + self.conditions_s() + self.lidar_s
    }

    pub(super) fn conditions_s(&self) -> f64 {
        self.begin_s + self.finish_s
    }
}

/// Times for writing a step, on a separate thread, seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct WriteTimes {
    /// Maps.
    pub(super) maps_s: f64,
    /// Images of the page.
    pub(super) view_s: f64,
    /// Bird's-eye view.
    pub(super) birdseye_s: f64,
    /// Contact sheet, metadata and states.
    pub(super) rest_s: f64,
}

/// Durations of a rollout.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Profile {
    rasterizer: Option<RasterizerInfo>,
    /// Whole loop from the first step to the last, seconds.
    pub(super) loop_s: f64,
    /// Metrics, index, video and page, seconds.
    pub(super) report_s: f64,
    pub(super) steps: Vec<StepTimes>,
    pub(super) written: Vec<WriteTimes>,
    /// The rasterizer's own stages over all steps, seconds.
    stages_s: BTreeMap<&'static str, f64>,
    /// Medians of all stages, and values derived from them.
    medians: BTreeMap<&'static str, f64>,
}

impl Profile {
    /// Adds the data that is known after the loop.
    pub(super) fn close(&mut self, report: Duration, info: RasterizerInfo, stages: &StageTimes) {
        self.report_s = report.as_secs_f64();
        self.rasterizer = Some(info);
        self.stages_s = stages.0.iter().map(|(name, time)| (*name, time.as_secs_f64())).collect();
        let of = |get: fn(&StepTimes) -> f64| median(self.steps.iter().map(get));
        let written = |get: fn(&WriteTimes) -> f64| median(self.written.iter().map(get));
        let made = |get: fn(&GenerationTimes) -> f64| {
            median(
                self.steps
                    .iter()
                    .filter_map(|step| step.generated)
                    .filter(|t| t.network_s > 0.0)
                    .map(|t| get(&t)),
            )
        };
        self.medians = [
            ("generate_s", made(GenerationTimes::total_s)),
            ("generate_conditions_s", made(|t| t.conditions_s)),
            ("generate_forecasts_s", made(|t| t.forecasts_s)),
            ("generate_truth_s", made(|t| t.truth_s)),
            ("generate_network_s", made(|t| t.network_s)),
            ("generate_decode_s", made(|t| t.decode_s)),
            ("step_s", of(StepTimes::loop_s)),
            ("policies_s", of(|t| t.policies_s)),
            ("conditions_s", of(StepTimes::conditions_s)),
            ("begin_s", of(|t| t.begin_s)),
            ("finish_s", of(|t| t.finish_s)),
            ("lidar_s", of(|t| t.lidar_s)),
            ("forecast_s", of(|t| t.forecast_s)),
            ("observe_s", of(|t| t.observe_s)),
            ("wait_s", of(|t| t.wait_s)),
            ("write_maps_s", written(|t| t.maps_s)),
            ("write_view_s", written(|t| t.view_s)),
            ("write_birdseye_s", written(|t| t.birdseye_s)),
            ("write_rest_s", written(|t| t.rest_s)),
        ]
        .into_iter()
        .filter_map(|(name, value)| Some((name, value?)))
        .collect();
    }

    /// Formats the summary: the median step, its parts, and the rate.
    pub fn summary(&self) -> String {
        if self.steps.is_empty() {
            return "no steps left to simulate".to_owned();
        }
        let ms = |name: &str| 1e3 * self.medians.get(name).copied().unwrap_or(0.0);
        let names = ["write_maps_s", "write_view_s", "write_birdseye_s", "write_rest_s"];
        let writing: f64 = names.iter().map(|name| ms(name)).sum();
        let lidar = format!(", LiDAR {:.1}", ms("lidar_s"));
        let lidar = if ms("lidar_s") >= 0.05 { lidar.as_str() } else { "" };
        let stages: Vec<String> =
            self.stages_s.iter().map(|(name, time)| format!("{name} {time:.2}")).collect();
        format!(
            "{}a step takes {:.1} ms (median; policies {:.1}, drawing {:.1}{lidar}), {:.1} steps a second; \
             writing {writing:.1} ms beside it; drawing in seconds: {}; loop {:.2} s, report {:.2} s",
            self.generating(),
            ms("step_s"),
            ms("policies_s"),
            ms("begin_s") + ms("finish_s"),
            1e3 / ms("step_s").max(1e-6),
            stages.join(", "),
            self.loop_s,
            self.report_s,
        )
    }

    /// Formats the generator times. Ground-truth images are only for comparison, so their time is separate.
    fn generating(&self) -> String {
        let all: Vec<&GenerationTimes> =
            self.steps.iter().filter_map(|step| step.generated.as_ref()).collect();
        let made = all.iter().filter(|times| times.network_s > 0.0).count();
        if all.is_empty() {
            return String::new();
        }
        if made == 0 {
            return "no frames generated: all planning steps are references; ".to_owned();
        }
        let ms = |name: &str| 1e3 * self.medians.get(name).copied().unwrap_or(0.0);
        format!(
            "{made} frames generated, median {:.0} ms ({:.2} a second): network {:.0}, conditions {:.0}, \
                forecasts {:.0}, images \
             {:.1}, ground-truth images {:.0}; ",
            ms("generate_s"),
            1e3 / ms("generate_s").max(1e-6),
            ms("generate_network_s"),
            ms("generate_conditions_s"),
            ms("generate_forecasts_s"),
            ms("generate_decode_s"),
            ms("generate_truth_s"),
        )
    }

    /// Files of profiles.
    pub const KIND: FileKind = FileKind {
        name: "a profile of pskel",
        begin: b"{\n  \"rasterizer\": ",
        marks: &[b"\n  \"loop_s\": "],
    };

    /// Writes all durations as JSON.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn write(&self, file: &OutputFile) -> Result<(), FileError> {
        file.write_json(self)
    }
}

/// Returns the seconds since a moment, and sets the moment to now.
pub fn lap(since: &mut std::time::Instant) -> f64 {
    let now = std::time::Instant::now();
    let time: Duration = now - std::mem::replace(since, now);
    time.as_secs_f64()
}

/// Returns the median; of two middle values the upper one.
fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn computes_medians_and_rate() {
        let step = |ms: f64| StepTimes { policies_s: ms / 1e3, finish_s: 0.02, ..StepTimes::default() };
        let mut profile = Profile { steps: [9.0, 5.0, 700.0].map(step).to_vec(), ..Profile::default() };
        let info = RasterizerInfo { rasterizer: "cpu", device: "d".into(), driver: String::new() };
        profile.close(Duration::ZERO, info.clone(), &StageTimes::default());
        let text = profile.summary();
        assert!(
            text.starts_with("a step takes 29.0 ms (median; policies 9.0, drawing 20.0), 34.5 steps"),
            "{text}"
        );
        profile.steps.iter_mut().for_each(|step| step.lidar_s = 0.041);
        profile.close(Duration::ZERO, info, &StageTimes::default());
        let text = profile.summary();
        assert!(
            text.starts_with(
                "a step takes 70.0 ms (median; policies 9.0, drawing 20.0, LiDAR 41.0), 14.3 steps"
            ),
            "{text}"
        );
        assert_eq!(median(std::iter::empty()), None);
        assert_eq!(Profile::default().summary(), "no steps left to simulate");
        let json = serde_json::to_value(&profile).unwrap();
        assert_eq!(
            (&json["medians"]["policies_s"], json["steps"].as_array().unwrap().len()),
            (&serde_json::json!(0.009), 3)
        );
    }
}
