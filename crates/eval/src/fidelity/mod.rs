//! Compares condition maps with ground truth: all maps of the synthetic town, at and beside the recorded
//! poses (`measure`), or color maps of a log with its images (`recorded`); or LiDAR sweeps (`sweeps`).
//! `table` formats.

mod differences;
mod error;
mod measure;
mod recorded;
mod sweeps;
mod table;
mod truth;

pub use differences::MaskBand;
pub use error::FidelityError;
pub use measure::{MaskRow, Row};
pub use recorded::CameraRow;
pub use sweeps::SweepRow;
pub use table::FidelityFiles;

use std::ops::Range;

use point_skeleton::conditions::{ConditionOptions, MapKind, MapSet};
use point_skeleton::dataset::{LogReader, Recording};
use point_skeleton::lidar::LidarSpec;
use point_skeleton::{Log, Renderer};
use pskel_town::Town;
use serde::Serialize;

use self::measure::{Measured, Measurement, Pose};

/// Log whose maps are compared.
#[derive(Clone, Copy)]
pub enum FidelitySource<'a> {
    /// Synthetic town, whose ground truth is rendered.
    Town(&'a Town),
    /// Log with recorded images.
    Log(&'a Log),
}

/// Frames to compare.
#[derive(Clone, Debug)]
pub struct FidelityFrames {
    /// First frame, and the one after the last.
    pub range: Range<usize>,
    /// Only every N-th frame, N - 1, 2 N - 1, ..: those between the frames if a skeleton has every N-th.
    pub hold_out: Option<usize>,
}

/// Results.
#[derive(Debug, Serialize)]
pub struct FidelityReport {
    log: String,
    description: String,
    /// First frame, and the one after the last.
    frames: [usize; 2],
    #[serde(skip_serializing_if = "Option::is_none")]
    hold_out: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    options: Option<ConditionOptions>,
    #[serde(skip_serializing_if = "Option::is_none")]
    lidar: Option<LidarSpec>,
    /// Rows of the table.
    #[serde(flatten)]
    pub rows: Rows,
}

/// Rows of the table.
#[derive(Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Rows {
    /// All maps of the town, a row per pose.
    Poses(Vec<Row>),
    /// Color maps against recorded images, a row per camera and one of all.
    Cameras(Vec<CameraRow>),
    /// LiDAR sweeps: of the town a row per pose, of a log a row per device and one of all.
    Sweeps(Vec<SweepRow>),
}

impl FidelitySource<'_> {
    /// Returns the recording.
    pub fn recording(&self) -> &Recording {
        match self {
            Self::Town(town) => town.recording(),
            Self::Log(log) => log.recording(),
        }
    }

    /// Returns the number of poses at which every frame is compared.
    pub fn poses(&self) -> usize {
        match self {
            Self::Town(_) => Pose::ALL.len(),
            Self::Log(_) => 1,
        }
    }

    /// Returns the number of poses at which the sweeps of every frame are compared.
    pub fn sweep_poses(&self) -> usize {
        match self {
            Self::Town(_) => sweeps::TOWN_POSES,
            Self::Log(_) => 1,
        }
    }

    fn report(&self, frames: &FidelityFrames, rows: Rows) -> FidelityReport {
        let log = self.recording();
        FidelityReport {
            log: log.name.clone(),
            description: log.description.clone(),
            frames: [frames.range.start, frames.range.end],
            hold_out: frames.hold_out,
            options: None,
            lidar: None,
            rows,
        }
    }
}

impl FidelityFrames {
    /// Iterates over the frames.
    pub fn iter(&self) -> impl Iterator<Item = usize> + use<> {
        let Self { range, hold_out } = self.clone();
        range.filter(move |frame| hold_out.is_none_or(|every| (frame + 1).is_multiple_of(every)))
    }
}

impl Rows {
    /// Returns the number of compared images or sweeps, and what they are.
    pub fn compared(&self) -> (usize, &'static str) {
        match self {
            Self::Poses(rows) => (rows.iter().map(|row| row.images).sum(), "images"),
            Self::Cameras(rows) => (rows.last().map_or(0, |all| all.images), "images"),
            Self::Sweeps(rows) => (rows.last().map_or(0, |last| last.sweeps), "sweeps"),
        }
    }
}

/// Compares LiDAR sweeps of frames instead of maps. `spec` describes the devices, all of them with a mount: a
/// town is scanned by them, and recorded sweeps have their timing and range.
///
/// # Errors
/// Fails if the log has no such frame, or if sweeps cannot be rendered or read.
pub fn sweep_fidelity(
    source: FidelitySource<'_>,
    renderer: &mut Renderer<'_>,
    frames: &FidelityFrames,
    spec: &LidarSpec,
    on_step: &mut dyn FnMut(&str),
) -> Result<FidelityReport, FidelityError> {
    let rows = Rows::Sweeps(sweeps::measure(source, renderer, frames, spec, on_step)?);
    Ok(FidelityReport { lidar: Some(spec.clone()), ..source.report(frames, rows) })
}

/// Compares the maps of frames. `renderer` is of the log's skeleton; `options` set splat radii and sizes;
/// `on_step` is called with a name after each frame of each pose.
///
/// # Errors
/// Fails if the log has no such frame, or if maps or ground truth cannot be rendered or read.
pub fn fidelity(
    source: FidelitySource<'_>,
    renderer: &mut Renderer<'_>,
    frames: &FidelityFrames,
    options: ConditionOptions,
    on_step: &mut dyn FnMut(&str),
) -> Result<FidelityReport, FidelityError> {
    let kinds = match source {
        FidelitySource::Town(_) => &[MapKind::Color, MapKind::Depth, MapKind::Class, MapKind::Instance][..],
        FidelitySource::Log(_) => &[MapKind::Color],
    };
    let options = ConditionOptions { maps: MapSet::of(kinds), ..options };
    let rows = match source {
        FidelitySource::Town(town) => {
            let map = town.read_map()?;
            let measurement = Measurement { town, options: options.clone(), map: map.as_ref() };
            let mut poses = Vec::new();
            for pose in Pose::ALL {
                let mut row = Measured::new(pose);
                for frame in frames.iter() {
                    measurement.add(renderer, frame, &mut row)?;
                    on_step(&format!("{}, frame {frame:06}", row.name));
                }
                poses.push(row.summary());
            }
            Rows::Poses(poses)
        }
        FidelitySource::Log(log) => {
            Rows::Cameras(recorded::measure(log, renderer, frames.iter(), &options, on_step)?)
        }
    };
    Ok(FidelityReport { options: Some(options), ..source.report(frames, rows) })
}
