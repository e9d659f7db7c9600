//! Conversion of a log's tables to a [`Recording`].

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::cameras::CameraTable;
use super::cells::CellKind;
use super::ego::Ego;
use super::files::PointFiles;
use super::headings::note_backward;
use super::lidars::LidarTable;
use super::sync::Sync;
use super::target::Target;
use super::{boxes, ego, lights, rig, roots};
use crate::dataset::clock::{Unit, note_interval};
use crate::dataset::limits::MAX_CAMERAS;
use crate::dataset::recording::notes::{Notes, note, settle};
use crate::dataset::tables::ArrowFile;
use crate::dataset::{BoxPoints, DatasetError, Frame, Gap, LogLocator, Recording};
use crate::error::FileError;
use crate::files::input::is_there;
use crate::files::text::printable_path;

/// Kind of a gap: a frame that cannot be placed.
const NO_POSE: &str = "frames without an ego pose";
/// Kind of a gap: a table that `sync` refers to.
const NO_TABLE: &str = "tables that do not exist";

/// Extension of tables.
const ARROW: &str = "arrow";

/// Log with its open tables.
pub(super) struct Tables {
    pub(super) log: Recording,
    pub(super) sync: Sync,
    pub(super) cameras: Vec<CameraTable>,
    pub(super) lidars: Vec<LidarTable>,
    pub(super) box_points: Option<BoxPoints>,
}

/// Reads the tables of a log, except for images, sweeps and the map.
///
/// # Errors
/// Fails if `sync.arrow` is missing, a table is damaged, a pose, a camera or a box is invalid, or a folder of
/// files that tables name is not known.
pub(super) fn read(locator: &LogLocator) -> Result<Tables, DatasetError> {
    let folder = locator.path.as_path();
    let sync = Sync::read(folder)?;
    let mut notes = Notes::new();
    let ego = Ego::read(folder, &sync)?;
    let (cameras, lidars) = sensors(locator, &sync, &ego, &mut notes)?;
    let (rows, mut frames) = frames(&sync, &ego, &lidars, cameras.len(), &mut notes)?;
    let found = boxes::read(folder, &sync, &rows, &mut notes)?;
    let lights = lights::read(folder, &sync, &rows, &mut notes)?;
    frames.iter_mut().zip(found.frames).for_each(|(frame, boxes)| frame.boxes = boxes);
    note_backward(&frames, found.tracks.len(), &mut notes);
    let times_us: Vec<i64> = frames.iter().map(|frame| frame.t_us).collect();
    note_interval(&times_us, Unit::MICROS, &mut notes);
    let paths = cameras.iter().map(|camera| &camera.cells).chain(lidars.iter().map(|lidar| &lidar.cells));
    let paths = paths.filter(|cells| cells.kind == CellKind::Path).map(|cells| cells.file.path()).next();
    let root = paths.map(|table| roots::sensors(locator, &sync.about.dataset, table)).transpose()?;
    let mut target = Target { sync: &sync, rows: &rows, ego: &ego, root: root.as_ref(), frames: &mut frames };
    for lidar in &lidars {
        lidar.add_sweeps(&mut target, &mut notes)?;
    }
    for (channel, camera) in cameras.iter().enumerate() {
        camera.add_images(channel, &mut target, &mut notes)?;
    }
    for frame in &mut frames {
        frame.between_images.sort_by_key(|image| (image.t_us, image.channel));
    }
    let about = &sync.about;
    let mut log = Recording {
        name: about.log_name.clone(),
        location: about.location.clone().unwrap_or_default(),
        description: format!("{} {}", about.dataset, about.split),
        cameras: cameras.iter().map(|camera| camera.camera.name.clone()).collect(),
        rig: cameras.iter().enumerate().map(|(channel, camera)| camera.rig(channel)).collect(),
        tracks: found.tracks,
        frames,
        lights,
        rates_hz: rig::rates_hz(&about.dataset),
        reading: locator.reading,
        ..Recording::default()
    };
    settle(&mut log, notes)?;
    Ok(Tables { log, sync, cameras, lidars, box_points: found.points })
}

/// Returns the rows of `sync` with an ego pose, and their frames.
///
/// # Errors
/// Fails if `sync` names a sweep that does not exist.
fn frames(
    sync: &Sync,
    ego: &Ego,
    lidars: &[LidarTable],
    cameras: usize,
    notes: &mut Notes,
) -> Result<(Vec<usize>, Vec<Frame>), FileError> {
    let (mut rows, mut frames) = (Vec::new(), Vec::new());
    let sweeps_us: Vec<_> = lidars.iter().map(|lidar| lidar.pose_times(sync)).collect::<Result<_, _>>()?;
    for (row, t_us) in sync.times_us.iter().copied().enumerate() {
        let sweep_us = sweeps_us.iter().find_map(|times_us| times_us[row]);
        let Some(global_from_ego) = ego.of_frame(row, sweep_us.unwrap_or(t_us)) else {
            notes.gap(Gap::record(NO_POSE, format!("frame at {t_us}"), &sync.path));
            continue;
        };
        // Vectors that grow would take twice the memory in long logs.
        let (sweeps, images) = (Vec::with_capacity(lidars.len()), Vec::with_capacity(cameras));
        let (between_images, boxes) = Default::default();
        rows.push(row);
        frames.push(Frame { t_us, global_from_ego, sweeps, images, between_images, boxes });
    }
    Ok((rows, frames))
}

/// Opens the tables of cameras, in the order around the vehicle, and of LiDARs. Counts tables that are not
/// read.
fn sensors(
    locator: &LogLocator,
    sync: &Sync,
    ego: &Ego,
    notes: &mut Notes,
) -> Result<(Vec<CameraTable>, Vec<LidarTable>), DatasetError> {
    let (mut cameras, mut lidars) = (Vec::new(), Vec::new());
    let path = |key: &str| locator.path.join(format!("{key}.{ARROW}"));
    for key in keys(&locator.path, sync)? {
        let path = path(&key);
        let (kind, _) = key.split_once('.').unwrap_or((&key, ""));
        let is_read = [ego::KEY, boxes::KEY, lights::KEY].contains(&kind);
        if !is_there(&path)? {
            notes.gap(Gap::missing(NO_TABLE, path));
            continue;
        }
        match kind {
            "camera" => cameras.extend(CameraTable::open(
                ArrowFile::map_sparse(&path)?,
                &key,
                ego,
                &locator.reading,
                notes,
            )?),
            "lidar" => {
                let files = PointFiles::of_dataset(&sync.about.dataset);
                lidars.push(LidarTable::open(ArrowFile::map_sparse(&path)?, &key, files)?);
            }
            _ if is_read => {}
            _ => note(notes, &format!("tables of another kind ({kind}, not read)"), 1),
        }
    }
    if cameras.len() > MAX_CAMERAS {
        let expected = format!("at most {MAX_CAMERAS} cameras");
        return Err(FileError::content(expected, cameras.len().to_string(), &locator.path).into());
    }
    cameras.sort_by(|a, b| rig::place(&a.camera.name).cmp(&rig::place(&b.camera.name)));
    if let Some(pair) = cameras.windows(2).find(|pair| pair[0].camera.name == pair[1].camera.name) {
        let [first, second] = [&pair[0], &pair[1]].map(|camera| camera.cells.file.path());
        let found = format!("{} of {} too", pair[0].camera.name, printable_path(first));
        return Err(FileError::content("cameras of different names", found, second).into());
    }
    Ok((cameras, lidars))
}

/// Returns the keys of a log's tables in order: those of files, and those that `sync` refers to.
fn keys(folder: &Path, sync: &Sync) -> Result<BTreeSet<String>, FileError> {
    let mut keys: BTreeSet<String> = sync.keys().map(str::to_owned).collect();
    for entry in std::fs::read_dir(folder).map_err(FileError::io("read", folder))? {
        let path: PathBuf = entry.map_err(FileError::io("read", folder))?.path();
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        if path.extension().is_some_and(|extension| extension == ARROW) && !["sync", "map"].contains(&&*stem)
        {
            keys.insert(stem.into_owned());
        }
    }
    Ok(keys)
}
