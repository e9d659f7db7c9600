use glam::{DVec2, DVec3};

use super::{LayoutLayers, MARGIN_PX, NEAR_M, segment};
use crate::geometry::View;
use crate::raster::Segment;
use crate::scene::{MapEdge, MapLayer, SceneMap};

/// Maximum depth of map edges, meters.
pub(crate) const MAP_FAR_M: f64 = 65.0;

/// Allowance for rounding when a view's window is cut out of a map, meters.
const SLACK_M: f64 = 0.01;

/// Returns the color of a layer. Source: the condition contract, `docs/src/reference/maps.md`.
pub fn map_rgb(layer: MapLayer) -> [u8; 3] {
    match layer {
        MapLayer::Lane | MapLayer::Divider => [0, 255, 0],
        MapLayer::DrivableArea | MapLayer::Walkway => [0, 0, 255],
        MapLayer::Crossing => [255, 0, 0],
    }
}

/// Returns the outline segments of the map in drawing order, with widths relative to wide lines.
pub(crate) fn map_segments(map: &SceneMap, layers: LayoutLayers, view: &View) -> Vec<(Segment, f32)> {
    let [min, max] = window(view);
    let camera = |p: DVec3| view.camera_from_world.transform_point3(p);
    let line = |edge: MapEdge| {
        let width = layers.relative_width(edge.layer)?;
        let rgb = map_rgb(edge.layer);
        Some((segment(camera(edge.from), camera(edge.to), [NEAR_M, MAP_FAR_M], rgb, view)?, width))
    };
    map.edges_within(min, max).into_iter().filter_map(line).collect()
}

/// Returns a rectangle in global x and y that bounds everything [`segment`] can return: the bounding box of
/// the view's frustum corners, or the whole plane if the view has no finite frustum.
fn window(view: &View) -> [DVec2; 2] {
    let world_from_camera = view.camera_from_world.inverse();
    let camera_from_image = view.camera.intrinsics.inverse();
    let (width, height) = (f64::from(view.camera.width), f64::from(view.camera.height));
    let mut window = [DVec2::INFINITY, DVec2::NEG_INFINITY];
    for depth_m in [NEAR_M, MAP_FAR_M] {
        for x in [-MARGIN_PX, width + MARGIN_PX] {
            for y in [-MARGIN_PX, height + MARGIN_PX] {
                let corner = camera_from_image * DVec3::new(x, y, 1.0) * depth_m;
                let corner = world_from_camera.transform_point3(corner).truncate();
                if !corner.is_finite() {
                    return [DVec2::NEG_INFINITY, DVec2::INFINITY];
                }
                window = [window[0].min(corner), window[1].max(corner)];
            }
        }
    }
    [window[0] - SLACK_M, window[1] + SLACK_M]
}

#[cfg(test)]
mod tests {
    use super::super::tests::view;
    use super::*;
    use crate::dataset::{Area, Frame, Lane, Recording, VectorMap};
    use crate::geometry::Pose;
    use glam::{DAffine3, DQuat};

    /// Returns a map on flat ground, 2 m below the origin.
    fn scene_map(map: VectorMap, origin: DVec3) -> SceneMap {
        let (sweeps, images, between_images, boxes) = Default::default();
        let global_from_ego = Pose::from_yaw(0.0, origin + DVec3::new(0.0, 0.0, -2.0));
        let frame = Frame { t_us: 0, global_from_ego, sweeps, images, between_images, boxes };
        SceneMap::new(map, &Recording { frames: vec![frame], ..Recording::default() })
    }

    /// Returns the segments of lanes, drivable area and crossings, all wide.
    fn wide(map: &SceneMap, view: &View) -> Vec<Segment> {
        let segments = map_segments(map, LayoutLayers::Lanes, view).into_iter();
        segments.inspect(|(_, width)| assert_eq!(*width, 1.0)).map(|(segment, _)| segment).collect()
    }

    fn crossing(corners: &[[f64; 2]], origin: DVec3) -> VectorMap {
        let exterior = corners.iter().map(|c| origin.truncate() + DVec2::from(*c)).collect();
        let crossings = vec![Area { exterior, holes: Vec::new() }];
        VectorMap { crossings, ..VectorMap::default() }
    }

    #[test]
    fn outlines_end_at_both_clip_depths() {
        // One edge straight ahead, 1 m to the left, from behind the camera to beyond 65 m; the others are
        // behind it.
        let map = crossing(&[[-50.0, 1.0], [200.0, 1.0], [-50.0, 1.0]], DVec3::ZERO);
        let segments = wide(&scene_map(map, DVec3::ZERO), &view());
        // The edge is drawn in both directions; the edge from a point to itself is not drawn.
        assert_eq!(segments.len(), 2);
        let far = [400.0 - 500.0 / 65.0, 225.0 + 1000.0 / 65.0].map(|v: f64| v as f32);
        // The far end is clipped by depth, the near end by the rectangle that extends 16 px below the image.
        let depth = 1000.0 / (450.0 + 16.0 - 225.0);
        let near = [400.0 - 500.0 / depth, 466.0].map(|v: f64| v as f32);
        for (segment, [from, to]) in segments.iter().zip([[near, far], [far, near]]) {
            let off = |a: [f32; 2], b: [f32; 2]| (a[0] - b[0]).abs().max((a[1] - b[1]).abs());
            assert!(off(segment.from, from) < 1e-3 && off(segment.to, to) < 1e-3, "{segment:?}");
            assert_eq!(segment.rgb, [255, 0, 0]);
        }
        let beyond = crossing(&[[65.1, 1.0], [80.0, 1.0], [80.0, -1.0]], DVec3::ZERO);
        assert!(wide(&scene_map(beyond, DVec3::ZERO), &view()).is_empty());
    }

    #[test]
    fn window_contains_everything_visible() {
        // Random triangles at UTM coordinates, seen by cameras of random orientation.
        let origin = DVec3::new(600_000.0, 4_000_000.0, 30.0);
        let mut state = 3_u64;
        let mut number = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / (1 << 23) as f64 - 1.0
        };
        let mut map = VectorMap::default();
        for _ in 0..400 {
            let at = [number() * 150.0, number() * 150.0];
            let corners = [0; 3].map(|_| [at[0] + number() * 40.0, at[1] + number() * 40.0]);
            map.crossings.extend(crossing(&corners, origin).crossings);
        }
        let map = scene_map(map, origin);
        let mut found = 0;
        for _ in 0..40 {
            let turn = DQuat::from_euler(
                glam::EulerRot::ZYX,
                number() * std::f64::consts::PI,
                number() * 0.7,
                number() * 0.7,
            );
            let world_from_rig = DAffine3::from_rotation_translation(turn, origin);
            let view =
                View { camera_from_world: view().camera_from_world * world_from_rig.inverse(), ..view() };
            let camera = |p: DVec3| view.camera_from_world.transform_point3(p);
            let line = |e: &MapEdge| {
                segment(camera(e.from), camera(e.to), [NEAR_M, MAP_FAR_M], map_rgb(e.layer), &view)
            };
            let all: Vec<Segment> = map.edges().iter().filter_map(line).collect();
            assert_eq!(wide(&map, &view), all);
            let [min, max] = window(&view);
            let within = map.edges_within(min, max).len();
            assert!(within < map.edges().len() && within >= all.len());
            found += all.len();
        }
        assert!(found > 500, "{found}");
    }

    /// A walkway, a divider and a crossing ahead, each with one edge that is seen.
    #[test]
    fn layers_have_their_colors_and_widths() {
        let at = |x: f64| Area {
            exterior: [[x, -2.0], [x, 2.0], [-9.0, 0.0]].map(DVec2::from).to_vec(),
            holes: Vec::new(),
        };
        let (centerline, successors) = Default::default();
        let map = VectorMap {
            lanes: vec![Lane { id: "l".into(), outline: at(12.0), centerline, successors }],
            walkways: vec![at(14.0)],
            dividers: vec![[[10.0, 1.0], [20.0, 1.0], [30.0, 1.0]].map(DVec2::from).to_vec()],
            crossings: vec![at(16.0)],
            ..VectorMap::default()
        };
        let map = scene_map(map, DVec3::ZERO);
        let drawn = |layers| -> Vec<([u8; 3], f32)> {
            map_segments(&map, layers, &view()).iter().map(|(segment, width)| (segment.rgb, *width)).collect()
        };
        let of = |rgb, width, count| vec![(rgb, width); count];
        let (red, green, blue) = ([255, 0, 0], [0, 255, 0], [0, 0, 255]);
        assert_eq!(drawn(LayoutLayers::Lanes), [of(green, 1.0, 3), of(red, 1.0, 3)].concat());
        let expected = [of(blue, 1.0, 3), of(green, 0.5, 2), of(red, 1.0, 3)].concat();
        assert_eq!(drawn(LayoutLayers::Dividers), expected);
    }

    #[test]
    fn a_view_without_a_frustum_sees_the_whole_map() {
        let flat = View { camera_from_world: DAffine3::from_scale(DVec3::new(1.0, 1.0, 0.0)), ..view() };
        assert_eq!(window(&flat), [DVec2::NEG_INFINITY, DVec2::INFINITY]);
        let map = scene_map(crossing(&[[1.0, 0.0], [9.0, 0.0], [9.0, 4.0]], DVec3::ZERO), DVec3::ZERO);
        assert!(wide(&map, &flat).is_empty());
    }
}
