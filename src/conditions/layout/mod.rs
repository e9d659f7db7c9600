//! Layout images: outlines of the actors' boxes (`boxes`) and of the HD map (`map`).
//!
//! # How it works
//! Edges are clipped in camera space in `f64`, projected, and clipped to a rectangle that exceeds the image
//! by more than the line width, so that the butt ends of clipped lines lie outside it. The result fits `f32`
//! without visible loss. It is drawn by `raster::LineRows` and reduced row by row, so no full-size image is
//! allocated.

mod boxes;
mod draw;
mod map;
mod style;

pub(crate) use boxes::box_segments;
pub(crate) use draw::{Layouts, draw};
pub use map::map_rgb;
pub(crate) use map::map_segments;
pub use style::{LayoutLayers, LayoutStyle, LineWidth};

use glam::{DVec2, DVec3};

use crate::geometry::View;
use crate::raster::Segment;

/// Width of the lines, pixels: at render size, or at the camera's own size if it is scaled.
pub(crate) const LINE_WIDTH_PX: f32 = 8.0;
/// Minimum depth of edges, meters.
pub const NEAR_M: f64 = 0.05;

/// Margin of the clip rectangle around the image, pixels.
const MARGIN_PX: f64 = 2.0 * LINE_WIDTH_PX as f64;

/// Clips and projects a line between two points in camera coordinates (meters); `None` if no part of it is
/// visible.
pub fn segment(from: DVec3, to: DVec3, depths_m: [f64; 2], rgb: [u8; 3], view: &View) -> Option<Segment> {
    let (from, to) = clip_depth(from, to, depths_m)?;
    let project = |p: DVec3| {
        let q = view.camera.intrinsics * p;
        DVec2::new(q.x, q.y) / q.z
    };
    let size = DVec2::new(f64::from(view.camera.width), f64::from(view.camera.height));
    let (from, to) = clip_rectangle(project(from), project(to), DVec2::splat(-MARGIN_PX), size + MARGIN_PX)?;
    let pixel = |p: DVec2| [p.x as f32, p.y as f32];
    Some(Segment { from: pixel(from), to: pixel(to), rgb })
}

/// Clips a line to a depth range.
fn clip_depth(from: DVec3, to: DVec3, [near, far]: [f64; 2]) -> Option<(DVec3, DVec3)> {
    let along = to - from;
    let mut part = [0.0, 1.0];
    keep(&mut part, -along.z, from.z - near)?;
    keep(&mut part, along.z, far - from.z)?;
    Some((from + along * part[0], from + along * part[1]))
}

/// Clips a line to a rectangle (Liang and Barsky 1984).
fn clip_rectangle(from: DVec2, to: DVec2, min: DVec2, max: DVec2) -> Option<(DVec2, DVec2)> {
    let along = to - from;
    let mut part = [0.0, 1.0];
    for axis in 0..2 {
        keep(&mut part, -along[axis], from[axis] - min[axis])?;
        keep(&mut part, along[axis], max[axis] - from[axis])?;
    }
    Some((from + along * part[0], from + along * part[1]))
}

/// Shrinks the parameter range `part` to where `s · step ≤ room`; `None` if it becomes empty (also for NaN).
fn keep([start, end]: &mut [f64; 2], step: f64, room: f64) -> Option<()> {
    if step < 0.0 {
        *start = start.max(room / step);
    } else if step > 0.0 {
        *end = end.min(room / step);
    } else if !(step == 0.0 && room >= 0.0) {
        return None;
    }
    (*start <= *end).then_some(())
}

#[cfg(test)]
mod tests {
    use super::boxes::BOXES_FAR_M;
    use super::*;
    use crate::geometry::Camera;
    use glam::{DAffine3, DMat3, DQuat};

    /// Camera at the origin that looks along the world's x axis.
    pub(super) fn view() -> View {
        let rows = [[500.0, 0.0, 400.0], [0.0, 500.0, 225.0], [0.0, 0.0, 1.0]];
        let camera = Camera::new("c", 800, 450, rows).unwrap();
        let world_from_camera = DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X);
        View { camera, camera_from_world: DAffine3::from_mat3(world_from_camera.transpose()) }
    }

    #[test]
    fn clipping_preserves_the_line() {
        let view = view();
        let (a, b) = (DVec3::new(-30.0, 2.0, -4.0), DVec3::new(5.0, 1.0, 60.0));
        let clipped = segment(a, b, [NEAR_M, BOXES_FAR_M], [1; 3], &view).unwrap();
        let end = view.camera.intrinsics * b / b.z;
        let direction = (DVec2::new(end.x, end.y)
            - DVec2::new(clipped.from[0].into(), clipped.from[1].into()))
        .normalize();
        // Projection preserves lines: the image of the line passes through the image of any point on it.
        let middle = view.camera.intrinsics * (a + (b - a) * 0.6);
        let middle = DVec2::new(middle.x, middle.y) / middle.z - DVec2::new(end.x, end.y);
        assert!(middle.perp_dot(direction).abs() < 1e-2, "{}", middle.perp_dot(direction));
        assert!(segment(a, DQuat::IDENTITY * a, [NEAR_M, BOXES_FAR_M], [1; 3], &view).is_none());
    }
}
