//! `sensors/lidar/TIME_NS.feather`: one sweep of both stacked LiDARs, in the ego frame at that time.

use std::path::Path;

use super::feather::{Table, declared_rows};
use crate::dataset::{Sweep, SweepPoint};
use crate::error::FileError;

const COLUMNS: [&str; 5] = ["x", "y", "z", "intensity", "laser_number"];

/// Reads a sweep: x, y, z in meters (floats of any width; the dataset uses 16 bits), intensity 0–255, and the beam
/// number as ring. Drops and counts points with a NaN or infinite coordinate or intensity.
///
/// # Errors
/// Fails if the file is missing, is not a Feather file, or lacks a column.
pub fn read_sweep_file(path: &Path) -> Result<Sweep, FileError> {
    let table = Table::read(path, &COLUMNS)?;
    let numbers = |name: &str| table.column(name)?.numbers();
    let [x, y, z] = [numbers("x")?, numbers("y")?, numbers("z")?];
    let (intensity, ring) = (numbers("intensity")?, table.column("laser_number")?.counts()?);
    let mut sweep = Sweep { points: Vec::with_capacity(table.rows()), ..Sweep::default() };
    for i in 0..table.rows() {
        let position = [x[i] as f32, y[i] as f32, z[i] as f32];
        if position.iter().all(|v| v.is_finite()) && intensity[i].is_finite() {
            let ring = u16::try_from(ring[i]).unwrap_or(u16::MAX);
            sweep.points.push(SweepPoint { position, intensity: intensity[i] as f32, ring });
        } else {
            sweep.dropped_non_finite += 1;
        }
    }
    Ok(sweep)
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
