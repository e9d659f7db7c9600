//! An unfinished build on disk: enough to go on after the process was killed.

use std::collections::BTreeMap;
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::cells::Cell;
use super::runs::{self, RunName};
use super::sums::VoxelSum;
use crate::error::{FileError, write_json};
use crate::files::input::read_table;
use crate::skeleton::{BuildOptions, BuildReport};

/// What is built: a checkpoint of another plan is of no use.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Plan {
    /// Of this program.
    pub(super) version: String,
    pub(super) options: BuildOptions,
    pub(super) logs: Vec<PlannedLog>,
}

/// A log of a [`Plan`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct PlannedLog {
    pub(super) log: String,
    /// What the data set says of it: a made log tells how it was made.
    pub(super) description: String,
    /// Times of the frames, absolute microseconds.
    pub(super) t_us: Vec<i64>,
    /// Sweeps, images and boxes of the frames: files may have come or gone.
    pub(super) held: Vec<[usize; 3]>,
    /// Tracks in the log.
    pub(super) tracks: usize,
}

/// How far a build is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Done {
    /// Frames whose points are in the runs, counted through all logs.
    pub(super) frames: usize,
    /// Sweeps whose points are in the runs.
    pub(super) sweeps: u64,
    pub(super) runs: Vec<RunName>,
    pub(super) report: BuildReport,
    /// Sweeps that gave points to each track.
    #[serde(with = "as_list")]
    pub(super) track_sweeps: BTreeMap<Cell, usize>,
}

#[derive(Serialize, Deserialize)]
struct Checkpoint<P, D> {
    plan: P,
    done: D,
}

const FILE: &str = "checkpoint.json";
const LOCK: &str = "lock";

/// The folder of an unfinished build. It goes when this is dropped, unless it holds a checkpoint.
pub(super) struct WorkFolder {
    path: PathBuf,
    plan: Plan,
    /// Held as long as this process is at work in the folder.
    _lock: Lock,
    kept: bool,
}

/// Held until dropped, also where a process that is being started still has a copy of the file.
struct Lock(File);

impl Drop for Lock {
    fn drop(&mut self) {
        // Closing the file does the same, if later.
        let _ = self.0.unlock();
    }
}

impl WorkFolder {
    /// Where the unfinished build of `out` lies.
    pub(super) fn beside(out: &Path) -> PathBuf {
        let name = out.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        out.with_file_name(format!("{name}.partial"))
    }

    /// How many frames of an unfinished build of `out` are done, if there is one with a checkpoint.
    pub(super) fn frames_done(out: &Path) -> Option<usize> {
        let text = read_table(&Self::beside(out).join(FILE)).ok()?;
        serde_json::from_slice::<Checkpoint<serde_json::Value, Done>>(&text).ok().map(|c| c.done.frames)
    }

    /// Opens the folder for `out`, with what was done there if that is to be gone on with; else an empty one.
    ///
    /// # Errors
    /// Another process is at work there; `resume` finds a build of something else; the system's.
    pub(super) fn open(out: &Path, plan: Plan, resume: bool) -> Result<(Self, Done), FileError> {
        let path = Self::beside(out);
        let lock_path = path.join(LOCK);
        if path.exists() && !lock_path.is_file() {
            let expected = "an unfinished build, or no such folder";
            return Err(FileError::content(expected, "other content", &path));
        }
        std::fs::create_dir_all(&path).map_err(FileError::io("create", &path))?;
        let lock = File::create(&lock_path).map_err(FileError::io("create", &lock_path))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::Error(error)) => return Err(FileError::io("lock", &lock_path)(error)),
            Err(TryLockError::WouldBlock) => {
                let expected = "no other process at work on this skeleton";
                return Err(FileError::content(expected, "one that holds the lock", &lock_path));
            }
        }
        let mut folder = Self { path, plan, _lock: Lock(lock), kept: true };
        // A build that was killed before its first checkpoint left none.
        let done =
            if resume && folder.path.join(FILE).is_file() { folder.read()? } else { folder.clear()? };
        runs::sweep_out(&folder.path, &done.runs)?;
        Ok((folder, done))
    }

    fn read(&self) -> Result<Done, FileError> {
        let path = self.path.join(FILE);
        let text = read_table(&path)?;
        let wrong = |e: serde_json::Error| FileError::content("a checkpoint", e.to_string(), &path);
        let checkpoint: Checkpoint<Plan, Done> = serde_json::from_slice(&text).map_err(wrong)?;
        let frames: usize = self.plan.logs.iter().map(|log| log.t_us.len()).sum();
        if checkpoint.done.frames > frames && checkpoint.plan == self.plan {
            let found = format!("{} done", checkpoint.done.frames);
            return Err(FileError::content(format!("at most {frames} frames"), found, &path));
        }
        if checkpoint.plan != self.plan {
            let expected = "an unfinished build of the same version, logs, frames and options";
            let found = difference(&self.plan, &checkpoint.plan);
            return Err(FileError::content(expected, found, &path));
        }
        Ok(checkpoint.done)
    }

    fn clear(&mut self) -> Result<Done, FileError> {
        let path = self.path.join(FILE);
        if path.exists() {
            std::fs::remove_file(&path).map_err(FileError::io("delete", &path))?;
        }
        self.kept = false;
        Ok(Done::default())
    }

    /// Where runs are.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Whether there is something to go on with.
    pub(super) fn is_kept(&self) -> bool {
        self.kept
    }

    /// Writes points and, behind them, how far the build is: a kill at any moment leaves this checkpoint or the one
    /// before.
    pub(super) fn save(
        &mut self,
        done: &mut Done,
        cells: Vec<(Cell, Vec<VoxelSum>)>,
    ) -> Result<(), FileError> {
        done.runs = runs::push(&self.path, std::mem::take(&mut done.runs), cells)?;
        write_json(&self.path.join(FILE), &Checkpoint { plan: &self.plan, done: &*done })?;
        self.kept = true;
        runs::sweep_out(&self.path, &done.runs)
    }

    /// The skeleton is written: nothing is to be kept. The checkpoint goes first, since without its runs it is none.
    pub(super) fn close(mut self) -> Result<(), FileError> {
        let path = self.path.join(FILE);
        std::fs::remove_file(&path).map_err(FileError::io("delete", &path))?;
        self.kept = true;
        std::fs::remove_dir_all(&self.path).map_err(FileError::io("delete", &self.path))
    }
}

impl Drop for WorkFolder {
    fn drop(&mut self) {
        if !self.kept {
            // What fails here left nothing but an empty folder or a full disk, of which the error tells.
            let _ = std::fs::remove_dir_all(&self.path);
        }
    }
}

/// What makes a plan another one.
fn difference(ours: &Plan, theirs: &Plan) -> String {
    if ours.version != theirs.version {
        return format!("one of version {}", theirs.version);
    }
    if ours.options != theirs.options {
        return "one with other options".to_owned();
    }
    let names = |plan: &Plan| plan.logs.iter().map(|log| log.log.clone()).collect::<Vec<_>>();
    if names(ours) != names(theirs) {
        return format!("one of {}", names(theirs).join(", "));
    }
    "one of other frames, files or tracks".to_owned()
}

/// JSON has no maps with such keys.
mod as_list {
    use std::collections::BTreeMap;

    use serde::{Deserialize, Deserializer, Serializer};

    use super::Cell;

    pub(super) fn serialize<S: Serializer>(map: &BTreeMap<Cell, usize>, out: S) -> Result<S::Ok, S::Error> {
        out.collect_seq(map)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<BTreeMap<Cell, usize>, D::Error> {
        Ok(Vec::<(Cell, usize)>::deserialize(from)?.into_iter().collect())
    }
}
