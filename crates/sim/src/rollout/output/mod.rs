pub(super) mod files;
#[cfg(feature = "mcap")]
pub(super) mod mcap;
#[cfg(feature = "video")]
pub(super) mod video;

use std::fs::create_dir_all;
use std::path::Path;
use std::time::Instant;

use point_skeleton::conditions::birdseye::{self, BirdseyeOptions, Trace};
use point_skeleton::conditions::view::sheet;
use point_skeleton::conditions::write::meta::{FrameMeta, PromptParts};
use point_skeleton::conditions::{ConditionError, ConditionSet};
use point_skeleton::error::FileError;
use point_skeleton::files::{OutputFolder, write_json};
use point_skeleton::lidar::LidarSweep;
use point_skeleton::scene::SceneState;
use serde_json::Value;

use self::files::{FORECAST, INDEX, META, METRICS, PAGE, ROLLOUT, SHEET, STATE, STATES, STEPS, VIDEO};
use super::earlier::read_record;
use super::generation::Images;
use super::options::RolloutRecord;
use super::profile::{WriteTimes, lap};
use crate::SavedState;
use crate::report::{BIRDSEYE, StateFile, StepRow, view};

/// A step with all data to write.
pub(super) struct Job {
    pub(super) state: SceneState,
    pub(super) set: ConditionSet,
    pub(super) sweep: Option<LidarSweep>,
    pub(super) row: StepRow,
    pub(super) saved: SavedState,
    pub(super) traces: Vec<Trace>,
    pub(super) forecast: Vec<(SceneState, ConditionSet)>,
    pub(super) images: Option<Images>,
}

/// Output folder of a rollout.
pub(super) struct Output<'a> {
    pub(super) folder: &'a Path,
    pub(super) record: &'a RolloutRecord,
    pub(super) prompt: &'a PromptParts,
}

impl Output<'_> {
    /// Prepares the folder: removes an earlier rollout, or its steps after the retained ones.
    pub(super) fn begin(&self, files: &OutputFolder, retained: &[StepRow]) -> Result<StateFile, FileError> {
        let marker = self.folder.join(ROLLOUT);
        if !retained.is_empty() {
            self.check_same(&marker)?;
        }
        files.check([ROLLOUT, STATES, STEPS])?;
        // The index goes first: a folder with an index is complete.
        files.remove([INDEX, PAGE, VIDEO, METRICS])?;
        if retained.is_empty() {
            files.remove([STATES, STEPS])?;
        }
        write_json(&files.claim(ROLLOUT)?, self.record)?;
        let states = StateFile::create(&files.claim(STATES)?, retained)?;
        let steps = self.folder.join(STEPS);
        if !steps.is_dir() {
            return Ok(states);
        }
        for entry in std::fs::read_dir(&steps).map_err(FileError::io("read", &steps))? {
            let name = entry.map_err(FileError::io("read", &steps))?.file_name();
            if !retained.iter().any(|row| *row.name() == *name) {
                files.remove([Path::new(STEPS).join(name)])?;
            }
        }
        Ok(states)
    }

    /// Checks that a resumed rollout has the same options, except for the number of steps.
    fn check_same(&self, marker: &Path) -> Result<(), FileError> {
        let before = read_record(marker)?;
        let parsed = |error: serde_json::Error| FileError::content("a rollout", error.to_string(), marker);
        let text = serde_json::to_vec(self.record).map_err(parsed)?;
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
        let (state, set, options) = (&job.state, &job.set, &self.record.conditions);
        let bins = &options.depth_bins;
        let (mut times, mut clock) = (WriteTimes::default(), Instant::now());
        files.write_folder(Path::new(STEPS).join(&state.name), |folder| {
            self.record.format.write(folder, set, state.t_us, options)?;
            for (state, set) in &job.forecast {
                self.write_forecast(&folder.join(FORECAST).join(&state.name), state, set)?;
            }
            if let (Some(sweep), Some(lidar)) = (&job.sweep, &self.record.lidar) {
                sweep.write(folder, lidar.format)?;
            }
            times.maps_s = lap(&mut clock);
            view::write(&folder.join(view::VIEW), set, bins)?;
            if let Some(images) = &job.images {
                images.write(folder, &view::Layout::of(set))?;
            }
            times.view_s = lap(&mut clock);
            let above = folder.join(BIRDSEYE);
            birdseye::write_with(&above, state, &job.traces, &BirdseyeOptions::default())?;
            times.birdseye_s = lap(&mut clock);
            if self.record.sheets {
                let caption = format!("{}  {}", self.record.log, state.name);
                sheet::write(&folder.join(SHEET), set, bins, &caption)?;
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
        self.record.format.write(folder, set, state.t_us, &self.record.conditions)?;
        self.write_meta(folder, state)
    }

    fn write_meta(&self, folder: &Path, state: &SceneState) -> Result<(), ConditionError> {
        let meta = FrameMeta::new(state, &self.record.conditions, self.prompt, Some(self.record.sim_hz));
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
