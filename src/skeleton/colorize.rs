//! One color a point, from the camera with the best view.
//!
//! # How it works
//! Every image whose frame is within a window around a point's own frame is a candidate. The point is projected
//! into it at the image's own time (a point of an actor moves with its box), tested against the image's
//! [`OcclusionMap`], and the view with the lowest cost gives the color: the mean over the pixels that the point will
//! cover when it is splatted.

use glam::{DAffine3, DVec2, DVec3};
use image::RgbImage;

use super::{OcclusionMap, Sight};
use crate::geometry::View;

/// A point that looks for its color.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Metres: global for the background, box frame for actors.
    pub position: DVec3,
    /// The best color so far.
    pub rgb: [u8; 3],
    /// Cost of the view it came from; infinite without a color.
    pub cost: f32,
}

impl Candidate {
    /// Without a color yet.
    pub fn new(position: DVec3) -> Self {
        Self { position, rgb: [0; 3], cost: f32::INFINITY }
    }
}

/// An image with what it takes to color points from it.
pub struct ColorView {
    /// Pixels.
    pub image: RgbImage,
    /// Where it was taken.
    pub view: View,
    /// Absolute microseconds.
    pub t_us: i64,
    /// What hides what; `None` to believe every projection.
    pub occlusion: Option<OcclusionMap>,
}

/// Depths, metres, up to which a color is the mean over a square of so many pixels to each side.
const FOOTPRINTS: [(f64, i64); 2] = [(15.0, 2), (35.0, 1)];
/// Seeing an edge costs as much as this factor of distance.
const EDGE_COST: f32 = 4.0;

impl ColorView {
    /// The cost of the view that a point at `pixel` and a camera depth has, lower is better; `None` where it is not
    /// seen. `dt_s` is the time between the point's sweep and the image.
    pub fn cost(&self, pixel: DVec2, depth_m: f64, dt_s: f64) -> Option<f32> {
        let distance = depth_m as f32 * (1.0 + dt_s.abs() as f32);
        match self.occlusion.as_ref().map_or(Some(Sight::Clear), |map| map.sight(pixel, depth_m))? {
            Sight::Clear => Some(distance),
            Sight::Edge => Some(distance * EDGE_COST),
            Sight::Hidden => None,
        }
    }

    /// Offers this image to points; `global_from_local` places them at the image's time.
    pub fn offer(&self, points: &mut [Candidate], global_from_local: &DAffine3, dt_s: f64) {
        let project = Projector::new(&self.view, global_from_local);
        for point in points {
            let Some((pixel, depth_m)) = project.pixel(point.position) else { continue };
            let Some(cost) = self.cost(pixel, depth_m, dt_s) else { continue };
            if cost < point.cost {
                point.cost = cost;
                point.rgb = self.mean_color(pixel, depth_m);
            }
        }
    }

    /// The mean color over the pixels that a splat at this depth covers.
    fn mean_color(&self, pixel: DVec2, depth_m: f64) -> [u8; 3] {
        let r = FOOTPRINTS.iter().find(|(z, _)| depth_m <= *z).map_or(0, |(_, r)| *r);
        let (x, y) = (pixel.x as i64, pixel.y as i64);
        let range = |c: i64, side: u32| (c - r).max(0) as u32..(c + r + 1).min(i64::from(side)) as u32;
        let (mut sum, mut count) = ([0_u32; 3], 0);
        for row in range(y, self.image.height()) {
            for column in range(x, self.image.width()) {
                let rgb = self.image.get_pixel(column, row).0;
                (0..3).for_each(|c| sum[c] += u32::from(rgb[c]));
                count += 1;
            }
        }
        sum.map(|s| ((s + count / 2) / count.max(1)) as u8)
    }
}

/// Projects local points into an image.
pub struct Projector {
    image_from_local: DAffine3,
    size: DVec2,
}

impl Projector {
    /// For points placed by `global_from_local`.
    pub fn new(view: &View, global_from_local: &DAffine3) -> Self {
        let camera = DAffine3::from_mat3(view.camera.intrinsics);
        let size = DVec2::new(f64::from(view.camera.width), f64::from(view.camera.height));
        Self { image_from_local: camera * view.camera_from_world * *global_from_local, size }
    }

    /// Pixel coordinates and camera depth in metres; `None` behind the camera and outside the image.
    pub fn pixel(&self, local: DVec3) -> Option<(DVec2, f64)> {
        let q = self.image_from_local.transform_point3(local);
        if q.z < 0.1 {
            return None;
        }
        let pixel = DVec2::new(q.x, q.y) / q.z;
        (pixel.cmpge(DVec2::ZERO).all() && pixel.cmplt(self.size).all()).then_some((pixel, q.z))
    }
}
