//! The layout image: outlines of the actors' boxes.
//!
//! # How it works
//! Edges are clipped in camera space in `f64`, projected, and clipped to a rectangle that is larger than the image by
//! more than a line's width, so that the butt ends of clipped lines lie outside. What is left fits `f32` well and goes
//! to [`Rasterizer::lines`](crate::raster::Rasterizer::lines).

use glam::{DVec2, DVec3};

use crate::dataset::layout_rgb;
use crate::geometry::{Cuboid, View};
use crate::raster::Segment;
use crate::scene::ActorState;

/// Width of lines, pixels at camera size.
pub const LINE_WIDTH_PX: f32 = 8.0;
/// Nearest depth of box edges, metres.
pub const NEAR_M: f64 = 0.05;
/// Farthest depth of box edges, metres.
pub const BOXES_FAR_M: f64 = 512.0;

/// How far the clip rectangle reaches beyond the image, pixels.
const MARGIN_PX: f64 = 2.0 * LINE_WIDTH_PX as f64;

/// Pairs of [`Cuboid::corners`]: 12 edges, then the diagonals of the front and the left face from the lower front-left
/// corner. Bit 0 of a corner's index is front, bit 1 left, bit 2 up.
const BOX_LINES: [[usize; 2]; 14] = [
    [0, 1],
    [2, 3],
    [4, 5],
    [6, 7], // along x
    [0, 2],
    [1, 3],
    [4, 6],
    [5, 7], // along y
    [0, 4],
    [1, 5],
    [2, 6],
    [3, 7], // along z
    [3, 5],
    [3, 6],
];

/// Segments of all boxes in the order of the list, colored by category; categories without a color are not drawn.
pub fn box_segments(actors: &[ActorState], view: &View) -> Vec<Segment> {
    let drawn = actors.iter().filter_map(|actor| Some((&actor.cuboid, layout_rgb(&actor.category)?)));
    drawn.flat_map(|(cuboid, rgb)| cuboid_segments(cuboid, rgb, view)).collect()
}

fn cuboid_segments(cuboid: &Cuboid, rgb: [u8; 3], view: &View) -> Vec<Segment> {
    let corners = cuboid.corners().map(|corner| view.camera_from_world.transform_point3(corner));
    let line = |[a, b]: [usize; 2]| segment(corners[a], corners[b], [NEAR_M, BOXES_FAR_M], rgb, view);
    BOX_LINES.into_iter().filter_map(line).collect()
}

/// The visible part of a line between two points in camera coordinates (metres), in pixels; `None` where there is none.
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

/// The part of a line within two depths.
fn clip_depth(from: DVec3, to: DVec3, [near, far]: [f64; 2]) -> Option<(DVec3, DVec3)> {
    let along = to - from;
    let mut part = [0.0, 1.0];
    keep(&mut part, -along.z, from.z - near)?;
    keep(&mut part, along.z, far - from.z)?;
    Some((from + along * part[0], from + along * part[1]))
}

/// The part of a line within a rectangle (Liang and Barsky 1984).
fn clip_rectangle(from: DVec2, to: DVec2, min: DVec2, max: DVec2) -> Option<(DVec2, DVec2)> {
    let along = to - from;
    let mut part = [0.0, 1.0];
    for axis in 0..2 {
        keep(&mut part, -along[axis], from[axis] - min[axis])?;
        keep(&mut part, along[axis], max[axis] - from[axis])?;
    }
    Some((from + along * part[0], from + along * part[1]))
}

/// Cuts `part` down to where `s · step ≤ room`; `None` if nothing is left (also for NaN).
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
    use super::*;
    use crate::dataset::Class;
    use crate::geometry::{Camera, Pose};
    use glam::{DAffine3, DMat3, DQuat};

    /// A camera at the origin that looks along the world's x.
    fn view() -> View {
        let rows = [[500.0, 0.0, 400.0], [0.0, 500.0, 225.0], [0.0, 0.0, 1.0]];
        let camera = Camera::new("c", 800, 450, rows).unwrap();
        let world_from_camera = DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X);
        View { camera, camera_from_world: DAffine3::from_mat3(world_from_camera.transpose()) }
    }

    fn actor(category: &str, at: DVec3, yaw: f64) -> ActorState {
        let cuboid = Cuboid::new(Pose::from_yaw(yaw, at), DVec3::new(4.0, 2.0, 1.5)).unwrap();
        ActorState {
            track: "t".into(),
            category: category.into(),
            class: Class::from_category(category),
            cuboid,
        }
    }

    #[test]
    fn a_box_has_fourteen_lines_and_two_diagonals_from_the_lower_front_left_corner() {
        let actor = actor("vehicle.car", DVec3::new(20.0, 0.0, 0.0), 0.0);
        let segments = box_segments(std::slice::from_ref(&actor), &view());
        assert_eq!(segments.len(), 14);
        assert!(segments.iter().all(|s| s.rgb == [0, 0, 255]));
        // Lower front-left corner: x 22, y 1, z -0.75.
        let pixel = |x: f64, y: f64, z: f64| [(400.0 - 500.0 * y / x) as f32, (225.0 - 500.0 * z / x) as f32];
        for (segment, to) in segments[12..].iter().zip([pixel(22.0, -1.0, 0.75), pixel(18.0, 1.0, 0.75)]) {
            assert_eq!((segment.from, segment.to), (pixel(22.0, 1.0, -0.75), to));
        }
        let length = |s: &Segment| (s.from[0] - s.to[0]).hypot(s.from[1] - s.to[1]);
        assert!(segments.iter().all(|s| length(s) > 0.0));
    }

    #[test]
    fn lines_are_clipped_at_the_near_plane_and_beside_the_image() {
        let around = actor("vehicle.truck", DVec3::new(0.5, 0.0, 0.0), 0.0);
        let segments = box_segments(&[around], &view());
        assert!(!segments.is_empty() && segments.len() < 14);
        for p in segments.iter().flat_map(|s| [s.from, s.to]) {
            assert!((-16.1..=816.1).contains(&p[0]) && (-16.1..=466.1).contains(&p[1]), "{p:?}");
        }
        for hidden in [DVec3::new(-20.0, 0.0, 0.0), DVec3::new(20.0, 300.0, 0.0), DVec3::new(600.0, 0.0, 0.0)]
        {
            assert!(box_segments(&[actor("vehicle.car", hidden, 0.3)], &view()).is_empty(), "{hidden}");
        }
        assert!(box_segments(&[actor("movable_object.barrier", DVec3::X * 20.0, 0.0)], &view()).is_empty());
    }

    #[test]
    fn clipping_keeps_the_line_where_it_was() {
        let view = view();
        let (a, b) = (DVec3::new(-30.0, 2.0, -4.0), DVec3::new(5.0, 1.0, 60.0));
        let clipped = segment(a, b, [NEAR_M, BOXES_FAR_M], [1; 3], &view).unwrap();
        let end = view.camera.intrinsics * b / b.z;
        let direction = (DVec2::new(end.x, end.y)
            - DVec2::new(clipped.from[0].into(), clipped.from[1].into()))
        .normalize();
        // The vanishing line: the image of the whole line runs through the image of any of its points.
        let middle = view.camera.intrinsics * (a + (b - a) * 0.6);
        let middle = DVec2::new(middle.x, middle.y) / middle.z - DVec2::new(end.x, end.y);
        assert!(middle.perp_dot(direction).abs() < 1e-2, "{}", middle.perp_dot(direction));
        assert!(segment(a, DQuat::IDENTITY * a, [NEAR_M, BOXES_FAR_M], [1; 3], &view).is_none());
    }
}
