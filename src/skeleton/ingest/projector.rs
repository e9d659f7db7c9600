//! Projection of points into recorded images, one by one or many at a time.

use glam::{DAffine3, DVec2, DVec3};

use crate::geometry::{CameraProjection, View};
use crate::vectors::wide;

/// Corners of the axis-aligned box around points, meters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Corners([DVec3; 8]);

impl Corners {
    /// Returns the corners for some points.
    pub(crate) fn of(points: impl Iterator<Item = DVec3> + Clone) -> Self {
        let min = points.clone().fold(DVec3::INFINITY, DVec3::min);
        let max = points.fold(DVec3::NEG_INFINITY, DVec3::max);
        let side = |corner: usize, axis: usize| if corner >> axis & 1 == 0 { min[axis] } else { max[axis] };
        Self(std::array::from_fn(|corner| DVec3::new(side(corner, 0), side(corner, 1), side(corner, 2))))
    }
}

/// Projection of local points into a recorded image.
pub struct Projector {
    /// Maps to pixels times depth; with a lens, to the camera frame.
    from_local: DAffine3,
    /// Projection by a lens.
    lens: Option<CameraProjection>,
    /// Cosine of the largest angle between the axis and a ray in the image of a wide lens; at most 0. `None`
    /// for other lenses.
    wide_cos: Option<f64>,
    size: DVec2,
}

/// Minimum depth of colored points, meters.
const NEAREST_M: f64 = 0.1;

impl Projector {
    /// Creates a projector for points placed by `global_from_local`.
    pub fn new(view: &View, global_from_local: &DAffine3) -> Self {
        let lens = view.camera.lens.map(|_| view.camera.projection());
        let camera = match &lens {
            Some(_) => DAffine3::IDENTITY,
            None => DAffine3::from_mat3(view.camera.intrinsics),
        };
        let size = DVec2::new(f64::from(view.camera.width), f64::from(view.camera.height));
        let wide_cos = lens.as_ref().and_then(|projection| wide_cos(projection, size));
        Self { from_local: camera * view.camera_from_world * *global_from_local, lens, wide_cos, size }
    }

    /// Returns whether [`Projector::pixel`] is `None` for all points within bounds; `false` if that is not
    /// certain.
    pub(crate) fn misses(&self, bounds: &Corners) -> bool {
        // Above rounding errors: 1e-5 at coordinates of 1e7 m and focal lengths of 1e4 pixels.
        const MARGIN: f64 = 1e-3;
        let corners = bounds.0.map(|corner| self.from_local.transform_point3(corner));
        // Each distance is linear in the point, so it is negative within the bounds if it is so at all
        // corners.
        let beyond = |distance: &dyn Fn(DVec3) -> f64| corners.iter().all(|q| distance(*q) < -MARGIN);
        if let Some(cos) = self.wide_cos {
            // Behind a cone that widens backward, which is convex like a half space.
            return beyond(&|q| q.z - cos * q.length());
        }
        if beyond(&|q| q.z - NEAREST_M) {
            return true;
        }
        // With a lens, these are not pixels. Of points in front of the camera, a distance has the sign of the
        // pixel's.
        let DVec2 { x: width, y: height } = self.size;
        self.lens.is_none()
            && (beyond(&|q| q.x)
                || beyond(&|q| q.y)
                || beyond(&|q| width * q.z - q.x)
                || beyond(&|q| height * q.z - q.y))
    }

    /// Returns pixel coordinates and camera depth in meters; `None` behind the camera and outside the image.
    /// The lens is applied, so the pixel belongs to the recorded image. For a wide lens, which shows points
    /// beside and behind the camera too, the depth is the distance from the camera.
    pub fn pixel(&self, local: DVec3) -> Option<(DVec2, f64)> {
        let q = self.from_local.transform_point3(local);
        let depth_m = if self.wide_cos.is_some() { q.length() } else { q.z };
        if depth_m < NEAREST_M {
            return None;
        }
        let pixel = match &self.lens {
            None => DVec2::new(q.x, q.y) / q.z,
            Some(projection) => projection.pixel(q)?,
        };
        (pixel.cmpge(DVec2::ZERO).all() && pixel.cmplt(self.size).all()).then_some((pixel, depth_m))
    }
}

/// Returns the cosine of the largest angle between the axis and a ray that an image of a wide lens shows, at
/// most 0; `None` for other lenses.
fn wide_cos(projection: &CameraProjection, size: DVec2) -> Option<f64> {
    let lens = projection.lens().filter(|lens| lens.is_wide())?;
    // The radius grows with the angle, and no part of the image is farther from the axis than its corners.
    let corners = [DVec2::ZERO, size, DVec2::new(size.x, 0.0), DVec2::new(0.0, size.y)];
    let angle =
        |corner: DVec2| projection.ray(corner).map_or(lens.max_angle(), |ray| ray.angle_between(DVec3::Z));
    let widest = corners.into_iter().map(angle).fold(0.0, f64::max);
    Some(widest.cos().min(0.0))
}

/// Positions of points by coordinate, for loops over lanes.
#[derive(Clone, Debug, Default)]
pub(crate) struct PointColumns([Vec<f64>; 3]);

/// Pixels of points in an image.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pixels {
    x: Vec<f64>,
    y: Vec<f64>,
    depth_m: Vec<f64>,
    is_inside: Vec<bool>,
}

impl PointColumns {
    /// Replaces the points.
    pub(crate) fn set(&mut self, points: impl Iterator<Item = DVec3> + Clone) {
        for (axis, column) in self.0.iter_mut().enumerate() {
            column.clear();
            column.extend(points.clone().map(|point| point[axis]));
        }
    }
}

impl Pixels {
    /// Returns index, pixel coordinates and camera depth (meters) of the points with a pixel.
    pub(crate) fn iter(&self) -> impl Iterator<Item = (usize, DVec2, f64)> {
        let inside = self.is_inside.iter().enumerate().filter(|(_, is_inside)| **is_inside);
        inside.map(|(i, _)| (i, DVec2::new(self.x[i], self.y[i]), self.depth_m[i]))
    }

    fn resize(&mut self, count: usize) {
        self.x.resize(count, 0.0);
        self.y.resize(count, 0.0);
        self.depth_m.resize(count, 0.0);
        self.is_inside.resize(count, false);
    }
}

impl Projector {
    /// Computes [`Projector::pixel`] of many points, to the same bits.
    pub(crate) fn pixels(&self, points: &PointColumns, pixels: &mut Pixels) {
        let [x, y, z] = &points.0;
        pixels.resize(x.len());
        if self.lens.is_some() {
            for i in 0..x.len() {
                let found = self.pixel(DVec3::new(x[i], y[i], z[i]));
                pixels.is_inside[i] = found.is_some();
                let (pixel, depth_m) = found.unwrap_or_default();
                (pixels.x[i], pixels.y[i], pixels.depth_m[i]) = (pixel.x, pixel.y, depth_m);
            }
            return;
        }
        wide(
            #[inline(always)]
            || self.pinhole_pixels([x, y, z], pixels),
        );
    }

    /// Computes pixels without a lens, with the operation order of [`DAffine3::transform_point3`].
    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // loops over lanes: this form vectorizes
    fn pinhole_pixels(&self, [x, y, z]: [&[f64]; 3], pixels: &mut Pixels) {
        let (matrix, shift, size) = (self.from_local.matrix3, self.from_local.translation, self.size);
        let count = x.len();
        let (y, z) = (&y[..count], &z[..count]);
        let (us, vs, depths) = (&mut pixels.x[..count], &mut pixels.y[..count], &mut pixels.depth_m[..count]);
        let are_inside = &mut pixels.is_inside[..count];
        for i in 0..count {
            let along = |axis: usize| {
                matrix.x_axis[axis] * x[i]
                    + matrix.y_axis[axis] * y[i]
                    + matrix.z_axis[axis] * z[i]
                    + shift[axis]
            };
            let depth_m = along(2);
            let (u, v) = (along(0) / depth_m, along(1) / depth_m);
            are_inside[i] = (depth_m >= NEAREST_M) & (u >= 0.0) & (v >= 0.0) & (u < size.x) & (v < size.y);
            (us[i], vs[i], depths[i]) = (u, v, depth_m);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Camera, LensModel};

    fn camera() -> Camera {
        let rows = [[700.0, 0.0, 800.0], [0.0, 705.0, 450.0], [0.0, 0.0, 1.0]];
        Camera::new("c", 1600, 900, rows).unwrap()
    }

    /// A fisheye camera whose image shows rays up to 117 degrees from the axis.
    fn fisheye() -> Camera {
        let (distortion, projection) = ([0.0168, 1.65, 0.0, 0.0], [1336.0, 1336.0, 717.0, 706.0]);
        Camera::fisheye_mei("f", 1400, 1400, 2.21, distortion, projection).unwrap()
    }

    /// Pixels of many points equal the pixels of each, bit for bit, with and without a lens, also for points
    /// that are not finite.
    #[test]
    fn batch_projection_matches_single_points() {
        let lens = LensModel::from_opencv([-0.28, 0.071, 0.0011, -0.0007, -0.0079]);
        let place = DAffine3::from_rotation_y(0.2) * DAffine3::from_translation(DVec3::new(1e5, 1.0, 2.0));
        for camera in [camera(), Camera { lens, ..camera() }, fisheye()] {
            let view = View { camera, camera_from_world: place.inverse() };
            let project = Projector::new(&view, &place);
            let at = |i: i64, axis: i64| crate::hash::between(5, &[i, axis], -20.0, 20.0);
            let bad = [
                DVec3::NAN,
                DVec3::ZERO,
                DVec3::new(0.0, 0.0, f64::INFINITY),
                DVec3::new(0.0, 0.0, NEAREST_M),
            ];
            let points: Vec<DVec3> =
                (0..3001).map(|i| DVec3::new(at(i, 0), at(i, 1), at(i, 2))).chain(bad).collect();
            let mut columns = PointColumns::default();
            let mut pixels = Pixels::default();
            for count in [points.len(), 7, 0] {
                columns.set(points[points.len() - count..].iter().copied());
                project.pixels(&columns, &mut pixels);
                let each = points[points.len() - count..].iter().enumerate();
                let expected: Vec<_> =
                    each.filter_map(|(i, p)| project.pixel(*p).map(|(uv, z)| (i, uv, z))).collect();
                let bits = |all: &[(usize, DVec2, f64)]| -> Vec<_> {
                    all.iter().map(|(i, uv, z)| (*i, uv.x.to_bits(), uv.y.to_bits(), z.to_bits())).collect()
                };
                assert_eq!(bits(&pixels.iter().collect::<Vec<_>>()), bits(&expected));
                assert!(count < 3000 || expected.len() > 200);
            }
        }
    }

    /// Boxes that are missed have no point with a pixel; most boxes without such points are missed.
    #[test]
    fn missed_bounds_have_no_pixels() {
        check_missed_bounds(camera(), 9);
        check_missed_bounds(fisheye(), 5);
    }

    /// Checks that more than some tenths of the boxes without a point in the image are missed.
    fn check_missed_bounds(camera: Camera, tenths: usize) {
        let view = View { camera, camera_from_world: DAffine3::from_rotation_y(0.3) };
        let project = Projector::new(&view, &DAffine3::IDENTITY);
        let at = |i: i64, axis: i64| crate::hash::between(7, &[i, axis], -20.0, 20.0);
        let (mut missed, mut empty) = (0, 0);
        for i in 0..4000_i64 {
            let low = DVec3::new(at(i, 0), at(i, 1), at(i, 2));
            let size = DVec3::splat(0.2 + (i % 9) as f64);
            let point = |n: i64| low + size * DVec3::new(at(n, 3), at(n, 4), at(n, 5)).abs() / 20.0;
            let points: Vec<DVec3> = (0..50).map(|n| point(n * 4000 + i)).chain([low, low + size]).collect();
            let misses = project.misses(&Corners::of(points.iter().copied()));
            let is_empty = points.iter().all(|p| project.pixel(*p).is_none());
            assert!(is_empty || !misses);
            missed += usize::from(misses);
            empty += usize::from(is_empty);
        }
        assert!(missed * 10 > empty * tenths && empty > 800, "{missed} of {empty}");
    }
}
