//! Sample grid and projection of a view.
//!
//! # How it works
//! A tile of `w × h` pixels has `(2w + 1) × (2h + 1)` samples at half-pixel steps, so that sample `(2i + 1,
//! 2j + 1)` lies at the centre of pixel `(i, j)` and the others on the borders of pixels.

use glam::{DAffine3, DMat3, DVec3, DVec4};
use point_skeleton::geometry::View;
use point_skeleton::raster::tiles::Tile;

/// Near plane, meters of camera z.
pub(super) const NEAR_M: f64 = 0.1;

/// Camera for a tile of a view.
#[derive(Clone, Debug)]
pub(super) struct Lens {
    /// Camera from town, meters.
    pub(super) camera_from_town: DAffine3,
    /// `(x·z, y·z, z)` in samples from camera coordinates: a sample `(s, t)` covers `[s, s+1) × [t, t+1)`.
    samples_from_camera: DMat3,
    /// Columns and rows of samples.
    pub(super) samples: [u32; 2],
    /// Camera position, town frame.
    pub(super) place: DVec3,
}

/// Three rows that map homogeneous mesh coordinates to clip x, clip y and clip w.
pub(super) type ClipRows = [DVec4; 3];

impl Lens {
    pub(super) fn new(view: &View, tile: &Tile) -> Self {
        let [left, top] = tile.origin.map(f64::from);
        let samples_from_pixels = DMat3::from_cols_array_2d(&[
            [2.0, 0.0, 0.0],
            [0.0, 2.0, 0.0],
            [0.5 - 2.0 * left, 0.5 - 2.0 * top, 1.0],
        ]);
        Self {
            camera_from_town: view.camera_from_world,
            samples_from_camera: samples_from_pixels * view.camera.intrinsics,
            samples: tile.size.map(|side| 2 * side + 1),
            place: view.camera_from_world.inverse().translation,
        }
    }

    /// Returns the town rays of samples at camera z 1: columns for sample x, sample y and 1.
    pub(super) fn rays(&self) -> DMat3 {
        self.camera_from_town.inverse().matrix3 * self.samples_from_camera.inverse()
    }

    /// Returns the width of a sample at 1 m, meters.
    pub(super) fn sample_m(&self) -> f64 {
        1.0 / self.samples_from_camera.x_axis.x.abs().max(1e-9)
    }

    /// Returns the rows that map mesh coordinates to clip coordinates.
    pub(super) fn clip_rows(&self, town_from_mesh: &DAffine3) -> ClipRows {
        let camera_from_mesh = self.camera_from_town * *town_from_mesh;
        let linear = (self.samples_from_camera * camera_from_mesh.matrix3).transpose();
        let offset = self.samples_from_camera * camera_from_mesh.translation;
        let row = |linear: DVec3, offset: f64| linear.extend(offset);
        let z = row(linear.z_axis, offset.z);
        let [columns, rows] = self.samples.map(f64::from);
        [
            row(linear.x_axis, offset.x) * (2.0 / columns) - z,
            row(linear.y_axis, offset.y) * (2.0 / rows) - z,
            z,
        ]
    }
}

/// Returns the minimum camera z of a box, meters; `None` if the box is out of view.
pub(super) fn nearest_m(clip: &ClipRows, [min, max]: [DVec3; 2]) -> Option<f64> {
    let corner = |bits: usize| {
        let pick = |axis: usize| if bits >> axis & 1 == 1 { max[axis] } else { min[axis] };
        let p = DVec4::new(pick(0), pick(1), pick(2), 1.0);
        clip.map(|row| row.dot(p))
    };
    let corners: [[f64; 3]; 8] = std::array::from_fn(corner);
    let beyond = |out: &dyn Fn(&[f64; 3]) -> bool| corners.iter().all(out);
    let outside = beyond(&|[_, _, w]| *w < NEAR_M)
        || beyond(&|[x, _, w]| *x < -*w)
        || beyond(&|[x, _, w]| *x > *w)
        || beyond(&|[_, y, w]| *y < -*w)
        || beyond(&|[_, y, w]| *y > *w);
    let nearest = corners.iter().map(|[_, _, w]| *w).fold(f64::INFINITY, f64::min);
    (!outside).then_some(nearest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use point_skeleton::geometry::Camera;

    #[test]
    fn samples_lie_at_the_centres_of_pixels() {
        let rows = [[300.0, 2.0, 40.0], [0.0, 310.0, 22.0], [0.0, 0.0, 1.0]];
        let camera = Camera::new("c", 80, 45, rows).unwrap();
        let camera_from_world = DAffine3::from_axis_angle(DVec3::new(0.6, 0.8, 0.0), 0.3);
        let view = View { camera, camera_from_world };
        let tile = Tile { origin: [16, 8], size: [32, 20] };
        let lens = Lens::new(&view, &tile);
        assert_eq!(lens.samples, [65, 41]);
        // Pixel (20, 11) is pixel (4, 3) of the tile, so sample (9, 7), whose middle is (9.5, 7.5).
        let ray = lens.rays() * DVec3::new(9.5, 7.5, 1.0);
        let (pixel, z) = view.project(lens.place + 7.0 * ray).unwrap();
        assert!((pixel - glam::DVec2::new(20.5, 11.5)).length() < 1e-9 && (z - 7.0).abs() < 1e-9);
        let [x, y, w] = lens.clip_rows(&DAffine3::IDENTITY).map(|row| row.dot((7.0 * ray).extend(1.0)));
        let at = [(x / w + 1.0) / 2.0 * 65.0, (y / w + 1.0) / 2.0 * 41.0];
        assert!((at[0] - 9.5).abs() < 1e-9 && (at[1] - 7.5).abs() < 1e-9 && (w - 7.0).abs() < 1e-9);
    }

    #[test]
    fn boxes_out_of_view_are_culled() {
        let rows = [[50.0, 0.0, 50.0], [0.0, 50.0, 50.0], [0.0, 0.0, 1.0]];
        let camera = Camera::new("c", 100, 100, rows).unwrap();
        let view = View { camera, camera_from_world: DAffine3::IDENTITY };
        let lens = Lens::new(&view, &Tile { origin: [0, 0], size: [100, 100] });
        let clip = lens.clip_rows(&DAffine3::IDENTITY);
        let near = |x: f64, y: f64, z: f64| {
            let middle = DVec3::new(x, y, z);
            nearest_m(&clip, [middle - 1.0, middle + 1.0])
        };
        // The view is 45° wide to each side.
        assert_eq!(near(0.0, 0.0, 10.0), Some(9.0));
        assert_eq!(near(11.9, 0.0, 10.0), Some(9.0));
        assert_eq!(near(0.0, 0.0, 0.0), Some(-1.0));
        for (x, y, z) in
            [(12.5, 0.0, 10.0), (-12.5, 0.0, 10.0), (0.0, 12.5, 10.0), (0.0, -12.5, 10.0), (0.0, 0.0, -1.0)]
        {
            assert_eq!(near(x, y, z), None);
        }
    }
}
