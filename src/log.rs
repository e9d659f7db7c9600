use std::path::Path;
use std::sync::{Arc, OnceLock};

use crate::Error;
use crate::dataset::{
    self, ActorEdits, ChangedLog, DatasetError, EditError, EgoTrack, LogLocator, LogReader, MissingData,
    Recording,
};
use crate::scene::{EgoOffset, SceneMap, SceneState, state_at, state_of_frame};
use crate::skeleton::{self, BuildInput, BuildOptions, BuildRun, Skeleton};

/// A recorded drive: sensors, calibration, ego poses, tracked boxes and HD map.
pub struct Log {
    /// As opened, without edits.
    source: Arc<dyn LogReader>,
    reader: Arc<dyn LogReader>,
    ego: EgoTrack,
    map: Arc<OnceLock<ReadMap>>,
}

/// HD map, or the error of reading it.
type ReadMap = Result<Option<Arc<SceneMap>>, DatasetError>;

impl Log {
    /// Opens a log by name: `FORMAT:PATH[@VERSION][#SCENE]`, such as
    /// `nuscenes:/data/nuscenes@v1.0-mini#scene-0061`. Reads tables, no sweeps and images. The HD map is read
    /// when it is needed.
    ///
    /// # Errors
    /// Fails if the name is invalid or if a table is missing or damaged.
    pub fn open(name: &str) -> Result<Self, Error> {
        let locator: LogLocator = name.parse()?;
        Ok(Self::new(dataset::open(&locator)?))
    }

    /// Creates a log from a reader of any format.
    pub fn new(reader: Box<dyn LogReader>) -> Self {
        let ego = EgoTrack::new(reader.recording());
        let source: Arc<dyn LogReader> = Arc::from(reader);
        Self { reader: Arc::clone(&source), source, ego, map: Arc::default() }
    }

    /// Returns the log with other edits of its actors than it has: `edits` begin with the log as it was
    /// opened.
    ///
    /// # Errors
    /// Fails if the log does not have a track at its time.
    pub fn edited(&self, edits: &ActorEdits) -> Result<Self, EditError> {
        let source = Arc::clone(&self.source);
        let reader = match edits.is_empty() {
            true => Arc::clone(&source),
            false => Arc::new(ChangedLog::with_edits(Arc::clone(&source), edits)?),
        };
        Ok(Self { source, reader, ego: self.ego.clone(), map: Arc::clone(&self.map) })
    }

    /// Returns the name, which identifies the log in skeletons.
    pub fn name(&self) -> &str {
        &self.recording().name
    }

    /// Returns poses, calibration, boxes and file paths.
    pub fn recording(&self) -> &Recording {
        self.reader.recording()
    }

    /// Returns the same without edits, from which skeletons are built.
    pub fn unedited(&self) -> &Recording {
        self.source.recording()
    }

    /// Returns the reader of the log without edits.
    pub fn unedited_reader(&self) -> &dyn LogReader {
        self.source.as_ref()
    }

    /// Returns the frames (the states at key frames), in time order.
    pub fn frames(&self) -> impl Iterator<Item = SceneState> {
        (0..self.recording().frames.len()).filter_map(|i| self.frame(i))
    }

    /// Returns the state at a key frame; `None` beyond the last.
    pub fn frame(&self, index: usize) -> Option<SceneState> {
        self.frame_moved(index, EgoOffset::default())
    }

    /// Returns the state at a key frame with a moved ego; `None` beyond the last.
    pub fn frame_moved(&self, index: usize, offset: EgoOffset) -> Option<SceneState> {
        let state = state_of_frame(self.recording(), index, offset);
        state.map(|state| self.with_map(state))
    }

    /// Returns the state at a time, with interpolated ego and actors; `None` outside the log. Microseconds.
    pub fn state_at(&self, t_us: i64) -> Option<SceneState> {
        let state = state_at(self.recording(), &self.ego, t_us, EgoOffset::default());
        state.map(|state| self.with_map(state))
    }

    /// Returns the HD map; `None` if the log has none, or if it cannot be read ([`Log::map_error`]).
    pub fn map(&self) -> Option<Arc<SceneMap>> {
        self.read_map().as_ref().ok().cloned().flatten()
    }

    /// Returns the HD map; `None` if the log has none.
    ///
    /// # Errors
    /// Fails if the map cannot be read.
    pub fn require_map(&self) -> Result<Option<Arc<SceneMap>>, DatasetError> {
        match self.read_map() {
            Ok(map) => Ok(map.clone()),
            // Errors cannot be copied, and this one ends the work.
            Err(_) => SceneMap::read(self.reader()),
        }
    }

    /// Returns the HD map if a command can do without one that cannot be read: with [`MissingData::Skip`].
    ///
    /// # Errors
    /// Fails with [`MissingData::Error`] if the map cannot be read.
    pub fn optional_map(&self) -> Result<Option<Arc<SceneMap>>, DatasetError> {
        match self.recording().reading.missing {
            MissingData::Skip => Ok(self.map()),
            MissingData::Error => self.require_map(),
        }
    }

    /// Returns why the HD map cannot be read; `None` if it can, or if the log has none.
    pub fn map_error(&self) -> Option<&DatasetError> {
        self.read_map().as_ref().err()
    }

    /// Returns the reader, for sweeps and images.
    pub fn reader(&self) -> &dyn LogReader {
        self.reader.as_ref()
    }

    /// Returns the reader.
    pub fn into_reader(self) -> Arc<dyn LogReader> {
        self.reader
    }

    fn read_map(&self) -> &ReadMap {
        self.map.get_or_init(|| SceneMap::read(self.reader()))
    }

    fn with_map(&self, state: SceneState) -> SceneState {
        SceneState { map: self.map(), ..state }
    }
}

impl Skeleton {
    /// Builds a skeleton from all frames of a log without its edits, and writes it to a folder. An existing
    /// skeleton is replaced. For several logs, templates, progress and resumption see [`skeleton::build`].
    ///
    /// # Errors
    /// Fails if a file of the log is damaged and the log was opened with [`MissingData::Error`], if no sweep
    /// has points, or if the folder cannot be written.
    pub fn build(log: &Log, folder: impl AsRef<Path>, options: &BuildOptions) -> Result<Self, Error> {
        let input = BuildInput::all(log.unedited_reader());
        let run = BuildRun::default();
        Ok(skeleton::build(folder.as_ref(), &[input], options, &|_| Ok(Vec::new()), &run)?)
    }
}
