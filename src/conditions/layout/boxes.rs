use super::{NEAR_M, segment};
use crate::dataset::layout_rgb;
use crate::geometry::{Cuboid, View};
use crate::raster::Segment;
use crate::scene::ActorState;

/// Maximum depth of box edges, meters.
pub(crate) const BOXES_FAR_M: f64 = 512.0;

/// Pairs of indices into [`Cuboid::corners`]: 12 edges, then the diagonals of the front and the left face
/// from the lower front-left corner. Bit 0 of an index is front, bit 1 left, bit 2 up.
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

/// Returns the segments of all boxes in list order, colored by category; skips categories without a color.
pub(crate) fn box_segments(actors: &[ActorState], view: &View) -> Vec<Segment> {
    let drawn = actors.iter().filter_map(|actor| Some((&actor.cuboid, layout_rgb(&actor.category)?)));
    drawn.flat_map(|(cuboid, rgb)| cuboid_segments(cuboid, rgb, view)).collect()
}

fn cuboid_segments(cuboid: &Cuboid, rgb: [u8; 3], view: &View) -> Vec<Segment> {
    let corners = cuboid.corners().map(|corner| view.camera_from_world.transform_point3(corner));
    let line = |[a, b]: [usize; 2]| segment(corners[a], corners[b], [NEAR_M, BOXES_FAR_M], rgb, view);
    BOX_LINES.into_iter().filter_map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::view;
    use super::*;
    use crate::dataset::Class;
    use crate::geometry::Pose;
    use glam::DVec3;

    fn actor(category: &str, at: DVec3, yaw: f64) -> ActorState {
        let cuboid = Cuboid::new(Pose::from_yaw(yaw, at), DVec3::new(4.0, 2.0, 1.5)).unwrap();
        ActorState {
            track: "t".into(),
            category: category.into(),
            class: Class::from_category(category),
            cuboid,
            appearance: None,
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
}
