//! nuScenes: JSON tables linked by tokens (10 are read), with LiDAR sweeps and camera images beside them.
//!
//! # How it works
//! `tables` defines the raw records, `version` finds the records of one scene, `read` converts them to a
//! [`Recording`], and `sweep` reads and writes sweep files. `interpolate` writes tables at a higher rate, and
//! `subset` tables of some samples. `folders` finds the tables of other data sets in this layout: TIER IV's
//! T4 and Lyft Level 5. Format: <https://www.nuscenes.org/nuscenes#data-format>.

mod annotations;
mod chain;
mod choose;
mod folders;
mod frames;
mod interpolate;
mod lens;
mod map;
mod read;
mod retime;
mod sensors;
mod subset;
mod sweep;
mod sweep_info;
mod tables;
mod unread;
mod unsorted;
mod version;
mod write;
mod write_map;

pub use choose::expand;
use folders::SensorFiles;
use frames::SweepInfos;
pub use interpolate::{ANNOTATED_HZ, InterpolatedCounts, interpolate_tables};
pub use map::read_map_file;
use read::SceneLog;
pub use subset::{SubsetSample, TableSubset};
pub use sweep::{POINT_BYTES, parse_sweep, read_sweep_file, write_sweep_file};
#[cfg(feature = "123d")]
pub(super) use sweep::{check as check_sweep, read_rows as sweep_rows};
use version::Version;

pub use write::{LogWriter, write_log};
pub use write_map::{MapLayers, RoadSegment, write_map};

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::limits::check_roots;
use super::sweeps::RingDecision;
use super::{
    DatasetError, ImageRecord, LogFormat, LogLocator, LogOpener, LogReader, Recording, Sweep, SweepRecord,
    VectorMap, read_picture,
};
use crate::files::input::DataRoot;

/// One scene of a nuScenes dataset.
#[derive(Debug)]
pub struct NuScenes {
    log: Recording,
    box_points: Vec<Vec<Option<u32>>>,
    infos: SweepInfos,
    root: PathBuf,
    /// Folder of maps, if not the default one.
    map_root: Option<PathBuf>,
    rings: RingDecision,
}

impl NuScenes {
    /// Reads the tables in `PATH/VERSION`. Defaults to the only folder with tables and to the only scene.
    /// `PATH` may also be a scene of T4, of which it takes the latest revision by default, or a folder of
    /// such scenes. Opens no sweeps, images or maps.
    ///
    /// # Errors
    /// Fails if tables are missing or damaged, tokens are unresolved, or times do not increase (nor those
    /// of the ego poses, see `retime`). Fails if file names point outside the folder of sweeps and images
    /// (unless [`LogLocator::allow_outside`]), or a camera name is not a valid folder name. Fails if poses,
    /// cameras or boxes are invalid, or if several versions or scenes exist and none is selected.
    pub fn open(locator: &LogLocator) -> Result<Self, DatasetError> {
        let locator = folders::resolve(locator)?;
        Self::of(&Version::open(&locator)?, &locator)
    }

    /// Reads a scene of a version.
    ///
    /// # Errors
    /// Fails as [`NuScenes::open`].
    pub(super) fn of(version: &Version, locator: &LogLocator) -> Result<Self, DatasetError> {
        check_roots(locator)?;
        let sensors = locator.sensor_root.as_ref().unwrap_or(&locator.path).clone();
        let sensors = DataRoot { path: sensors, allow_outside: locator.allow_outside };
        let files = SensorFiles::new(sensors, &version.folder);
        let SceneLog { log, box_points, infos } = read::read(&files, version, locator)?;
        let (root, map_root) = (locator.path.clone(), locator.map_root.clone());
        Ok(Self { log, box_points, infos, root, map_root, rings: RingDecision::new(locator.reading.rings) })
    }
}

impl NuScenes {
    /// Returns the path of the file that describes a sweep, if it has one.
    fn info_of(&self, sweep: &Path) -> Option<&Path> {
        self.infos.get(sweep).map(PathBuf::as_path)
    }
}

/// The format nuScenes: JSON tables.
pub static FORMAT: LogFormat = LogFormat {
    name: "nuscenes",
    has_path: true,
    rates_hz: [12.0, 2.0],
    detect: choose::has_tables,
    check: LogFormat::unchecked,
    expand,
    outline: |locator, opener| {
        let locator = folders::resolve(locator)?;
        version(&locator, opener)?.outline(&locator)
    },
    open: |locator, opener| {
        let locator = folders::resolve(locator)?;
        Ok(Box::new(NuScenes::of(&*version(&locator, opener)?, &locator)?))
    },
};

/// Returns the tables of a locator.
fn version(locator: &LogLocator, opener: &LogOpener) -> Result<Arc<Version>, DatasetError> {
    opener.tables(|known: &Version| known.is_of(locator), || Version::open(locator))
}

impl LogReader for NuScenes {
    fn recording(&self) -> &Recording {
        &self.log
    }

    fn read_sweep(&self, record: &SweepRecord) -> Result<Sweep, DatasetError> {
        let read = |record: &SweepRecord| sweep::read_rows(&record.path, self.info_of(&record.path));
        Ok(self.rings.read(&self.log, record, read)?)
    }

    fn check_sweep(&self, record: &SweepRecord) -> Result<Option<u64>, DatasetError> {
        Ok(Some(sweep::check(&record.path, self.info_of(&record.path))?))
    }

    fn read_image(&self, record: &ImageRecord) -> Result<image::RgbImage, DatasetError> {
        Ok(read_picture(&record.path, record.camera.height, record.camera.width)?)
    }

    fn box_points(&self) -> Option<&[Vec<Option<u32>>]> {
        Some(&self.box_points)
    }

    fn read_map(&self) -> Result<Option<VectorMap>, DatasetError> {
        let file = map::find(&self.root, self.map_root.as_deref(), &self.log.location)?;
        file.map(|path| map::read_map_file(&path, &self.log.location)).transpose()
    }
}
