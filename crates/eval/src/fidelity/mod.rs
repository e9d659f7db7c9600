//! Compares condition maps of the synthetic town with ground truth, at and beside the recorded poses.
//! `measure` compares, `table` formats.

mod error;
mod measure;
mod table;

pub use error::FidelityError;
pub use measure::{MaskRow, Row};
pub use table::FidelityFiles;

use std::ops::Range;

use point_skeleton::Renderer;
use point_skeleton::conditions::{ConditionOptions, MapKind, MapSet};
use point_skeleton::dataset::LogReader;
use pskel_town::Town;
use serde::Serialize;

use self::measure::{Measured, Measurement, Pose};

/// Results of all poses.
#[derive(Debug, Serialize)]
pub struct FidelityReport {
    log: String,
    description: String,
    /// First frame, and the one after the last.
    frames: [usize; 2],
    options: ConditionOptions,
    /// A row per pose.
    pub poses: Vec<Row>,
}

/// Number of poses at which every frame is compared.
pub const POSES: usize = Pose::ALL.len();

/// Compares the maps of frames at all poses. `renderer` is of the town's skeleton; `options` set splat radii
/// and sizes; `on_step` is called with a name after each frame of each pose.
///
/// # Errors
/// Fails if the log has no such frame, or if maps or ground truth cannot be rendered.
pub fn fidelity(
    town: &Town,
    renderer: &mut Renderer<'_>,
    frames: Range<usize>,
    options: ConditionOptions,
    on_step: &mut dyn FnMut(&str),
) -> Result<FidelityReport, FidelityError> {
    let maps = MapSet::of(&[MapKind::Color, MapKind::Depth, MapKind::Class, MapKind::Instance]);
    let options = ConditionOptions { maps, ..options };
    let map = town.read_map()?;
    let measurement = Measurement { town, options, map: map.as_ref() };
    let mut poses = Vec::new();
    for pose in Pose::ALL {
        let mut row = Measured::new(pose);
        for frame in frames.clone() {
            measurement.add(renderer, frame, &mut row)?;
            on_step(&format!("{}, frame {frame:06}", row.name));
        }
        poses.push(row.summary());
    }
    let log = town.recording();
    Ok(FidelityReport {
        log: log.name.clone(),
        description: log.description.clone(),
        frames: [frames.start, frames.end],
        options: measurement.options,
        poses,
    })
}
