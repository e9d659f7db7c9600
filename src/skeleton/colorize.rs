//! Coloring: one color per point, from the camera with the best view.
//!
//! # How it works
//! Every image whose frame lies within a window around a point's own frame is a candidate. The point is projected
//! into it at the image's own time (a point of an actor moves with its box) and tested against the image's
//! [`OcclusionMap`]. Each view that passes yields a [`ColorSample`]: the mean color over the pixels that the point covers
//! when splatted, and a weight that decreases with distance and time. The best view is the one that agrees most with
//! the others (weighted medoid of the colors). The other views thus outvote an error in one image: a wrong occlusion,
//! a passing car, or the sky behind a twig.

use glam::{DAffine3, DMat3, DVec2, DVec3};
use image::RgbImage;

use super::OcclusionMap;
use crate::geometry::{Lens, View};

/// Point to be colored.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Candidate {
    /// Position, meters: global for the background, box frame for actors.
    pub position: DVec3,
    /// Color, once assigned.
    pub rgb: Option<[u8; 3]>,
}

/// Image with the data required to color points from it.
pub(crate) struct ColorView {
    /// Image pixels.
    pub image: RgbImage,
    /// Camera and pose of the image.
    pub view: View,
    /// Time of the image, absolute microseconds.
    pub t_us: i64,
    /// Occlusion in the image; `None` disables the test.
    pub occlusion: Option<OcclusionMap>,
}

/// Color of a point in one view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ColorSample {
    /// Mean color.
    pub rgb: [u8; 3],
    /// Weight of the view: larger for views near in space and time.
    pub weight: f32,
}

impl ColorSample {
    /// Value of unused samples.
    pub(crate) const NONE: Self = Self { rgb: [0; 3], weight: 0.0 };
}

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

/// Depths (meters) and radii of the splats in the default schedule, for an image of [`SPLAT_WIDTH`] pixels.
const SPLATS: [(f64, f64); 2] = [(15.0, 2.0), (35.0, 1.0)];
const SPLAT_WIDTH: f64 = 1600.0;
/// Relative increase in distance that is equivalent to a second between sweep and image.
const TIME_WEIGHT: f64 = 0.3;

impl ColorView {
    /// Returns this view's color of a point at local meters; `None` outside the image and for an occluded point.
    /// `dt_s` is the time between the point's sweep and the image.
    pub(crate) fn look(&self, project: &Projector, position: DVec3, dt_s: f64) -> Option<ColorSample> {
        let (pixel, depth_m) = project.pixel(position)?;
        if self.occlusion.as_ref().is_some_and(|map| map.hides(pixel, depth_m)) {
            return None;
        }
        let weight = 1.0 / (depth_m * (1.0 + TIME_WEIGHT * dt_s.abs()));
        Some(ColorSample { rgb: self.mean_color(pixel, depth_m), weight: weight as f32 })
    }

    /// Returns the mean color over the pixels that a splat at this depth covers.
    fn mean_color(&self, pixel: DVec2, depth_m: f64) -> [u8; 3] {
        let splat = SPLATS.iter().find(|(z, _)| depth_m <= *z).map_or(0.0, |(_, radius)| *radius);
        let r = ((splat + 0.5) * f64::from(self.image.width()) / SPLAT_WIDTH).round() as i64;
        let range = |c: f64, side: u32| {
            let c = c as i64;
            (c - r).max(0) as usize..(c + r + 1).min(i64::from(side)) as usize
        };
        let columns = range(pixel.x, self.image.width());
        let width = self.image.width() as usize;
        let (mut sum, mut count) = ([0_u32; 3], 0);
        for row in range(pixel.y, self.image.height()) {
            let line =
                &self.image.as_raw()[(row * width + columns.start) * 3..(row * width + columns.end) * 3];
            for rgb in line.chunks_exact(3) {
                (0..3).for_each(|c| sum[c] += u32::from(rgb[c]));
            }
            count += columns.len() as u32;
        }
        sum.map(|s| ((s + count / 2) / count.max(1)) as u8)
    }
}

/// Returns the color of the look that agrees most with the others: the minimum weighted distance to all of them. Of
/// equal looks the one with the larger weight wins. `None` without looks.
pub(crate) fn agreed_color(looks: &[ColorSample]) -> Option<[u8; 3]> {
    let disagreement = |a: &ColorSample| -> f32 {
        let distance = |b: &ColorSample| (0..3).map(|c| f32::from(a.rgb[c].abs_diff(b.rgb[c]))).sum::<f32>();
        looks.iter().map(|b| b.weight * distance(b)).sum()
    };
    let scored = looks.iter().map(|look| (disagreement(look), look));
    let best = scored.min_by(|(a, x), (b, y)| a.total_cmp(b).then(y.weight.total_cmp(&x.weight)));
    best.map(|(_, look)| look.rgb)
}

/// Projection of local points into a recorded image.
pub struct Projector {
    /// Maps to pixels times depth; with a lens, to the camera frame.
    from_local: DAffine3,
    /// Lens distortion and intrinsics of the image.
    lens: Option<(Lens, DMat3)>,
    size: DVec2,
}

/// Minimum depth of colored points, meters.
const NEAREST_M: f64 = 0.1;

impl Projector {
    /// Creates a projector for points placed by `global_from_local`.
    pub fn new(view: &View, global_from_local: &DAffine3) -> Self {
        let intrinsics = view.camera.intrinsics;
        let lens = view.camera.distortion.map(|distortion| (distortion.lens(), intrinsics));
        let camera = if lens.is_some() { DAffine3::IDENTITY } else { DAffine3::from_mat3(intrinsics) };
        let size = DVec2::new(f64::from(view.camera.width), f64::from(view.camera.height));
        Self { from_local: camera * view.camera_from_world * *global_from_local, lens, size }
    }

    /// Returns whether [`Projector::pixel`] is `None` for all points within bounds; `false` if that is not certain.
    pub(crate) fn misses(&self, bounds: &Corners) -> bool {
        // Above rounding errors: 1e-5 at coordinates of 1e7 m and focal lengths of 1e4 pixels.
        const MARGIN: f64 = 1e-3;
        let corners = bounds.0.map(|corner| self.from_local.transform_point3(corner));
        // Each distance is linear in the point, so it is negative within the bounds if it is so at all corners.
        let beyond = |distance: &dyn Fn(DVec3) -> f64| corners.iter().all(|q| distance(*q) < -MARGIN);
        if beyond(&|q| q.z - NEAREST_M) {
            return true;
        }
        // With a lens, these are not pixels. Of points in front of the camera, a distance has the sign of the pixel's.
        let DVec2 { x: width, y: height } = self.size;
        self.lens.is_none()
            && (beyond(&|q| q.x)
                || beyond(&|q| q.y)
                || beyond(&|q| width * q.z - q.x)
                || beyond(&|q| height * q.z - q.y))
    }

    /// Returns pixel coordinates and camera depth in meters; `None` behind the camera and outside the image. Lens
    /// distortion is applied, so the pixel is that of the recorded image.
    pub fn pixel(&self, local: DVec3) -> Option<(DVec2, f64)> {
        let q = self.from_local.transform_point3(local);
        if q.z < NEAREST_M {
            return None;
        }
        let mut pixel = DVec2::new(q.x, q.y) / q.z;
        if let Some((lens, intrinsics)) = &self.lens {
            pixel = (*intrinsics * lens.distort(pixel)?.extend(1.0)).truncate();
        }
        (pixel.cmpge(DVec2::ZERO).all() && pixel.cmplt(self.size).all()).then_some((pixel, q.z))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Camera, Distortion};

    #[test]
    fn the_majority_outvotes_a_nearer_view() {
        let look = |grey: u8, weight| ColorSample { rgb: [grey; 3], weight };
        assert_eq!(agreed_color(&[]), None);
        assert_eq!(agreed_color(&[look(9, 0.1)]), Some([9; 3]));
        assert_eq!(agreed_color(&[look(9, 0.1), look(200, 0.2)]), Some([200; 3]));
        assert_eq!(agreed_color(&[look(200, 0.3), look(10, 0.2), look(12, 0.2)]), Some([12; 3]));
    }

    #[test]
    fn recorded_images_are_looked_at_through_their_lens() {
        let rows = [[700.0, 0.0, 800.0], [0.0, 705.0, 450.0], [0.0, 0.0, 1.0]];
        let pinhole = Camera::new("c", 1600, 900, rows).unwrap();
        let distortion = Distortion::from_opencv([-0.28, 0.071, 0.0011, -0.0007, -0.0079]);
        let camera = Camera { distortion, ..pinhole.clone() };
        let place = DAffine3::from_rotation_y(0.2) * DAffine3::from_translation(DVec3::new(3.0, 1.0, 2.0));
        let [bent, straight] =
            [camera, pinhole].map(|camera| View { camera, camera_from_world: place.inverse() });
        let project = [&bent, &straight].map(|view| Projector::new(view, &place));
        // At the edge of the image the lens moves a point inward by 100 pixels.
        let point = DVec3::new(6.0, 2.0, 5.5);
        let [(seen, depth_m), (ideal, _)] = [0, 1].map(|i| project[i].pixel(point).unwrap());
        assert!(seen.distance(ideal) > 100.0 && seen.x < ideal.x, "{seen} {ideal}");
        let (expected, z) = bent.project_recorded(place.transform_point3(point)).unwrap();
        assert!(seen.distance(expected) < 1e-9 && (depth_m - z).abs() < 1e-12);
        assert_eq!(straight.project_recorded(DVec3::ONE), straight.project(DVec3::ONE));
        // The image is colored by columns, so the color identifies the sampled column.
        let image = RgbImage::from_fn(1600, 900, |x, _| image::Rgb([(x / 10) as u8, 0, 0]));
        let view = ColorView { image, view: bent, t_us: 0, occlusion: None };
        let look = view.look(&project[0], point, 0.0).unwrap();
        assert!((f64::from(look.rgb[0]) - seen.x / 10.0).abs() < 1.0, "{look:?} {seen}");
        // Beyond the range where its distortion is monotonic, the lens yields no pixel, thus no ghost image.
        assert_eq!(project[0].pixel(DVec3::new(40.0, 0.0, 5.0)), None);
    }

    /// Boxes that are missed have no point with a pixel; most boxes without such points are missed.
    #[test]
    fn missed_bounds_have_no_pixels() {
        let rows = [[700.0, 0.0, 800.0], [0.0, 705.0, 450.0], [0.0, 0.0, 1.0]];
        let camera = Camera::new("c", 1600, 900, rows).unwrap();
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
        assert!(missed * 10 > empty * 9 && empty > 1000, "{missed} of {empty}");
    }

    #[test]
    fn a_color_is_the_mean_over_the_footprint() {
        let rows = [[100.0, 0.0, 20.0], [0.0, 100.0, 20.0], [0.0, 0.0, 1.0]];
        let camera = Camera::new("c", 1600, 40, rows).unwrap();
        let view = View { camera, camera_from_world: DAffine3::IDENTITY };
        let image = RgbImage::from_fn(1600, 40, |x, _| image::Rgb([if x < 20 { 0 } else { 70 }, 8, 9]));
        let color_view = ColorView { image, view, t_us: 0, occlusion: None };
        let project = Projector::new(&color_view.view, &DAffine3::IDENTITY);
        let at = |x: f64, z: f64| color_view.look(&project, DVec3::new(x, 0.0, z), 0.0).map(|l| l.rgb);
        // Pixel column 20: of 7 columns 17..=23 four are bright; far away, of 3 columns two.
        assert_eq!(at(0.0, 10.0), Some([40, 8, 9]));
        assert_eq!(at(0.0, 50.0), Some([47, 8, 9]));
        // Clipped at the border: columns 0..=5.
        assert_eq!(at(-1.75, 10.0), Some([0, 8, 9]));
        assert_eq!([at(-2.1, 10.0), at(158.1, 10.0), at(0.0, 0.05), at(0.0, -5.0)], [None; 4]);
    }
}
