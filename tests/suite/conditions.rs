//! Condition maps: resizing and bins compared with other implementations, render passes compared with the
//! contract.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};
use point_skeleton::cloud::{self, Cloud, Point};
use point_skeleton::conditions::{
    BinScale, CameraConditions, ConditionOptions, ConditionSet, DepthBins, ImageSize, MapKind, MapSet,
    Occlusion, reduce, render, render_views,
};
use point_skeleton::dataset::{Area, Class, Frame, Lane, Recording, VectorMap};
use point_skeleton::geometry::{Camera, Cuboid, Pose, View};
use point_skeleton::raster::Instance;
use point_skeleton::raster::reference::ReferenceRasterizer;
use point_skeleton::scene::{ActorState, SceneCamera, SceneInstances, SceneMap, SceneState};

use pskel_testing::parity::{Layout, assert_parity, differing};
use pskel_testing::{npz, shared as common};

#[derive(serde::Deserialize)]
struct Peers {
    cases: Vec<ResizeCase>,
    nearest_1600_448: Vec<u32>,
}

#[derive(serde::Deserialize)]
struct ResizeCase {
    from: [u32; 2],
    to: [u32; 2],
    nearest: Vec<u8>,
    linear: Vec<u8>,
    pil: Vec<u8>,
}

/// Returns the image of `tests/peers/resize.py`.
fn peer_image(size: ImageSize) -> Vec<[u8; 3]> {
    let level = |n: u64| {
        let mixed = (n * 2_654_435_761 + 12_345) % (1 << 32);
        if (n / 3).is_multiple_of(7) { 0 } else { ((mixed >> 13) % 256) as u8 }
    };
    (0..size.pixels() as u64).map(|p| [level(3 * p), level(3 * p + 1), level(3 * p + 2)]).collect()
}

#[test]
fn resizing_equals_opencv_and_pillow() {
    let peers: Peers = serde_json::from_str(include_str!("../peers/resize.json")).unwrap();
    for case in peers.cases {
        let size = |[height, width]: [u32; 2]| ImageSize { height, width };
        let (from, to) = (size(case.from), size(case.to));
        let image = peer_image(from);
        let what = format!("{from} to {to}");
        assert_eq!(reduce::nearest(&image, from, to).as_flattened(), case.nearest, "nearest {what}");
        assert_eq!(reduce::bilinear(&image, from, to).as_flattened(), case.linear, "linear {what}");
        assert_eq!(reduce::pil_bilinear(&image, from, to).as_flattened(), case.pil, "pil {what}");
    }
    let columns = reduce::nearest_indices(1600, 448);
    assert_eq!(columns, peers.nearest_1600_448);
    let plain = (0..448).map(|i| i * 1600 / 448);
    assert_eq!(columns.iter().zip(plain).filter(|(a, b)| **a != *b).count(), 15);
}

#[test]
fn fixture_bins_of_fixture_depth_are_equal() {
    let Some(fixtures) = common::fixtures("projection-pandaset") else { return };
    let path = fixtures.join("projection-pandaset/reduced.npz");
    let depth = npz::read::<f32>(&path, "depth").data;
    for (scale, name) in [(BinScale::Linear, "bins_linear"), (BinScale::Log, "bins_log")] {
        let bins = DepthBins { scale, far_m: 50.0, ..DepthBins::default() };
        let found: Vec<u16> = depth.iter().map(|d| bins.bin(*d)).collect();
        let expected = npz::read::<u16>(&path, name).data;
        let off = found.iter().zip(&expected).filter(|(a, b)| a != b).count();
        assert_eq!(off, 0, "{name}: {off} of {} differ", found.len());
    }
}

/// Returns a camera 1 m above the ego's origin that looks along its x axis.
fn scene_camera(name: &str, ego: Pose) -> SceneCamera {
    let axes = DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X);
    let ego_from_camera = Pose { rotation: glam::DQuat::from_mat3(&axes), translation: DVec3::Z };
    let rows = [[40.0, 0.0, 32.0], [0.0, 40.0, 18.0], [0.0, 0.0, 1.0]];
    let camera = Camera::new(name, 64, 36, rows).unwrap();
    let camera_from_world = (ego * ego_from_camera).inverse().affine();
    SceneCamera {
        view: View { camera, camera_from_world },
        ego_from_camera: Some(ego_from_camera),
        global_from_ego: ego,
    }
}

/// Returns a wall across the view at a distance, meters in the ego frame.
fn wall(distance_m: f32, half_width_m: f32, rgb: [u8; 3], class: u8) -> Vec<Point> {
    let steps = 60;
    let at = |i: i32| half_width_m * (i as f32 / steps as f32 * 2.0 - 1.0);
    let point = |i: i32| Point::new([distance_m, at(i % (steps + 1)), 1.0 + at(i / (steps + 1))], rgb, class);
    (0..(steps + 1) * (steps + 1)).map(point).collect()
}

/// An ego at large coordinates, a far wall, a car 8 m ahead and a near background wall that hides half of the
/// car.
struct Street {
    clouds: Vec<Vec<Point>>,
    instances: SceneInstances,
    state: SceneState,
}

fn street() -> Street {
    let ego = Pose::from_yaw(0.0, DVec3::new(600_000.0, 4_000_000.0, 50.0));
    let mut background = wall(20.0, 8.0, [0, 0, 200], 0);
    background.extend(wall(5.0, 0.5, [200, 0, 0], 0));
    let clouds = vec![background, wall(8.0, 1.5, [0, 200, 0], 1), wall(8.5, 1.5, [9, 9, 9], 1)];
    let instance = |cloud, number| Instance { cloud, number, world_from_local: ego.affine() };
    let instances = SceneInstances {
        color: vec![instance(0, 0), instance(1, 1)],
        geometry: vec![instance(0, 0), instance(2, 1)],
    };
    let center = ego.transform_point(DVec3::new(10.0, 0.0, 1.0));
    let actor = ActorState {
        track: "car".into(),
        category: "vehicle.car".into(),
        class: Class::MotorVehicle,
        cuboid: Cuboid::new(Pose { translation: center, ..ego }, DVec3::new(4.0, 3.0, 3.0)).unwrap(),
        appearance: None,
    };
    let state = SceneState {
        name: "000000".into(),
        t_us: 0,
        global_from_ego: ego,
        cameras: vec![scene_camera("CAM_FRONT", ego)],
        actors: vec![actor],
        map: None,
    };
    Street { clouds, instances, state }
}

impl Street {
    fn render(&self, options: &ConditionOptions) -> ConditionSet {
        let mut rasterizer = ReferenceRasterizer::new(self.clouds.iter().map(Cloud::from).collect());
        render(&mut rasterizer, &self.instances, &self.state, options).unwrap()
    }
}

const CENTER: usize = 18 * 64 + 32;
/// Pixel on the car, beside the near wall.
const BESIDE: usize = 18 * 64 + 40;

#[test]
fn color_and_geometry_come_from_their_clouds() {
    let set = street().render(&ConditionOptions::default());
    let maps = &set.cameras[0];
    let (color, depth) = (maps.color.as_ref().unwrap(), maps.depth_m.as_ref().unwrap());
    assert_eq!((color[CENTER], color[BESIDE]), ([200, 0, 0], [0, 200, 0]));
    assert_eq!((depth[CENTER], depth[BESIDE]), (5.0, 8.5));
    let (class, instance) = (maps.class.as_ref().unwrap(), maps.instance.as_ref().unwrap());
    assert_eq!((class[CENTER], instance[CENTER], class[BESIDE], instance[BESIDE]), (0, 0, 1, 1));
    let blue = maps.boxes.as_ref().unwrap().iter().filter(|p| **p == [0, 0, 255]).count();
    assert!(blue > 100, "{blue}");
    assert!(maps.point.is_none());
}

#[test]
fn actors_occlusion_shows_what_the_background_hides() {
    let options = ConditionOptions { occlusion: Occlusion::Actors, ..ConditionOptions::default() };
    let set = street().render(&options);
    let maps = &set.cameras[0];
    assert_eq!((maps.class.as_ref().unwrap()[CENTER], maps.instance.as_ref().unwrap()[CENTER]), (1, 1));
    assert_eq!(maps.depth_m.as_ref().unwrap()[CENTER], 5.0);
}

#[test]
fn sizes_radius_and_selection_are_applied() {
    let size = |height, width| Some(ImageSize { height, width });
    let options = ConditionOptions {
        maps: MapSet::of(&[MapKind::Depth, MapKind::Boxes]),
        size: size(72, 128),
        out_size: size(9, 16),
        radius_m: 6.0,
        ..ConditionOptions::default()
    };
    let set = street().render(&options);
    let maps = &set.cameras[0];
    assert_eq!((maps.height, maps.width, maps.boxes.as_ref().unwrap().len()), (9, 16, 144));
    assert!(maps.color.is_none() && maps.class.is_none() && maps.instance.is_none());
    let depth = maps.depth_m.as_ref().unwrap();
    // Within 6 m there is only the near wall.
    assert!(depth.iter().all(|d| *d == 5.0 || *d == f32::INFINITY) && depth.contains(&5.0));
}

#[test]
fn maps_do_not_depend_on_other_requested_maps() {
    let street = street();
    let maps = |instances: &SceneInstances, maps: &str| {
        let mut cpu = ReferenceRasterizer::new(street.clouds.iter().map(Cloud::from).collect());
        let options = ConditionOptions { maps: maps.parse().unwrap(), ..ConditionOptions::default() };
        render(&mut cpu, instances, &street.state, &options).unwrap().cameras.remove(0)
    };
    let geometry = street.instances.geometry.clone();
    let same = SceneInstances { color: geometry.clone(), geometry };
    for clouds in [&same, &street.instances] {
        let all = maps(clouds, "color,depth,class,instance,point");
        let (color, depth) = (maps(clouds, "color"), maps(clouds, "depth,point"));
        assert_eq!((&all.color, &all.depth_m, &all.point), (&color.color, &depth.depth_m, &depth.point));
        assert_eq!((&color.depth_m, &color.class, &depth.color), (&None, &None, &None));
        let class = maps(clouds, "class");
        assert_eq!((&all.class, &class.instance), (&class.class, &None));
    }
}

#[test]
fn moving_world_and_ego_together_changes_nothing() {
    let options = ConditionOptions::default();
    let set = street().render(&options);
    let mut moved = street();
    let offset = DVec3::new(-600_000.0, -4_000_000.0, -50.0);
    let shift = DAffine3::from_translation(offset);
    for instance in moved.instances.color.iter_mut().chain(&mut moved.instances.geometry) {
        instance.world_from_local = shift * instance.world_from_local;
    }
    moved.state.global_from_ego.translation += offset;
    moved.state.cameras[0] = scene_camera("CAM_FRONT", moved.state.global_from_ego);
    moved.state.actors[0].cuboid.pose.translation += offset;
    assert_eq!(moved.render(&options), set);
}

/// Returns a map whose areas start at given distances ahead of the ego, meters, and extend past the clip
/// range on all sides.
fn map_ahead(ego: Pose, [lane, drivable, hole, crossing]: [f64; 4]) -> SceneMap {
    let ring = |from: f64| {
        let corners = [[from, 110.0], [from, -110.0], [100.0, -110.0], [100.0, 110.0]];
        corners.map(|[x, y]| ego.transform_point(DVec3::new(x, y, 0.0)).truncate()).to_vec()
    };
    let area = |from: f64| Area { exterior: ring(from), holes: Vec::new() };
    let (centerline, successors) = Default::default();
    let map = VectorMap {
        lanes: vec![Lane { id: "l".into(), outline: area(lane), centerline, successors }],
        drivable_area: vec![Area { exterior: ring(drivable), holes: vec![ring(hole)] }],
        crossings: vec![area(crossing)],
        ..VectorMap::default()
    };
    let (sweeps, images, between_images, boxes) = Default::default();
    let frame = Frame { t_us: 0, global_from_ego: ego, sweeps, images, between_images, boxes };
    SceneMap::new(map, &Recording { frames: vec![frame], ..Recording::default() })
}

#[test]
fn map_layouts_have_the_colors_of_the_contract_row_by_row() {
    let mut street = street();
    let maps = MapSet::of(&[MapKind::Map]);
    let options = ConditionOptions { maps, ..ConditionOptions::default() };
    let map = map_ahead(street.state.global_from_ego, [20.0, 10.0, 2.5, 5.0]);
    street.state.map = Some(Arc::new(map));
    let set = street.render(&options);
    assert!(set.cameras[0].boxes.is_none() && set.cameras[0].color.is_none());
    // The camera is 1 m up: a line x meters ahead is 40 / x rows below row 18, and extends 4 px to either
    // side. The drivable area's line at row 22 is drawn over the lane's at row 20, and the crossing's at row
    // 26 over both; the hole's line at row 34 does not overlap them.
    let (green, blue, red) = ([0, 255, 0], [0, 0, 255], [255, 0, 0]);
    let row = |row: usize| match row {
        0..16 => [0; 3],
        16..18 => green,
        18..22 => blue,
        22..30 => red,
        _ => blue,
    };
    let expected: Vec<[u8; 3]> = (0..36 * 64).map(|pixel| row(pixel / 64)).collect();
    assert_eq!(set.cameras[0].map.as_ref(), Some(&expected));
    // Reduced by an integer factor, the result equals Pillow's.
    let out_size = Some(ImageSize { height: 9, width: 16 });
    let reduced = street.render(&ConditionOptions { out_size, ..options.clone() });
    let (from, to) = (ImageSize { height: 36, width: 64 }, ImageSize { height: 9, width: 16 });
    assert_eq!(reduced.cameras[0].map, Some(reduce::pil_bilinear(&expected, from, to)));
    street.state.map = None;
    let mut rasterizer = ReferenceRasterizer::new(street.clouds.iter().map(Cloud::from).collect());
    let error = render(&mut rasterizer, &street.instances, &street.state, &options).unwrap_err().to_string();
    assert!(error.contains("expected an HD map") && error.contains("step 000000"), "{error}");
}

#[test]
fn fixture_full_size_maps_agree_with_the_reference() {
    let Some(fixtures) = common::fixtures("projection-pandaset") else { return };
    let fixture = fixtures.join("projection-pandaset");
    let points = cloud::read(&fixture.join("points.npy")).unwrap().points;
    let views = cloud::cameras::read(&fixture.join("cameras.json")).unwrap();
    let (actors, background): (Vec<Point>, Vec<Point>) = points.into_iter().partition(|p| p.class() > 0);
    let instance = |cloud, number| Instance { cloud, number, world_from_local: DAffine3::IDENTITY };
    let both = vec![instance(0, 0), instance(1, 1)];
    let clouds = SceneInstances { color: both.clone(), geometry: both };
    let mut rasterizer = ReferenceRasterizer::new(vec![(&background).into(), (&actors).into()]);
    let mut maps = |occlusion| -> Vec<CameraConditions> {
        let options = ConditionOptions { occlusion, ..ConditionOptions::default() };
        let views = [1, 4].map(|view: usize| views[view].clone());
        render_views(&mut rasterizer, &clouds, &views, None, &options).unwrap()
    };
    let expected = fixture.join("full.npz");
    let layout = Layout { height: 900, width: 1600, channels: 1, border: 3 };
    let scene = maps(Occlusion::Scene);
    let depth: Vec<f32> = scene.iter().flat_map(|c| c.depth_m.clone().unwrap()).collect();
    let reference = npz::read::<f32>(&expected, "depth").data;
    let off = |a: f32, b: f32| if a.is_infinite() { b != -300.0 } else { (a - b).abs() > 0.002 };
    assert_parity("full depth", differing(&depth, &reference, layout, off), 1e-4);
    let color: Vec<[u8; 3]> = scene.iter().flat_map(|c| c.color.clone().unwrap()).collect();
    let reference = npz::read::<u8>(&expected, "color").data;
    let rgb = Layout { channels: 3, ..layout };
    assert_parity("full color", differing(color.as_flattened(), &reference, rgb, |a, b| a != b), 1e-4);
    for (name, maps) in [("class_scene", scene), ("class_actors", maps(Occlusion::Actors))] {
        let class: Vec<u8> = maps.iter().flat_map(|c| c.class.clone().unwrap()).collect();
        let reference = npz::read::<u8>(&expected, name).data;
        assert_parity(name, differing(&class, &reference, layout, |a, b| a != b), 1e-4);
    }
}
