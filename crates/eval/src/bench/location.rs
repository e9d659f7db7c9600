//! A location of many streets, as a skeleton: a benchmark of points that do not fit into memory.

use std::path::Path;

use glam::{DAffine3, DVec3};
use point_skeleton::cloud::{Bounds, Point, sort_in_space};
use point_skeleton::error::FileError;
use point_skeleton::files::Checksum;
use point_skeleton::geometry::View;
use point_skeleton::skeleton::{
    BuildOptions, BuildReport, CHUNK_M, Chunk, Manifest, Skeleton, SkeletonWriter, Source,
};

use super::street::{HALF_LENGTH_M, street_cloud, street_views};

/// Maximum number of points in a street.
const STREET_POINTS: usize = 10_000_000;
/// Distance between parallel streets, meters.
const BLOCK_M: f64 = 100.0;
/// Length of the drive, meters; shorter in smaller locations.
const DRIVE_M: f64 = 1000.0;
/// Distance between frames, meters.
const STEP_M: f64 = 1.0;
/// Seed of the street.
const SEED: u64 = 1;

/// Streets of a location: avenues of several streets in a line, side by side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Streets {
    count: usize,
    /// Streets of an avenue.
    columns: usize,
    /// Points of each.
    points: usize,
}

impl Streets {
    /// Returns the fewest streets with at least some number of points.
    fn new(points: usize) -> Self {
        let count = points.div_ceil(STREET_POINTS).max(1);
        Self { count, columns: (count as f64).sqrt().ceil() as usize, points: points.div_ceil(count) }
    }

    /// Returns the middle of a street, meters.
    fn origin(&self, street: usize) -> DVec3 {
        let (column, row) = (street % self.columns, street / self.columns);
        DVec3::new((2 * column + 1) as f64 * HALF_LENGTH_M, row as f64 * BLOCK_M, 0.0)
    }

    /// Returns where the ego is in each frame, meters: on an avenue in the middle.
    fn drive(&self) -> Vec<DVec3> {
        let row = self.count.div_ceil(self.columns) / 2;
        let columns = self.columns.min(self.count - row * self.columns);
        let length_m = columns as f64 * 2.0 * HALF_LENGTH_M;
        let drive_m = DRIVE_M.min(length_m - HALF_LENGTH_M);
        let at = |step: usize| (length_m - drive_m) / 2.0 + step as f64 * STEP_M;
        (0..=(drive_m / STEP_M) as usize)
            .map(|step| DVec3::new(at(step), row as f64 * BLOCK_M, 0.0))
            .collect()
    }

    fn name(&self) -> String {
        format!("location of {} streets with {} points each", self.count, self.points)
    }
}

/// Opens a location with at least some number of points, or writes it to a folder if there is none. All
/// streets have the points of [`street_cloud`].
///
/// # Errors
/// Fails if the folder has something else, or cannot be written.
pub(super) fn open_or_write(folder: &Path, points: usize) -> Result<Skeleton, FileError> {
    let streets = Streets::new(points);
    if !Skeleton::is_at(folder) {
        write(folder, streets)?;
    }
    let skeleton = Skeleton::open(folder)?;
    let found: Vec<&str> = skeleton.manifest.sources.iter().map(|source| source.log.as_str()).collect();
    if found != [streets.name()] {
        return Err(FileError::content(format!("a {}", streets.name()), found.join(", "), folder));
    }
    Ok(skeleton)
}

fn write(folder: &Path, streets: Streets) -> Result<(), FileError> {
    let chunks = chunks(streets.points);
    SkeletonWriter::write(folder, |writer| {
        for street in 0..streets.count {
            for (offset, chunk, points) in &chunks {
                let origin = (streets.origin(street) + *offset).to_array();
                writer.chunk(Chunk { origin, ..chunk.clone() }, points)?;
            }
        }
        let total = streets.count * streets.points;
        let report = BuildReport { points_read: total, background_points: total, ..BuildReport::default() };
        let source = Source { log: streets.name(), ..Source::default() };
        writer.finish(vec![source], BuildOptions::default(), report)
    })
}

/// Returns the chunks of a street with their offsets from its middle, meters.
fn chunks(points: usize) -> Vec<(DVec3, Chunk, Vec<Point>)> {
    let mut chunks: std::collections::BTreeMap<[i64; 2], Vec<Point>> = Default::default();
    for point in street_cloud(points, SEED) {
        let at = [0, 1].map(|axis| (f64::from(point.position[axis]) / CHUNK_M).floor());
        let [x, y, z] = point.position;
        let local = [(f64::from(x) - at[0] * CHUNK_M) as f32, (f64::from(y) - at[1] * CHUNK_M) as f32, z];
        chunks.entry(at.map(|i| i as i64)).or_default().push(Point { position: local, ..point });
    }
    let chunk = |(at, mut points): ([i64; 2], Vec<Point>)| {
        sort_in_space(&mut points);
        let bounds = Bounds::of(&points)?;
        let chunk = Chunk { origin: [0.0; 3], points: points.len(), bounds, xxh3: Checksum::of(&points) };
        Some((DVec3::new(at[0] as f64 * CHUNK_M, at[1] as f64 * CHUNK_M, 0.0), chunk, points))
    };
    chunks.into_iter().filter_map(chunk).collect()
}

/// Returns the name and the cameras of each frame on a drive through a location with some number of points.
pub(super) fn drive(points: usize) -> Vec<(String, Vec<View>)> {
    let frame = |(step, ego): (usize, DVec3)| {
        let at = DAffine3::from_translation(-ego);
        let view = |view: View| View { camera_from_world: view.camera_from_world * at, ..view };
        (format!("{} m", step as f64 * STEP_M), street_views().into_iter().map(view).collect())
    };
    Streets::new(points).drive().into_iter().enumerate().map(frame).collect()
}

/// Returns the disk space of a location, bytes.
pub(super) fn disk_bytes(points: usize) -> u64 {
    let Streets { count, points, .. } = Streets::new(points);
    (count * points * size_of::<Point>()) as u64
}

/// Returns the positions of the chunks, meters.
pub(super) fn origins(manifest: &Manifest) -> impl Iterator<Item = DVec3> {
    manifest.background.iter().map(|chunk| DVec3::from(chunk.origin))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drives_lead_through_the_middle() {
        let streets = Streets::new(1_000_000_000);
        assert_eq!(streets, Streets { count: 100, columns: 10, points: STREET_POINTS });
        let drive = streets.drive();
        assert_eq!(
            (drive.len(), drive[0], drive[1000]),
            (1001, DVec3::new(500.0, 500.0, 0.0), DVec3::new(1500.0, 500.0, 0.0))
        );
        assert_eq!(streets.origin(12), DVec3::new(500.0, 100.0, 0.0));
        let few = Streets::new(50_000_001);
        assert_eq!((few.count, few.columns, few.points), (6, 3, 8_333_334));
        assert_eq!(few.drive().first(), Some(&DVec3::new(50.0, 100.0, 0.0)));
        assert_eq!((Streets::new(9).drive().len(), Streets::new(9).points), (101, 9));
    }

    #[test]
    fn streets_are_repeated() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("location");
        let streets = Streets { count: 3, columns: 2, points: 5000 };
        write(&path, streets).unwrap();
        let skeleton = Skeleton::open(&path).unwrap();
        assert_eq!(skeleton.manifest.points(), 15_000);
        let expected = street_cloud(5000, SEED);
        let global = |origin: DVec3, points: &[Point]| -> Vec<[i64; 3]> {
            let position = |p: &Point| origin + DVec3::from(p.position.map(f64::from));
            points.iter().map(|p| (position(p) * 1e4).round().to_array().map(|v| v as i64)).collect()
        };
        let all: Vec<_> = origins(&skeleton.manifest).zip(skeleton.background().unwrap()).collect();
        let mut found: Vec<[i64; 3]> =
            all.iter().flat_map(|(origin, points)| global(*origin, points)).collect();
        let mut wanted: Vec<[i64; 3]> = (0..3).flat_map(|s| global(streets.origin(s), &expected)).collect();
        found.sort_unstable();
        wanted.sort_unstable();
        assert!(
            found.iter().zip(&wanted).all(|(a, b)| (0..3).all(|i| (a[i] - b[i]).abs() <= 1)),
            "same places"
        );
        let message = open_or_write(&path, 5000).unwrap_err().to_string();
        assert!(
            message.contains("expected a location of 1 streets with 5000 points each, found location of 3"),
            "{message}"
        );
    }
}
