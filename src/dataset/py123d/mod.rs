//! Logs in the layout of py123d (123D): one folder per log with Arrow tables, whatever data set they come
//! from.
//!
//! # How it works
//! `sync.arrow` lists the frames, and for each table the row that belongs to a frame. `read` combines the
//! tables: `ego`, `boxes`, `lights`, `cameras` and `lidars` read one kind each, `nearest` decides which image
//! belongs to which frame. Tables are mapped and their images and sweeps read on demand (`cells`), either
//! from the cell (`codec`) or from a file of the original data set that the cell names (`roots`, `files`).
//! `map` reads HD maps, `labels` and `rig` hold numbers and names that no file explains. Format:
//! <https://kesai-labs.github.io/py123d>.

mod boxes;
mod cameras;
mod cells;
mod choose;
mod codec;
mod ego;
mod files;
mod headings;
mod labels;
mod lens;
mod lidars;
mod lights;
mod map;
mod metadata;
mod nearest;
mod read;
mod rig;
mod roots;
mod sync;
mod target;

pub use codec::count_points;

use std::path::{Path, PathBuf};

use self::cells::{CellKind, CellTable};
use self::files::PointFiles;
use self::lidars::LidarTable;
use self::read::Tables;
use super::limits::check_roots;
use super::picture::{decode_picture, encoded_size};
use super::sweeps::{RingDecision, SweepRow, SweepRows};
use super::{
    DatasetError, ImageRecord, LogFormat, LogLocator, LogReader, Recording, Sweep, SweepRecord, VectorMap,
    read_picture,
};
use crate::error::FileError;

/// One log of py123d.
pub struct Py123d {
    tables: Tables,
    map: Option<PathBuf>,
    rings: RingDecision,
}

impl Py123d {
    /// Reads the tables of a log. The path is its folder, or one of logs of which `@SPLIT` and `#LOG` select
    /// one. Opens no images, sweeps or maps.
    ///
    /// # Errors
    /// Fails if the folder is not a log, or contains several and none is selected. Fails if a table is
    /// damaged, or poses, cameras or boxes are invalid, or times do not increase.
    pub fn open(locator: &LogLocator) -> Result<Self, DatasetError> {
        check_roots(locator)?;
        let locator = choose::single(locator)?;
        let tables = read::read(&locator)?;
        let map = map::find(&locator, &tables.sync.about)?;
        Ok(Self { tables, map, rings: RingDecision::new(locator.reading.rings) })
    }
}

/// Returns the logs that a locator refers to, sorted by split and name.
///
/// # Errors
/// Fails if the folder cannot be read or has no logs, or none of the given split or name.
pub fn expand(locator: &LogLocator) -> Result<Vec<LogLocator>, DatasetError> {
    choose::expand(locator)
}

/// The format of py123d: folders of Arrow tables.
pub static FORMAT: LogFormat = LogFormat {
    name: "123d",
    has_path: true,
    rates_hz: [10.0, 5.0],
    detect: choose::has_logs,
    check: LogFormat::unchecked,
    expand,
    outline: LogFormat::outline_by_opening,
    open: |locator, _| Ok(Box::new(Py123d::open(locator)?)),
};

impl Py123d {
    fn dataset(&self) -> &str {
        &self.tables.sync.about.dataset
    }

    /// Format of the files that tables name.
    fn point_files(&self, path: &Path) -> Result<PointFiles, FileError> {
        PointFiles::of_dataset(self.dataset()).ok_or_else(|| files::unsupported(path, self.dataset()))
    }

    fn lidar(&self, path: &Path) -> Result<&LidarTable, FileError> {
        let found = self.tables.lidars.iter().find(|lidar| lidar.cells.file.path() == path);
        found.ok_or_else(|| FileError::content("a table of sweeps of the log", "another file", path))
    }

    /// Returns the table of an image in a cell.
    fn images(&self, record: &ImageRecord) -> Result<&CellTable, FileError> {
        let camera = self.tables.cameras.get(record.channel).map(|camera| &camera.cells);
        let cells =
            camera.ok_or_else(|| FileError::content("an image of the log", "another", &record.path))?;
        if cells.kind == CellKind::Video {
            let expected = "JPEG or PNG images (convert again with the option \
                camera_store_option=jpeg_binary of py123d)";
            return Err(FileError::content(expected, "a video (MPEG-4 Part 2)", &record.path));
        }
        Ok(cells)
    }
}

impl LogReader for Py123d {
    fn recording(&self) -> &Recording {
        &self.tables.log
    }

    fn read_sweep(&self, record: &SweepRecord) -> Result<Sweep, DatasetError> {
        let log = &self.tables.log;
        if record.row.is_none() {
            return Ok(self.point_files(&record.path)?.read(record, log, &self.rings)?);
        }
        let rows = |record: &SweepRecord| {
            let lidar = self.lidar(&record.path)?;
            lidar.cells.read(record.row.unwrap_or_default(), |bytes| stored_rows(bytes, lidar))
        };
        Ok(self.rings.read(log, record, rows)?)
    }

    fn check_sweep(&self, record: &SweepRecord) -> Result<Option<u64>, DatasetError> {
        let Some(row) = record.row else {
            return Ok(Some(self.point_files(&record.path)?.check(&record.path)?));
        };
        let declared =
            |bytes: &[u8]| codec::declared_points(bytes).map_err(|found| damaged(found, &record.path));
        Ok(Some(self.lidar(&record.path)?.cells.read(row, declared)?))
    }

    fn read_image(&self, record: &ImageRecord) -> Result<image::RgbImage, DatasetError> {
        let (height, width) = (record.camera.height, record.camera.width);
        let Some(row) = record.row else { return Ok(read_picture(&record.path, height, width)?) };
        let decode = |bytes: &[u8]| decode_picture(bytes, height, width, &record.path);
        Ok(self.images(record)?.read(row, decode)?)
    }

    fn check_image(&self, record: &ImageRecord) -> Result<(), DatasetError> {
        let Some(row) = record.row else {
            return Ok(super::check_size(super::picture_size(&record.path)?, record)?);
        };
        let check = |bytes: &[u8]| super::check_size(encoded_size(bytes, &record.path)?, record);
        Ok(self.images(record)?.read(row, check)?)
    }

    fn box_points(&self) -> Option<&[Vec<Option<u32>>]> {
        self.tables.box_points.as_deref()
    }

    fn read_map(&self) -> Result<Option<VectorMap>, DatasetError> {
        let (location, dataset) = (&self.tables.log.location, self.dataset());
        self.map.as_deref().map(|path| map::read(path, location, dataset)).transpose()
    }
}

/// Decodes the sweep in a cell.
fn stored_rows(bytes: &[u8], lidar: &LidarTable) -> Result<SweepRows, FileError> {
    let points = codec::decode(bytes).map_err(|found| damaged(found, lidar.cells.file.path()))?;
    let mut sweep = SweepRows::with_capacity(points.xyz.len());
    sweep.set_mount(&lidar.mount);
    let place = |id: u8| lidar.ids.iter().position(|known| *known == id).unwrap_or(lidar.ids.len());
    let ids = points.ids.as_ref().filter(|_| lidar.ids.len() > 1);
    for (i, position) in points.xyz.iter().enumerate() {
        let intensity = points.intensity.as_ref().map_or(0.0, |all| all[i]);
        let ring = points.channel.as_ref().map_or(0.0, |all| f64::from(all[i]));
        let row = SweepRow { position: *position, intensity, ring, device: None };
        sweep.push_of(row, ids.map(|ids| place(ids[i]) as u16));
    }
    for name in &points.skipped {
        sweep.note(&format!("sweeps with the feature {name} (not read)"));
    }
    Ok(sweep)
}

fn damaged(found: String, path: &Path) -> FileError {
    FileError::content("a sweep", found, path)
}
