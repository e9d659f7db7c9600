use std::path::Path;
use std::sync::Arc;

use crate::Error;
use crate::dataset::{self, Dataset, DatasetError, EgoTrack, LogLocator, MissingData};
use crate::scene::{EgoOffset, SceneMap, SceneState, state_at, state_of_frame};
use crate::skeleton::{self, BuildInput, BuildOptions, BuildRun, Skeleton};

/// A recorded drive: sensors, calibration, ego poses, tracked boxes and HD map.
pub struct Log {
    dataset: Box<dyn Dataset>,
    ego: EgoTrack,
    map: Option<Arc<SceneMap>>,
    map_error: Option<DatasetError>,
}

impl Log {
    /// Opens a log by name: `FORMAT:PATH[@VERSION][#SCENE]`, such as `nuscenes:/data/nuscenes@v1.0-mini#scene-0061`.
    /// Reads tables and the HD map, no sweeps and images.
    ///
    /// # Errors
    /// Fails if the name is invalid or if a table is missing or damaged.
    pub fn open(name: &str) -> Result<Self, Error> {
        let locator: LogLocator = name.parse()?;
        Self::new(dataset::open(&locator)?)
    }

    /// Creates a log from a reader of any format. With [`MissingData::Skip`], a log with a damaged HD map has none, and
    /// [`Log::map_error`] says why.
    ///
    /// # Errors
    /// Fails with [`MissingData::Error`] if the HD map is damaged.
    pub fn new(dataset: Box<dyn Dataset>) -> Result<Self, Error> {
        let (map, map_error) = match SceneMap::read(dataset.as_ref()) {
            Ok(map) => (map, None),
            Err(error) if dataset.log().reading.missing == MissingData::Skip => (None, Some(error)),
            Err(error) => return Err(error.into()),
        };
        let ego = EgoTrack::new(dataset.log());
        Ok(Self { dataset, ego, map, map_error })
    }

    /// Returns the name, which identifies the log in skeletons.
    pub fn name(&self) -> &str {
        &self.dataset.log().name
    }

    /// Returns the frames (the states at key frames), in time order.
    pub fn frames(&self) -> impl Iterator<Item = SceneState> {
        (0..self.dataset.log().frames.len()).filter_map(|i| self.frame(i))
    }

    /// Returns the state at a key frame; `None` beyond the last.
    pub fn frame(&self, index: usize) -> Option<SceneState> {
        let state = state_of_frame(self.dataset.log(), index, EgoOffset::default());
        state.map(|state| self.with_map(state))
    }

    /// Returns the state at a time, with interpolated ego and actors; `None` outside the log. Microseconds.
    pub fn state_at(&self, t_us: i64) -> Option<SceneState> {
        let state = state_at(self.dataset.log(), &self.ego, t_us, EgoOffset::default());
        state.map(|state| self.with_map(state))
    }

    /// Returns the HD map, if the log has one.
    pub fn map(&self) -> Option<Arc<SceneMap>> {
        self.map.clone()
    }

    /// Returns why the HD map cannot be read; `None` if it can, or if the log has none.
    pub fn map_error(&self) -> Option<&DatasetError> {
        self.map_error.as_ref()
    }

    /// Returns the reader, for sweeps and images.
    pub fn dataset(&self) -> &dyn Dataset {
        self.dataset.as_ref()
    }

    fn with_map(&self, state: SceneState) -> SceneState {
        SceneState { map: self.map.clone(), ..state }
    }
}

impl Skeleton {
    /// Builds a skeleton from all frames of a log, and writes it to a folder. An existing skeleton is replaced. For
    /// several logs, templates, progress and resumption see [`skeleton::build`].
    ///
    /// # Errors
    /// Fails if a file of the log is damaged and the log was opened with [`MissingData::Error`], if no sweep has points, or if the folder cannot be written.
    pub fn build(log: &Log, folder: impl AsRef<Path>, options: &BuildOptions) -> Result<Self, Error> {
        let input = BuildInput::all(log.dataset());
        let run = BuildRun::default();
        Ok(skeleton::build(folder.as_ref(), &[input], options, &|_| Ok(Vec::new()), &run)?)
    }
}
