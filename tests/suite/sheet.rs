//! The contact sheet of a small procedural street; the image remains in cargo's folder for test files.

use glam::{DMat3, DQuat, DVec3, Vec3};
use point_skeleton::cloud::{Cloud, Point};
use point_skeleton::conditions::view::sheet;
use point_skeleton::conditions::{BinScale, ConditionOptions, ConditionSet, DepthBins, render};
use point_skeleton::dataset::Class;
use point_skeleton::geometry::{Camera, Cuboid, Pose, View};
use point_skeleton::raster::Instance;
use point_skeleton::raster::reference::ReferenceRasterizer;
use point_skeleton::scene::{ActorState, SceneCamera, SceneInstances, SceneState};

/// Adds points of a parallelogram, slightly shaded by a fixed pattern.
fn patch(points: &mut Vec<Point>, corner: Vec3, [u, v]: [Vec3; 2], step_m: f32, rgb: [u8; 3], class: u8) {
    let (columns, rows) = ((u.length() / step_m) as u32 + 1, (v.length() / step_m) as u32 + 1);
    for i in 0..columns * rows {
        let (a, b) = ((i % columns) as f32 / columns as f32, (i / columns) as f32 / rows as f32);
        let shade = 0.8 + 0.2 * ((i.wrapping_mul(2_654_435_761) >> 24) as f32 / 255.0);
        let position = corner + u * a + v * b;
        points.push(Point::new(
            position.to_array(),
            rgb.map(|level| (f32::from(level) * shade) as u8),
            class,
        ));
    }
}

fn background() -> Vec<Point> {
    let mut points = Vec::new();
    let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
    patch(&mut points, Vec3::new(-60.0, -6.0, 0.0), [x * 120.0, y * 12.0], 0.15, [88, 90, 96], 0);
    for i in 0..12 {
        let at = Vec3::new(-60.0 + 10.0 * i as f32, -0.1, 0.01);
        patch(&mut points, at, [x * 4.0, y * 0.2], 0.05, [230, 230, 220], 0);
    }
    for side in [-1.0, 1.0] {
        patch(
            &mut points,
            Vec3::new(-60.0, 6.0 * side, 0.1),
            [x * 120.0, y * 4.0 * side],
            0.15,
            [128, 122, 112],
            0,
        );
        for i in 0..8_u8 {
            let corner = Vec3::new(-60.0 + 15.0 * f32::from(i), 10.0 * side, 0.0);
            let rgb = [140 + 13 * (i % 5), 150 - 15 * (i % 4), 90 + 20 * (i % 3)];
            patch(&mut points, corner, [x * 13.0, z * (6.0 + 2.0 * f32::from(i % 4))], 0.1, rgb, 0);
        }
    }
    points
}

/// Returns the faces of a box around its center.
fn body(size: Vec3, rgb: [u8; 3], class: Class) -> Vec<Point> {
    let mut points = Vec::new();
    let axes = [Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z];
    for face in 0..3 {
        let sides = [axes[(face + 1) % 3], axes[(face + 2) % 3]];
        for corner in [-size / 2.0, -size / 2.0 + axes[face]] {
            patch(&mut points, corner, sides, 0.04, rgb, class as u8);
        }
    }
    points
}

fn camera(name: &str, yaw_deg: f64, ego: Pose) -> SceneCamera {
    let axes = DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X);
    let rotation = DQuat::from_rotation_z(yaw_deg.to_radians()) * DQuat::from_mat3(&axes);
    let ego_from_camera = Pose { rotation, translation: DVec3::new(0.5, 0.0, 1.6) };
    let rows = [[630.0, 0.0, 400.0], [0.0, 630.0, 225.0], [0.0, 0.0, 1.0]];
    let camera_from_world = (ego * ego_from_camera).inverse().affine();
    let view = View { camera: Camera::new(name, 800, 450, rows).unwrap(), camera_from_world };
    SceneCamera { view, ego_from_camera: Some(ego_from_camera), global_from_ego: ego }
}

fn street() -> ConditionSet {
    let ego = Pose::from_yaw(0.0, DVec3::new(0.0, -2.0, 0.0));
    let kinds = [
        ("vehicle.car", Vec3::new(4.4, 1.9, 1.6), [190, 40, 40], DVec3::new(14.0, -2.0, 0.8)),
        ("vehicle.truck", Vec3::new(7.0, 2.4, 3.0), [225, 225, 215], DVec3::new(22.0, 3.0, 1.5)),
        ("vehicle.car", Vec3::new(4.4, 1.9, 1.6), [40, 80, 170], DVec3::new(-9.0, 2.5, 0.8)),
        ("human.pedestrian.adult", Vec3::new(0.6, 0.7, 1.8), [60, 130, 70], DVec3::new(8.0, -7.5, 1.0)),
        ("vehicle.bicycle", Vec3::new(1.8, 0.6, 1.5), [200, 160, 40], DVec3::new(6.0, 4.0, 0.8)),
        ("movable_object.trafficcone", Vec3::new(0.5, 0.5, 1.0), [240, 120, 20], DVec3::new(-7.0, -5.0, 0.6)),
    ];
    let mut clouds = vec![background()];
    let mut instances = vec![Instance { cloud: 0, world_from_local: glam::DAffine3::IDENTITY, number: 0 }];
    let mut actors = Vec::new();
    for (category, size, rgb, at) in kinds {
        let class = Class::from_category(category);
        let pose = Pose::from_yaw(0.05 * actors.len() as f64, at);
        clouds.push(body(size, rgb, class));
        let number = actors.len() as u32 + 1;
        instances.push(Instance { cloud: clouds.len() - 1, world_from_local: pose.affine(), number });
        let cuboid = Cuboid::new(pose, size.as_dvec3()).unwrap();
        let (track, category) = (format!("{number}"), category.into());
        actors.push(ActorState { track, category, class, cuboid, appearance: None });
    }
    let rig = [("FRONT", 0.0), ("FRONT_RIGHT", -55.0), ("BACK_RIGHT", -110.0)].into_iter();
    let rig = rig.chain([("BACK", 180.0), ("BACK_LEFT", 110.0), ("FRONT_LEFT", 55.0)]);
    let cameras = rig.map(|(name, yaw)| camera(&format!("CAM_{name}"), yaw, ego)).collect();
    let (name, map) = ("000000".into(), None);
    let state = SceneState { name, t_us: 0, global_from_ego: ego, cameras, actors, map };
    let scene = SceneInstances { color: instances.clone(), geometry: instances };
    let mut rasterizer = ReferenceRasterizer::new(clouds.iter().map(Cloud::from).collect());
    render(&mut rasterizer, &scene, &state, &ConditionOptions::default()).unwrap()
}

#[test]
fn renders_a_contact_sheet_of_a_street() {
    let set = street();
    let path = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("sheet.png");
    let bins = DepthBins { scale: BinScale::Log, far_m: 60.0, ..DepthBins::default() };
    sheet::write(&path, &set, &bins, "000000  procedural street").unwrap();
    let image = image::open(&path).unwrap().to_rgb8();
    assert_eq!(image.width(), 2 * 16 + 3 * 224 + 2 * 4);
    // Every actor is visible in some camera, in all maps.
    let numbers: std::collections::BTreeSet<u32> =
        set.cameras.iter().flat_map(|c| c.instance.as_ref().unwrap()).copied().collect();
    assert_eq!(numbers.into_iter().collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5, 6]);
    assert!(set.cameras.iter().any(|c| c.class.as_ref().unwrap().contains(&4)));
}
