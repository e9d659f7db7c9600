//! Unfinished build on disk, resumable after the process was killed.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::cells::Cell;
use super::runs::{self, RunName};
use super::sums::VoxelSum;
use crate::error::FileError;
use crate::files::input::read_table;
use crate::files::json;
use crate::files::{WorkFolder, work_of_whole, write_json};
use crate::skeleton::{BuildOptions, BuildReport};

/// Inputs of a build; a checkpoint is only valid for an equal plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Plan {
    /// Version of this program.
    pub(super) version: String,
    /// Version of the skeleton's format, on which the order of sums depends; 0 in builds of earlier versions.
    #[serde(default)]
    pub(super) format: u32,
    pub(super) options: BuildOptions,
    pub(super) logs: Vec<PlannedLog>,
}

/// Log of a [`Plan`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct PlannedLog {
    pub(super) log: String,
    /// Fingerprint of the recording; empty in builds of earlier versions.
    #[serde(default)]
    pub(super) recording: String,
    /// Times of the frames, absolute microseconds.
    pub(super) t_us: Vec<i64>,
    /// Options of reading other than the default.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) reading: Vec<String>,
}

/// Progress of a build.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct BuildState {
    /// Number of frames whose points are in the runs, over all logs.
    pub(super) frames: usize,
    /// Number of sweeps whose points are in the runs.
    pub(super) sweeps: u64,
    pub(super) runs: Vec<RunName>,
    pub(super) report: BuildReport,
    /// Number of sweeps that contributed points to each track.
    #[serde(with = "as_list")]
    pub(super) track_sweeps: BTreeMap<Cell, usize>,
}

#[derive(Serialize, Deserialize)]
struct Checkpoint<P, D> {
    plan: P,
    done: D,
}

const FILE: &str = "checkpoint.json";

/// Folder of an unfinished build, retained on drop once it holds a checkpoint.
pub(super) struct Unfinished {
    work: WorkFolder,
    plan: Plan,
}

impl Unfinished {
    /// Returns the number of completed frames in an unfinished build of `out`; `None` without a checkpoint.
    pub(super) fn frames_done(out: &Path) -> Option<usize> {
        let text = read_table(&work_of_whole(out).join(FILE)).ok()?;
        serde_json::from_slice::<Checkpoint<serde_json::Value, BuildState>>(&text).ok().map(|c| c.done.frames)
    }

    /// Removes the folder of a build that was killed after it had written the skeleton, if it cannot be
    /// resumed.
    pub(super) fn remove_leftovers(out: &Path) {
        let path = work_of_whole(out);
        if path.is_dir() && !path.join(FILE).exists() {
            // It stays if another process uses it.
            drop(WorkFolder::open(path, out));
        }
    }

    /// Opens the folder for `out`: with the state of its checkpoint if `resume` is set, otherwise emptied.
    ///
    /// # Errors
    /// Fails if another process uses the folder, if `resume` finds a build with another plan, or if a file
    /// cannot be read or written.
    pub(super) fn open(out: &Path, plan: Plan, resume: bool) -> Result<(Self, BuildState), FileError> {
        let mut work = WorkFolder::open(work_of_whole(out), out)?;
        let has_checkpoint = work.path().join(FILE).is_file();
        work.keep(has_checkpoint);
        let mut folder = Self { work, plan };
        // A build that was killed before its first checkpoint has none.
        let done = if resume && has_checkpoint { folder.read()? } else { folder.clear()? };
        folder.sweep_out(&done.runs)?;
        Ok((folder, done))
    }

    fn read(&self) -> Result<BuildState, FileError> {
        let path = self.path().join(FILE);
        let checkpoint: Checkpoint<Plan, BuildState> = json::read(&path, "a checkpoint")?;
        if checkpoint.plan != self.plan {
            let expected = "an unfinished build of the same version, logs, frames and options";
            let found = difference(&self.plan, &checkpoint.plan);
            return Err(FileError::content(expected, found, &path));
        }
        let frames: usize = self.plan.logs.iter().map(|log| log.t_us.len()).sum();
        if checkpoint.done.frames > frames {
            let found = format!("{} done", checkpoint.done.frames);
            return Err(FileError::content(format!("at most {frames} frames"), found, &path));
        }
        Ok(checkpoint.done)
    }

    /// Empties the folder. Deletes the checkpoint first, since it is invalid without its runs.
    fn clear(&mut self) -> Result<BuildState, FileError> {
        let path = self.path().join(FILE);
        if path.exists() {
            std::fs::remove_file(&path).map_err(FileError::io("delete", &path))?;
        }
        self.work.keep(false);
        self.work.clear(|_| false)?;
        Ok(BuildState::default())
    }

    /// Returns the folder of the runs.
    pub(super) fn path(&self) -> &Path {
        self.work.path()
    }

    /// Returns the work folder, for the skeleton's temporary files.
    pub(super) fn work(&self) -> &WorkFolder {
        &self.work
    }

    /// Returns whether there is a checkpoint to resume from.
    pub(super) fn is_retained(&self) -> bool {
        self.work.is_retained()
    }

    /// Writes the points, then the checkpoint. A kill at any moment leaves either the new or the previous
    /// checkpoint.
    pub(super) fn save(
        &mut self,
        done: &mut BuildState,
        cells: Vec<(Cell, Vec<VoxelSum>)>,
    ) -> Result<(), FileError> {
        done.runs = runs::push(self.path(), std::mem::take(&mut done.runs), cells)?;
        write_json(&self.path().join(FILE), &Checkpoint { plan: &self.plan, done: &*done })?;
        self.work.keep(true);
        self.sweep_out(&done.runs)
    }

    /// Deletes runs that are not in the list, and leftovers of a killed process.
    fn sweep_out(&self, runs: &[RunName]) -> Result<(), FileError> {
        let files = |run: &RunName| [run.sums(Path::new("")), run.index(Path::new(""))];
        let retained: BTreeSet<PathBuf> = runs.iter().flat_map(files).collect();
        self.work.clear(|name| name == FILE || retained.contains(Path::new(name)))
    }

    /// Removes the folder after the skeleton was written.
    pub(super) fn close(mut self) -> Result<(), FileError> {
        self.clear().map(drop)
    }
}

/// Describes the difference between two plans.
fn difference(ours: &Plan, theirs: &Plan) -> String {
    if ours.version != theirs.version {
        return format!("one of version {}", theirs.version);
    }
    if ours.format != theirs.format {
        return "one by an earlier version; build without --resume".to_owned();
    }
    if ours.options != theirs.options {
        return "one with other options".to_owned();
    }
    let names = |plan: &Plan| plan.logs.iter().map(|log| log.log.clone()).collect::<Vec<_>>();
    if names(ours) != names(theirs) {
        return format!("one of {}", names(theirs).join(", "));
    }
    let differs = |(ours, theirs): &(&PlannedLog, &PlannedLog)| ours.recording != theirs.recording;
    match ours.logs.iter().zip(&theirs.logs).find(differs) {
        Some((_, log)) => format!("one of another recording or state of {}; build without --resume", log.log),
        None => "one of other frames or options of reading".to_owned(),
    }
}

/// Serializes a map as a list, since JSON map keys must be strings.
mod as_list {
    use std::collections::BTreeMap;

    use serde::{Deserialize, Deserializer, Serializer};

    use crate::skeleton::ingest::cells::Cell;

    pub(super) fn serialize<S: Serializer>(map: &BTreeMap<Cell, usize>, out: S) -> Result<S::Ok, S::Error> {
        out.collect_seq(map)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<BTreeMap<Cell, usize>, D::Error> {
        Ok(Vec::<(Cell, usize)>::deserialize(from)?.into_iter().collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unlisted_runs_are_deleted() {
        let folder = tempfile::tempdir().unwrap();
        let plan =
            Plan { version: "1".to_owned(), format: 0, options: BuildOptions::default(), logs: Vec::new() };
        let (mut unfinished, mut done) = Unfinished::open(&folder.path().join("sk"), plan, false).unwrap();
        let path = unfinished.path().to_owned();
        std::fs::create_dir(path.join("new")).unwrap();
        for name in ["run-000009.sums", ".run-000000.sums.pskel-part", "new/skeleton.json"] {
            std::fs::write(path.join(name), "half").unwrap();
        }
        unfinished.save(&mut done, vec![(Cell::Chunk([0; 3]), Vec::new())]).unwrap();
        let names = std::fs::read_dir(&path).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
        let expected = ["checkpoint.json", "lock", "run-000000.json", "run-000000.sums"];
        assert_eq!(names.collect::<BTreeSet<_>>(), expected.map(str::to_owned).into());
        drop(unfinished);
        assert!(path.is_dir(), "a build with a checkpoint stays");
        Unfinished::remove_leftovers(&folder.path().join("sk"));
        assert!(path.is_dir(), "a build with a checkpoint stays");
        std::fs::remove_file(path.join(FILE)).unwrap();
        Unfinished::remove_leftovers(&folder.path().join("sk"));
        assert!(!path.exists(), "without one, nothing can be resumed");
    }
}
