//! Occlusion in camera images, estimated from sparse points.
//!
//! # How it works
//! Points are splatted as inverse depth (nearest wins) into a grid of [`CELL_PX`] pixels. LiDAR points are
//! sparse, so a grayscale closing fills the gaps between them: dilation, then erosion, both over
//! `(2·CLOSE_CELLS + 1)²` cells. The closing fills areas *between* nearer points without growing them beyond
//! their outline. It preserves planes, since inverse depth is linear on planes. A point is occluded if it is
//! clearly farther than the closed surface. Depths in the image of a wide lens are distances, whose inverse
//! is about linear across the few cells of the closing.

use glam::DVec2;

use crate::geometry::Camera;

/// Side of a grid cell, image pixels.
pub(crate) const CELL_PX: u32 = 4;
/// Radius of the closing, cells.
const CLOSE_CELLS: usize = 2;
/// Relative depth tolerance within which a point lies on the surface.
const RELATIVE_SLACK: f32 = 0.03;
/// Minimum camera height above the road, meters: from there, the road's slope across a cell is not a depth
/// step.
const EYE_HEIGHT_M: f64 = 1.5;

/// Maximum inverse depth per cell, 0 in empty cells.
pub(crate) struct OcclusionGrid {
    columns: usize,
    rows: usize,
    inverse_depth: Vec<f32>,
    /// Range of inverse depth that a road spans across a cell, 1/m.
    cell_slack: f32,
}

impl OcclusionGrid {
    /// Creates an empty grid for a camera's image.
    pub(crate) fn new(camera: &Camera) -> Self {
        let (width, height, focal_px) = (camera.width, camera.height, camera.intrinsics.y_axis.y);
        let (columns, rows) = (width.div_ceil(CELL_PX) as usize, height.div_ceil(CELL_PX) as usize);
        let cell_slack = (f64::from(CELL_PX) / (focal_px * EYE_HEIGHT_M)) as f32;
        Self { columns, rows, inverse_depth: vec![0.0; columns * rows], cell_slack }
    }

    /// Adds a point that projects to `pixel` at a camera depth in meters.
    pub(crate) fn add(&mut self, pixel: DVec2, depth_m: f64) {
        if let Some(cell) = self.cell(pixel) {
            let inverse = (1.0 / depth_m) as f32;
            if inverse > self.inverse_depth[cell] {
                self.inverse_depth[cell] = inverse;
            }
        }
    }

    #[inline(always)]
    fn cell(&self, pixel: DVec2) -> Option<usize> {
        let (x, y) = (pixel.x / f64::from(CELL_PX), pixel.y / f64::from(CELL_PX));
        let inside = x >= 0.0 && y >= 0.0 && x < self.columns as f64 && y < self.rows as f64;
        inside.then(|| y as usize * self.columns + x as usize)
    }

    /// Closes the gaps between points.
    pub(crate) fn close(self) -> OcclusionMap {
        let columns = self.columns;
        let widened = filter(&self.inverse_depth, columns, CLOSE_CELLS, f32::max);
        let surface = filter(&widened, columns, CLOSE_CELLS, f32::min);
        OcclusionMap(Self { inverse_depth: surface, ..self })
    }
}

/// Closed [`OcclusionGrid`].
pub(crate) struct OcclusionMap(OcclusionGrid);

impl OcclusionMap {
    /// Returns whether a clearly nearer surface occludes a point at `pixel` and a camera depth in meters.
    /// Always `false` outside the image.
    #[inline(always)] // into loops that are compiled for wide vectors
    pub(crate) fn hides(&self, pixel: DVec2, depth_m: f64) -> bool {
        let Some(cell) = self.0.cell(pixel) else { return false };
        let surface = self.0.inverse_depth[cell];
        ((1.0 / depth_m) as f32) < surface * (1.0 - RELATIVE_SLACK) - self.0.cell_slack
    }
}

/// Returns the extreme over a square of `(2·radius + 1)²` cells around each cell, filtering rows, then
/// columns.
fn filter(cells: &[f32], columns: usize, radius: usize, pick: fn(f32, f32) -> f32) -> Vec<f32> {
    let rows = cells.len() / columns.max(1);
    let mut along_rows = cells.to_vec();
    for (out, line) in along_rows.chunks_mut(columns).zip(cells.chunks(columns)) {
        for shift in 1..=radius.min(columns.saturating_sub(1)) {
            for x in shift..columns {
                out[x] = pick(out[x], line[x - shift]);
                out[x - shift] = pick(out[x - shift], line[x]);
            }
        }
    }
    let mut result = along_rows.clone();
    for shift in 1..=radius.min(rows.saturating_sub(1)) {
        let offset = shift * columns;
        for i in offset..cells.len() {
            result[i] = pick(result[i], along_rows[i - offset]);
            result[i - offset] = pick(result[i - offset], along_rows[i]);
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(width: u32, height: u32) -> Camera {
        Camera::new("c", width, height, [[1000.0, 0.0, 200.0], [0.0, 1000.0, 200.0], [0.0, 0.0, 1.0]])
            .unwrap()
    }

    /// Returns a wall at 10 m with a point every third cell, in columns 30 to 60 of 100.
    fn wall() -> OcclusionMap {
        let mut grid = OcclusionGrid::new(&camera(400, 400));
        for row in (0..100).step_by(3) {
            for column in (30..=60).step_by(3) {
                grid.add(
                    DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5) * f64::from(CELL_PX),
                    10.0,
                );
            }
        }
        grid.close()
    }

    #[test]
    fn a_sparse_wall_hides_points_behind_it_but_not_beside_it() {
        let map = wall();
        let hides =
            |column: f64, depth| map.hides(DVec2::new(column + 0.5, 50.5) * f64::from(CELL_PX), depth);
        for column in 30..=60 {
            let column = f64::from(column);
            assert_eq!([20.0, 10.1, 5.0].map(|z| hides(column, z)), [true, false, false], "{column}");
        }
        assert_eq!([-1.0, 29.0, 61.0, 100.0].map(|column| hides(column, 20.0)), [false; 4]);
    }

    #[test]
    fn a_road_does_not_hide_itself() {
        let (focal, height) = (1000.0, 1.5);
        let mut grid = OcclusionGrid::new(&camera(400, 800));
        let road: Vec<f64> = (0..300).map(|i| 4.0 * 1.01_f64.powi(i)).filter(|z| *z < 60.0).collect();
        let pixel = |z: f64| DVec2::new(200.0, 200.0 + focal * height / z);
        road.iter().for_each(|&z| grid.add(pixel(z), z));
        let map = grid.close();
        for &z in &road {
            assert!(!map.hides(pixel(z), z), "{z}");
        }
    }
}
