use std::path::{Path, PathBuf};

use point_skeleton::error::FileError;
use point_skeleton::files::input::is_there;
use point_skeleton::files::json;
use serde_json::Value;

use super::options::{InputPaths, ResumeAfter};
use super::output::files::{ROLLOUT, STATE, STATES, shown_files, step_folder};
use super::sources::Sources;
use crate::SavedState;
use crate::history::HISTORY_US;
use crate::report::{StateFile, StepRow};

/// State of an earlier run.
pub(super) struct Earlier {
    pub(super) rows: Vec<StepRow>,
    pub(super) saved: SavedState,
}

/// A rollout to resume.
pub(super) struct EarlierRollout<'a> {
    pub(super) folder: &'a Path,
    /// Total number of steps.
    pub(super) steps: usize,
    pub(super) sources: &'a Sources,
    pub(super) paths: InputPaths<'a>,
}

impl Earlier {
    /// Reads the states before the last one that are history for a planner, oldest first, with their files.
    pub(super) fn history(&self, folder: &Path) -> Result<Vec<(SavedState, Vec<PathBuf>)>, FileError> {
        let Some((last, before)) = self.rows.split_last() else { return Ok(Vec::new()) };
        let is_recent = |row: &&StepRow| last.t_us - row.t_us <= HISTORY_US;
        let read = |row: &StepRow| {
            let step = step_folder(folder, &row.name());
            Ok((SavedState::read(&step.join(STATE))?, shown_files(&step)?))
        };
        before.iter().filter(is_recent).map(read).collect()
    }
}

impl EarlierRollout<'_> {
    /// Reads its rows and its saved state; `None` if it has no step yet and none is required.
    pub(super) fn read(&self, after: ResumeAfter) -> Result<Option<Earlier>, FileError> {
        let path = self.folder.join(STATES);
        let mut rows = if is_there(&path)? { StateFile::read(&path)? } else { Vec::new() };
        let Some(last) = rows.len().checked_sub(1) else {
            return match after {
                ResumeAfter::Last => Ok(None),
                ResumeAfter::Step(step) => {
                    Err(FileError::content(format!("a rollout with step {step}"), "no step", self.folder))
                }
            };
        };
        let marker = self.folder.join(ROLLOUT);
        let before = read_record(&marker)?;
        self.sources.check(&before["sources"], &marker, &self.paths)?;
        let step = match after {
            ResumeAfter::Last => last,
            ResumeAfter::Step(step) => step,
        };
        if step > last {
            let expected = format!("a step from 0 to {last} to resume after");
            return Err(FileError::content(expected, step.to_string(), &path));
        }
        if step > self.steps {
            let expected = format!("{step} steps or more to resume after step {step}");
            return Err(FileError::content(expected, self.steps.to_string(), &path));
        }
        rows.truncate(step + 1);
        let mut folders = rows.iter().map(|row| step_folder(self.folder, &row.name()));
        if let Some(gone) = folders.find(|step| !step.is_dir()) {
            let expected = "the folder of a step to resume after, or a rollout without --resume";
            return Err(FileError::content(expected, "none", &gone));
        }
        let saved = SavedState::read(&step_folder(self.folder, &rows[step].name()).join(STATE))?;
        Ok(Some(Earlier { rows, saved }))
    }
}

/// Reads `rollout.json`.
pub(super) fn read_record(marker: &Path) -> Result<Value, FileError> {
    json::read(marker, "a rollout")
}
