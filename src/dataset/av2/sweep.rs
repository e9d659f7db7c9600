//! `sensors/lidar/TIME_NS.feather`: one sweep of both stacked LiDARs, in the ego frame at that time.

use std::path::Path;

use super::feather::{Table, declared_rows};
use crate::dataset::sweeps::{SweepRow, SweepRows};
use crate::dataset::{RingMeaning, Sweep};
use crate::error::FileError;

const COLUMNS: [&str; 5] = ["x", "y", "z", "intensity", "laser_number"];

/// Reads a sweep: x, y, z in meters (floats of any width; the dataset uses 16 bits), intensity 0–255, and the beam
/// number as ring. Drops and counts points with a NaN or infinite coordinate; other empty values are 0.
///
/// # Errors
/// Fails if the file is missing, is not a Feather file, or lacks a column.
pub fn read_sweep_file(path: &Path) -> Result<Sweep, FileError> {
    read_as(path, RingMeaning::Auto)
}

/// Reads a sweep with a meaning of its rings.
///
/// # Errors
/// Fails as [`read_sweep_file`].
pub(super) fn read_as(path: &Path, meaning: RingMeaning) -> Result<Sweep, FileError> {
    let table = Table::read(path, &COLUMNS)?;
    let numbers = |name: &str| table.column(name)?.numbers();
    let [x, y, z] = [numbers("x")?, numbers("y")?, numbers("z")?];
    let or_nan = |name: &str| table.column(name)?.numbers_or_nan();
    let (intensity, ring) = (or_nan("intensity")?, or_nan("laser_number")?);
    let mut sweep = SweepRows::with_capacity(table.rows());
    for i in 0..table.rows() {
        let position = [x[i] as f32, y[i] as f32, z[i] as f32];
        sweep.push(SweepRow { position, intensity: intensity[i] as f32, ring: ring[i], device: None });
    }
    // The name of the column says that it numbers beams.
    let is_device = meaning == RingMeaning::Device;
    Ok(sweep.finish(if is_device { meaning } else { RingMeaning::Beam }))
}

/// Returns the number of points that a sweep's file declares.
///
/// # Errors
/// Fails if the file is missing, is not a Feather file, lacks a column, or has no points.
pub(super) fn declared_points(path: &Path) -> Result<u64, FileError> {
    match declared_rows(path, &COLUMNS)? {
        0 => Err(FileError::content("at least one point", "none", path)),
        points => Ok(points),
    }
}
