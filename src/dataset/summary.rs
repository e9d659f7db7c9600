//! Summary of a log, and its missing or damaged files: only sizes and headers are read, and the points of a
//! few sweeps.

use std::collections::{BTreeMap, BTreeSet};

use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;

use super::{Frame, ImageRecord, LogReader, Recording};
use crate::files::FileName;

/// Summary of a log.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LogSummary {
    /// Name of the log.
    pub name: String,
    /// Map location.
    pub location: String,
    /// Description in the data set.
    pub description: String,
    /// Number of annotated frames.
    pub frames: usize,
    /// Times of the first and last frame, absolute microseconds.
    pub t_us: Option<[i64; 2]>,
    /// Time from the first to the last frame, seconds.
    pub seconds: Option<f64>,
    /// Number of sweeps.
    pub sweeps: usize,
    /// Point count of all sweeps, from file sizes; `None` if these do not determine it.
    pub points: Option<u64>,
    /// Cameras by channel.
    pub cameras: Vec<CameraSummary>,
    /// Number of tracks.
    pub tracks: usize,
    /// Number of boxes in frames.
    pub boxes: usize,
    /// Number of boxes without points, if the data set counts them.
    pub boxes_without_points: Option<usize>,
    /// Tracks and boxes by category.
    pub categories: BTreeMap<String, BoxCounts>,
    /// Frame count of each scenario.
    pub scenarios: BTreeMap<String, usize>,
    /// Traffic light states by color, counted.
    pub traffic_lights: BTreeMap<String, usize>,
    /// Path of the ego.
    pub ego: EgoPath,
    /// Elements of the HD map, if there is one.
    pub map: Option<MapCounts>,
    /// Skipped items, by kind.
    pub left_out: BTreeMap<String, usize>,
    /// Records that are missing or skipped; they are also counted in `left_out`.
    pub gaps: Vec<String>,
    /// Missing files, and errors of damaged files.
    pub damaged: Vec<String>,
}

/// Camera of a [`LogSummary`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraSummary {
    /// Channel name.
    pub name: FileName,
    /// Size of the images, `HxW`; `None` if the channel has no calibration.
    pub size: Option<String>,
    /// Focal length, pixels.
    pub focal_px: Option<f64>,
    /// Number of images at frames.
    pub images: usize,
    /// Number of images between frames.
    pub between_images: usize,
}

/// Tracks and boxes of a category.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct BoxCounts {
    /// Number of tracks.
    pub tracks: usize,
    /// Number of boxes.
    pub boxes: usize,
}

/// Bounds and length of the ego path.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct EgoPath {
    /// Minimum position, global meters.
    pub min: Option<[f64; 3]>,
    /// Maximum position, global meters.
    pub max: Option<[f64; 3]>,
    /// Length, meters.
    pub path_m: f64,
}

/// Elements of an HD map.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[allow(missing_docs)]
pub struct MapCounts {
    pub location: String,
    pub lanes: usize,
    pub lane_connectors: usize,
    pub drivable_areas: usize,
    pub crossings: usize,
    pub stop_lines: usize,
    pub dividers: usize,
}

impl LogSummary {
    /// Summarizes a log. Checks the header and size of every sweep and image file, and reads the HD map and
    /// the points of a few sweeps.
    pub fn new(dataset: &dyn LogReader) -> Self {
        let log = dataset.recording();
        let mut damaged: Vec<String> =
            log.gaps.iter().filter(|gap| gap.file().is_some()).map(ToString::to_string).collect();
        let (points, errors) = sweeps(dataset);
        damaged.extend(errors);
        let mut left_out = log.notes.clone();
        contents(dataset, points, &mut left_out, &mut damaged);
        damaged.extend(images(dataset));
        let map = map(dataset, &mut left_out, &mut damaged);
        // Images and sweeps may be in one file.
        let mut seen = BTreeSet::new();
        damaged.retain(|message| seen.insert(message.clone()));
        let t_us = log.frames.first().zip(log.frames.last()).map(|(a, b)| [a.t_us, b.t_us]);
        let empty = |counts: &[Vec<Option<u32>>]| {
            let known: Vec<u32> = counts.iter().flatten().flatten().copied().collect();
            let is_counted = !known.is_empty() || counts.iter().all(Vec::is_empty);
            is_counted.then(|| known.iter().filter(|n| **n == 0).count())
        };
        Self {
            name: log.name.clone(),
            location: log.location.clone(),
            description: log.description.clone(),
            frames: log.frames.len(),
            t_us,
            seconds: t_us.map(|[a, b]| (b - a) as f64 * 1e-6),
            sweeps: log.frames.iter().map(|f| f.sweeps.len()).sum(),
            points,
            cameras: cameras(log),
            tracks: log.tracks.len(),
            boxes: log.frames.iter().map(|f| f.boxes.len()).sum(),
            boxes_without_points: dataset.box_points().and_then(empty),
            categories: categories(log),
            scenarios: log.scenarios.iter().map(|(kind, frames)| (kind.clone(), frames.len())).collect(),
            traffic_lights: lights(log),
            ego: ego_path(log),
            map,
            left_out,
            gaps: log.gaps.iter().filter(|gap| gap.file().is_none()).map(ToString::to_string).collect(),
            damaged,
        }
    }
}

/// Returns the point count of all sweeps, derived from file sizes (`None` if they do not determine it), and
/// the errors of damaged sweep files.
fn sweeps(dataset: &dyn LogReader) -> (Option<u64>, Vec<String>) {
    let records: Vec<_> = dataset.recording().frames.iter().flat_map(|f| &f.sweeps).collect();
    let results: Vec<_> = records.par_iter().map(|record| dataset.check_sweep(record)).collect();
    let points =
        results.iter().flatten().try_fold(0, |sum: u64, points| Some(sum.saturating_add((*points)?)));
    (points, results.into_iter().filter_map(Result::err).map(|e| e.to_string()).collect())
}

/// Number of sweeps whose points are read, evenly spaced over the log.
const SWEEPS_READ: usize = 8;

/// Reads the points of a few sweeps, and adds what is unusual about their values. Sweeps that are generated
/// on reading are not read.
fn contents(
    dataset: &dyn LogReader,
    points: Option<u64>,
    left_out: &mut BTreeMap<String, usize>,
    damaged: &mut Vec<String>,
) {
    let records: Vec<_> = dataset.recording().frames.iter().flat_map(|f| &f.sweeps).collect();
    if points.is_none() && damaged.is_empty() {
        return;
    }
    let read = records.len().min(SWEEPS_READ);
    let chosen: Vec<_> = (0..read).map(|i| records[i * records.len() / read]).collect();
    let results: Vec<_> = chosen.par_iter().map(|record| dataset.read_sweep(record)).collect();
    let mut notes = BTreeMap::<String, usize>::new();
    for result in results {
        match result.map_err(|error| error.to_string()) {
            Ok(sweep) => {
                for (kind, count) in sweep.notes {
                    *notes.entry(kind).or_default() += count;
                }
                *notes.entry("points with coordinates that are not finite".to_owned()).or_default() +=
                    sweep.dropped_non_finite;
            }
            Err(error) if damaged.contains(&error) => {}
            Err(error) => damaged.push(error),
        }
    }
    let noted = notes.into_iter().filter(|(_, count)| *count > 0);
    left_out.extend(noted.map(|(kind, count)| (format!("{kind}, in {read} sweeps read"), count)));
}

/// Counts the elements of the HD map. Adds the notes of the map's reader to `left_out`.
fn map(
    dataset: &dyn LogReader,
    left_out: &mut BTreeMap<String, usize>,
    damaged: &mut Vec<String>,
) -> Option<MapCounts> {
    let map = dataset.read_map().unwrap_or_else(|error| {
        damaged.push(error.to_string());
        None
    })?;
    left_out.extend(map.notes.iter().map(|(kind, count)| (format!("map: {kind}"), *count)));
    Some(MapCounts {
        lanes: map.lanes.len(),
        lane_connectors: map.lane_connectors.len(),
        drivable_areas: map.drivable_area.len(),
        crossings: map.crossings.len(),
        stop_lines: map.stop_lines.len(),
        dividers: map.dividers.len(),
        location: map.location,
    })
}

/// Returns the errors of image files. A file that is shared by several frames is checked once.
fn images(dataset: &dyn LogReader) -> Vec<String> {
    let log = dataset.recording();
    let mut seen = BTreeSet::new();
    let all = log.frames.iter().flat_map(|f| f.images.iter().chain(&f.between_images));
    let records: Vec<&ImageRecord> = all.filter(|record| seen.insert(record.source())).collect();
    let check = |record: &&ImageRecord| dataset.check_image(record).err().map(|error| error.to_string());
    records.par_iter().filter_map(check).collect()
}

fn cameras(log: &Recording) -> Vec<CameraSummary> {
    let channel = |(index, name): (usize, &FileName)| {
        let count = |images: fn(&Frame) -> &Vec<ImageRecord>| {
            log.frames.iter().flat_map(images).filter(|image| image.channel == index).count()
        };
        let camera = log.rig.iter().find(|c| c.channel == index).map(|c| &c.camera);
        CameraSummary {
            name: name.clone(),
            size: camera.map(|c| format!("{}x{}", c.height, c.width)),
            focal_px: camera.map(|c| c.intrinsics.x_axis.x),
            images: count(|frame| &frame.images),
            between_images: count(|frame| &frame.between_images),
        }
    };
    log.cameras.iter().enumerate().map(channel).collect()
}

fn categories(log: &Recording) -> BTreeMap<String, BoxCounts> {
    let mut tally: BTreeMap<&str, (BTreeSet<usize>, usize)> = BTreeMap::new();
    for item in log.frames.iter().flat_map(|f| &f.boxes) {
        let entry = tally.entry(&log.tracks[item.track].category).or_default();
        entry.0.insert(item.track);
        entry.1 += 1;
    }
    let counts = |(tracks, boxes): (BTreeSet<usize>, usize)| BoxCounts { tracks: tracks.len(), boxes };
    tally.into_iter().map(|(name, tally)| (name.to_owned(), counts(tally))).collect()
}

fn lights(log: &Recording) -> BTreeMap<String, usize> {
    let mut tally = BTreeMap::new();
    log.lights.iter().for_each(|light| *tally.entry(light.color.clone()).or_default() += 1);
    tally
}

fn ego_path(log: &Recording) -> EgoPath {
    let places: Vec<DVec3> = log.frames.iter().map(|f| f.global_from_ego.translation).collect();
    let (min, max) = (places.iter().copied().reduce(DVec3::min), places.iter().copied().reduce(DVec3::max));
    // An empty sum would be -0.
    let path_m = places.windows(2).map(|w| w[0].distance(w[1])).fold(0.0, |sum, m| sum + m);
    EgoPath { min: min.map(|v| v.to_array()), max: max.map(|v| v.to_array()), path_m }
}
