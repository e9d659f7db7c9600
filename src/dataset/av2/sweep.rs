//! `sensors/lidar/TIME_NS.feather`: one sweep of both stacked LiDARs, in the ego frame at that time.

use std::path::Path;

use crate::dataset::sweeps::{SweepRow, SweepRows};
use crate::dataset::tables::ArrowFile;
use crate::dataset::{RingMeaning, Sweep};
use crate::error::FileError;

const COORDINATES: [&str; 3] = ["x", "y", "z"];
const INTENSITY: &str = "intensity";
const RING: &str = "laser_number";

/// Reads a sweep: x, y, z in meters (floats of any width; the dataset uses 16 bits), intensity 0–255, and the
/// beam number as ring. Drops and counts points with an empty, NaN or infinite coordinate; other empty values
/// and missing columns are 0.
///
/// # Errors
/// Fails if the file is missing, is not a Feather file, lacks coordinates, or has no point with finite ones.
pub fn read_sweep_file(path: &Path) -> Result<Sweep, FileError> {
    read_as(path, RingMeaning::Auto)
}

/// Reads a sweep with a meaning of its rings.
///
/// # Errors
/// Fails as [`read_sweep_file`].
pub(in crate::dataset) fn read_as(path: &Path, meaning: RingMeaning) -> Result<Sweep, FileError> {
    let table = ArrowFile::read(path)?.table(&COORDINATES, &[INTENSITY, RING])?;
    let numbers = |name: &str| table.column(name)?.numbers_or_nan();
    let [x, y, z] = [numbers("x")?, numbers("y")?, numbers("z")?];
    let mut sweep = SweepRows::with_capacity(table.rows());
    let mut or_zero = |name: &str| {
        if table.has(name) {
            return numbers(name);
        }
        sweep.note(&format!("sweeps without a column {name} (read as 0)"));
        Ok(vec![0.0; table.rows()])
    };
    let (intensity, ring) = (or_zero(INTENSITY)?, or_zero(RING)?);
    for i in 0..table.rows() {
        let position = [x[i] as f32, y[i] as f32, z[i] as f32];
        sweep.push(SweepRow { position, intensity: intensity[i] as f32, ring: ring[i], device: None });
    }
    // The name of the column says that it numbers beams.
    let is_device = meaning == RingMeaning::Device;
    sweep.finish(if is_device { meaning } else { RingMeaning::Beam }, path)
}

/// Returns the number of points that a sweep's file declares.
///
/// # Errors
/// Fails if the file is missing, is not a Feather file, lacks coordinates, or has no points.
pub(in crate::dataset) fn declared_points(path: &Path) -> Result<u64, FileError> {
    let file = ArrowFile::read(path)?;
    file.require(&COORDINATES)?;
    match file.rows() {
        0 => Err(FileError::content("at least one point", "none", path)),
        points => Ok(points),
    }
}
