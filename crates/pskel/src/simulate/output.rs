use std::fs::create_dir_all;
use std::path::Path;
use std::time::Instant;

use point_skeleton::conditions::birdseye::{self, BirdseyeOptions, Trace};
use point_skeleton::conditions::meta::{FrameMeta, PromptParts};
use point_skeleton::conditions::{ConditionError, ConditionOptions, ConditionSet, MapFormat, sheet};
use point_skeleton::error::FileError;
use point_skeleton::files::input::{is_there, read_table};
use point_skeleton::files::{OutputFolder, write_json};
use point_skeleton::scene::{SceneState, SelectionOptions};
use pskel_sim::report::{ROLLOUT, StateFile, StepRow, film, view};
use pskel_sim::{SavedState, SimOptions};
use serde::Serialize;
use serde_json::Value;

use super::files::{FORECAST, INDEX, META, METRICS, PAGE, STATE, STATES, STEPS, VIDEO, step_folder};
use super::generation::Images;
use super::profile::{WriteTimes, lap};
use super::sources::{Places, Sources};
use crate::generator::GeneratorReport;
use crate::stand_ins::StandInReport;

/// Options and inputs of a rollout in `rollout.json` and `index.json`.
#[derive(Clone, Debug, Serialize)]
pub(super) struct RolloutOptions {
    #[serde(flatten)]
    pub(super) conditions: ConditionOptions,
    #[serde(flatten)]
    pub(super) selection: SelectionOptions,
    #[serde(flatten)]
    pub(super) stand_ins: StandInReport,
    pub(super) format: MapFormat,
    /// Number of planning steps to forecast and render at each planning step.
    pub(super) forecast_steps: usize,
    pub(super) sheets: bool,
    pub(super) log: String,
    pub(super) sources: Sources,
    pub(super) simulation: SimOptions,
    /// Simulation steps per second.
    pub(super) sim_hz: f64,
    /// Planning steps per second.
    pub(super) plan_hz: f64,
    /// Last step of the warm-up.
    pub(super) takeover_step: usize,
    /// Generator of images, if any.
    pub(super) generator: Option<GeneratorReport>,
}

/// A step with all data to write.
pub(super) struct Job {
    pub(super) state: SceneState,
    pub(super) set: ConditionSet,
    pub(super) row: StepRow,
    pub(super) saved: SavedState,
    pub(super) traces: Vec<Trace>,
    pub(super) forecast: Vec<(SceneState, ConditionSet)>,
    pub(super) images: Option<Images>,
}

/// Output folder of a rollout.
pub(super) struct Output<'a> {
    pub(super) folder: &'a Path,
    pub(super) options: &'a RolloutOptions,
    pub(super) prompt: &'a PromptParts,
}

/// State of an earlier run.
pub(super) struct Earlier {
    pub(super) rows: Vec<StepRow>,
    pub(super) saved: SavedState,
}

/// A rollout to resume.
pub(super) struct Resumed<'a> {
    pub(super) folder: &'a Path,
    /// Step to resume after; `None` for the last one.
    pub(super) until: Option<usize>,
    /// Total number of steps.
    pub(super) steps: usize,
    pub(super) sources: &'a Sources,
    pub(super) places: Places<'a>,
}

impl Resumed<'_> {
    /// Reads its rows and its saved state; `None` if it has no step yet and `until` is not set.
    pub(super) fn read(&self) -> Result<Option<Earlier>, FileError> {
        let marker = self.folder.join(ROLLOUT);
        let path = self.folder.join(STATES);
        let mut rows = if is_there(&path)? { StateFile::read(&path)? } else { Vec::new() };
        let Some(last) = rows.len().checked_sub(1) else {
            return match self.until {
                None => Ok(None),
                Some(step) => {
                    Err(FileError::content(format!("a rollout with step {step}"), "no step", self.folder))
                }
            };
        };
        let before = read_marker(&marker)?;
        self.sources.check(&before["sources"], &marker, &self.places)?;
        let step = self.until.unwrap_or(last);
        if step > last {
            let (expected, found) = (format!("a step from 0 to {last} to go on behind"), step.to_string());
            return Err(FileError::content(expected, found, &path));
        }
        if step > self.steps {
            let expected = format!("--steps of {step} or more to go on behind step {step}");
            return Err(FileError::content(expected, self.steps.to_string(), &path));
        }
        rows.truncate(step + 1);
        let path = step_folder(self.folder, &rows[step].name()).join(STATE);
        let text = read_table(&path)?;
        let saved = serde_json::from_slice(&text)
            .map_err(|error| FileError::content("a saved state", error.to_string(), &path))?;
        Ok(Some(Earlier { rows, saved }))
    }
}

fn read_marker(marker: &Path) -> Result<Value, FileError> {
    let text = read_table(marker)?;
    serde_json::from_slice(&text).map_err(|error| FileError::content("a rollout", error.to_string(), marker))
}

impl Output<'_> {
    /// Prepares the folder: removes an earlier rollout, or its steps after the retained ones.
    pub(super) fn begin(&self, files: &OutputFolder, kept: &[StepRow]) -> Result<StateFile, FileError> {
        let marker = self.folder.join(ROLLOUT);
        if !kept.is_empty() {
            self.check_same(&marker)?;
        }
        files.check([ROLLOUT, STATES, STEPS])?;
        // The index goes first: a folder with an index is complete.
        files.remove([INDEX, PAGE, VIDEO, METRICS])?;
        if kept.is_empty() {
            files.remove([STATES, STEPS])?;
        }
        write_json(&files.claim(ROLLOUT)?, self.options)?;
        let states = StateFile::create(&files.claim(STATES)?, kept)?;
        let steps = self.folder.join(STEPS);
        if !steps.is_dir() {
            return Ok(states);
        }
        for entry in std::fs::read_dir(&steps).map_err(FileError::io("read", &steps))? {
            let name = entry.map_err(FileError::io("read", &steps))?.file_name();
            if !kept.iter().any(|row| *row.name() == *name) {
                files.remove([Path::new(STEPS).join(name)])?;
            }
        }
        Ok(states)
    }

    /// Checks that a resumed rollout has the same options, except for the number of steps.
    fn check_same(&self, marker: &Path) -> Result<(), FileError> {
        let before = read_marker(marker)?;
        let parsed = |error: serde_json::Error| FileError::content("a rollout", error.to_string(), marker);
        let text = serde_json::to_vec(self.options).map_err(parsed)?;
        let now: Value = serde_json::from_slice(&text).map_err(parsed)?;
        let same = |name: &str| match (before.get(name), now.get(name)) {
            (Some(a), Some(b)) if name == "simulation" => without_steps(a) == without_steps(b),
            (a, b) => a == b,
        };
        let names = |value: &Value| value.as_object().map(|o| o.keys().cloned().collect::<Vec<_>>());
        let all = names(&before).into_iter().chain(names(&now)).flatten();
        match all.into_iter().find(|name| !same(name)) {
            None => Ok(()),
            Some(name) => {
                let text = |value: &Value| value.get(&name).map_or("none".to_owned(), Value::to_string);
                let expected = format!("the options of the rollout, {name} {}", text(&before));
                Err(FileError::content(expected, text(&now), marker))
            }
        }
    }

    /// Writes the folder of a step, then its line.
    pub(super) fn write(
        &self,
        job: &Job,
        files: &OutputFolder,
        states: &mut StateFile,
    ) -> Result<WriteTimes, ConditionError> {
        let (state, set, options) = (&job.state, &job.set, &self.options.conditions);
        let bins = &options.depth_bins;
        let (mut times, mut clock) = (WriteTimes::default(), Instant::now());
        files.write_folder(Path::new(STEPS).join(&state.name), |folder| {
            self.options.format.write(folder, set, state.t_us, options)?;
            for (state, set) in &job.forecast {
                self.write_forecast(&folder.join(FORECAST).join(&state.name), state, set)?;
            }
            times.maps_s = lap(&mut clock);
            view::write(&folder.join(view::VIEW), set, bins)?;
            if let Some(images) = &job.images {
                images.write(folder, &view::Layout::of(set))?;
            }
            times.view_s = lap(&mut clock);
            let above = folder.join(film::BIRDSEYE);
            birdseye::write_with(&above, state, &job.traces, &BirdseyeOptions::default())?;
            times.birdseye_s = lap(&mut clock);
            if self.options.sheets {
                let caption = format!("{}  {}", self.options.log, state.name);
                sheet::write(&folder.join("sheet.png"), set, bins, &caption)?;
            }
            write_json(&folder.join(STATE), &job.saved)?;
            self.write_meta(folder, state)
        })?;
        states.append(&job.row)?;
        times.rest_s = lap(&mut clock);
        Ok(times)
    }

    fn write_forecast(
        &self,
        folder: &Path,
        state: &SceneState,
        set: &ConditionSet,
    ) -> Result<(), ConditionError> {
        create_dir_all(folder).map_err(FileError::io("create", folder))?;
        self.options.format.write(folder, set, state.t_us, &self.options.conditions)?;
        self.write_meta(folder, state)
    }

    fn write_meta(&self, folder: &Path, state: &SceneState) -> Result<(), ConditionError> {
        let meta = FrameMeta::new(state, &self.options.conditions, self.prompt, Some(self.options.sim_hz));
        Ok(meta.write(&folder.join(META))?)
    }
}

fn without_steps(options: &Value) -> Value {
    let mut options = options.clone();
    if let Some(fields) = options.as_object_mut() {
        fields.remove("steps");
    }
    options
}
