use std::collections::BTreeMap;

use rayon::prelude::*;

use super::manifest::Chunk;
use super::voxel::{ColoredPoint, merge_voxels};
use crate::cloud::{Bounds, Point};

/// Side of a background chunk, metres: `f32` offsets within it are exact to a few micrometres.
pub const CHUNK_M: f64 = 32.0;

/// A chunk with its points.
pub(super) type FilledChunk = (Chunk, Vec<Point>);

/// Sorts global points into cubes of [`CHUNK_M`], merges voxels and takes each chunk's origin off. Chunks come in
/// the order x, y, z; within a chunk points are sorted by voxel.
pub fn chunks_from_points(points: impl Iterator<Item = ColoredPoint>, voxel_m: f64) -> Vec<FilledChunk> {
    let mut cells: BTreeMap<[i64; 3], Vec<ColoredPoint>> = BTreeMap::new();
    for point in points {
        let cell = (point.position / CHUNK_M).floor();
        let key = [cell.x as i64, cell.y as i64, cell.z as i64];
        let position = point.position - cell * CHUNK_M;
        cells.entry(key).or_default().push(ColoredPoint { position, ..point });
    }
    let cells: Vec<_> = cells.into_iter().collect();
    cells.into_par_iter().filter_map(|(key, points)| filled_chunk(key, points, voxel_m)).collect()
}

fn filled_chunk(key: [i64; 3], points: Vec<ColoredPoint>, voxel_m: f64) -> Option<FilledChunk> {
    let points: Vec<Point> = merge_voxels(points, voxel_m).iter().map(|p| point_from_colored(p, 0)).collect();
    let origin = key.map(|k| k as f64 * CHUNK_M);
    let bounds = Bounds::of(&points)?;
    Some((Chunk { origin, points: points.len(), bounds }, points))
}

/// To 16 bytes; the position must be near its origin.
pub(super) fn point_from_colored(point: &ColoredPoint, class: u8) -> Point {
    Point::new(point.position.as_vec3().to_array(), point.rgb, class)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn city_coordinates_keep_their_millimetres() {
        let base = DVec3::new(664_430.25, 3_997_650.75, 606.5);
        let points: Vec<ColoredPoint> = (0..500)
            .map(|i| {
                let offset =
                    DVec3::new(f64::from(i) * 0.3713, f64::from(i % 40) * -1.117, f64::from(i % 7) * 0.021);
                ColoredPoint { position: base + offset, rgb: [7; 3] }
            })
            .collect();
        let chunks = chunks_from_points(points.iter().copied(), 0.0);
        let back: Vec<DVec3> = chunks
            .iter()
            .flat_map(|(c, p)| {
                p.iter().map(|p| DVec3::from(c.origin) + glam::Vec3::from(p.position).as_dvec3())
            })
            .collect();
        assert_eq!(back.len(), points.len());
        for point in &points {
            let nearest = back.iter().map(|b| b.distance(point.position)).fold(f64::INFINITY, f64::min);
            assert!(nearest < 1e-5, "{nearest}");
        }
        assert!(chunks.iter().all(|(c, _)| c.bounds.min.iter().all(|v| *v >= 0.0)));
    }
}
