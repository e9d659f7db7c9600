//! Fisheye and wide lenses: projection compared with py123d, distorted maps, colors of points.

use std::sync::Arc;

use glam::{DAffine3, DVec2, DVec3};
use image::{Rgb, RgbImage};
use point_skeleton::cloud::Point;
use point_skeleton::cloud::cameras;
use point_skeleton::conditions::distort::{Distorter, uncovered};
use point_skeleton::conditions::write::meta::{FrameMeta, PromptParts};
use point_skeleton::conditions::{ConditionOptions, MapKind, MapSet, render};
use point_skeleton::dataset::{
    DatasetError, Frame, ImageRecord, LogReader, Recording, RigCamera, Sweep, SweepPoint, SweepRecord,
};
use point_skeleton::geometry::{Camera, LensModel, Mei, Pose, View};
use point_skeleton::raster::Instance;
use point_skeleton::raster::reference::ReferenceRasterizer;
use point_skeleton::scene::{SceneCamera, SceneInstances, SceneState};
use point_skeleton::skeleton::{BuildOptions, Projector};
use pskel_testing::shared::skeleton_of;
use pskel_testing::warped_log::{WarpedLog, covered};

#[derive(serde::Deserialize)]
struct Peers {
    cameras: Vec<PeerCamera>,
}

#[derive(serde::Deserialize)]
struct PeerCamera {
    name: String,
    width: u32,
    height: u32,
    mei: Option<PeerMei>,
    f_theta: Option<[f64; 14]>,
    points: Vec<[f64; 3]>,
    pixels: Vec<[f64; 2]>,
}

#[derive(serde::Deserialize)]
struct PeerMei {
    mirror_parameter: f64,
    distortion: [f64; 4],
    projection: [f64; 4],
}

impl PeerCamera {
    fn camera(&self) -> Camera {
        let (width, height) = (self.width, self.height);
        match (&self.mei, self.f_theta) {
            (Some(mei), None) => {
                let xi = mei.mirror_parameter;
                Camera::fisheye_mei("mei", width, height, xi, mei.distortion, mei.projection).unwrap()
            }
            (None, Some(calibration)) => Camera::f_theta("f-theta", width, height, calibration).unwrap(),
            _ => panic!("expected one model: {}", self.name),
        }
    }
}

#[test]
fn projected_points_match_py123d() {
    let peers: Peers = serde_json::from_str(include_str!("../peers/lenses.json")).unwrap();
    let (mut inside, mut behind) = (0, 0);
    for peer in peers.cameras {
        let view = View { camera: peer.camera(), camera_from_world: DAffine3::IDENTITY };
        let (projection, project) = (view.camera.projection(), Projector::new(&view, &DAffine3::IDENTITY));
        let size = DVec2::new(f64::from(peer.width), f64::from(peer.height));
        for (point, pixel) in peer.points.iter().zip(&peer.pixels) {
            let (point, expected) = (DVec3::from(*point), DVec2::from(*pixel));
            let (found, depth_m) = view.project_recorded(point).unwrap();
            assert!(found.distance(expected) < 1e-6 && depth_m == point.z, "{}: {point}", peer.name);
            let ray = projection.ray(expected).unwrap();
            assert!(ray.normalize().distance(point.normalize()) < 1e-6, "{}: {point} {ray}", peer.name);
            // The projection used for coloring agrees, and measures the distance instead of the depth.
            let in_image = expected.cmpge(DVec2::ZERO).all() && expected.cmplt(size).all();
            let colored = project.pixel(point);
            assert_eq!(colored.is_some(), in_image, "{}: {point}", peer.name);
            let Some((pixel, distance_m)) = colored else { continue };
            assert!(pixel.distance(expected) < 1e-6 && (distance_m - point.length()).abs() < 1e-9);
            inside += 1;
            behind += i32::from(point.z < 0.0);
        }
    }
    assert!(inside > 120 && behind > 20, "{inside} {behind}");
}

/// Returns a fisheye camera of 180 degrees and more, 90 pixels of focal length near the axis.
fn fisheye() -> Camera {
    let distortion = [0.0168, 1.6549, 0.0, 0.0];
    Camera::fisheye_mei("fisheye", 300, 300, 2.2134, distortion, [289.2, 289.2, 150.0, 151.0]).unwrap()
}

/// Returns an f-theta camera of 120 degrees at the axis of its longer side.
fn wide() -> Camera {
    let mut calibration = [0.0; 14];
    calibration[..8].copy_from_slice(&[100.0, 60.0, 0.0, 94.0, 0.5, -3.0, 0.2, 0.0]);
    Camera::f_theta("wide", 200, 120, calibration).unwrap()
}

/// Returns a wall 5 m ahead, with a point for each pixel of the largest pinhole image of [`fisheye`].
fn wall() -> Vec<Point> {
    const SIDE: usize = 1200;
    let view = fisheye().intrinsics.inverse();
    let point = |i: usize| {
        let pixel = DVec2::new((i % SIDE) as f64, (i / SIDE) as f64) - 450.0 + 0.5;
        Point::new((5.0 * (view * pixel.extend(1.0))).as_vec3().to_array(), [200, 90, 10], 1)
    };
    (0..SIDE * SIDE).map(point).collect()
}

fn state(cameras: impl IntoIterator<Item = Camera>) -> SceneState {
    let camera = |camera| SceneCamera {
        view: View { camera, camera_from_world: DAffine3::IDENTITY },
        ego_from_camera: None,
        global_from_ego: Pose::IDENTITY,
    };
    SceneState {
        name: "000000".into(),
        t_us: 0,
        global_from_ego: Pose::IDENTITY,
        cameras: cameras.into_iter().map(camera).collect(),
        actors: Vec::new(),
        map: None,
    }
}

/// Every pixel shows a point that the lens shows there, or is empty because its ray passes the largest
/// pinhole image: four times as large as the camera's.
#[test]
fn distorted_maps_show_what_a_pinhole_covers() {
    let state = state([fisheye(), wide()]);
    let points = wall();
    let (maps, splat) = (MapSet::of(&[MapKind::Point, MapKind::Depth]), "100:1".parse().unwrap());
    let options = ConditionOptions { maps, splat, ..ConditionOptions::default() };
    let step = Distorter::new(&options).unwrap().pinholes(&state, maps).unwrap();
    let mut rasterizer = ReferenceRasterizer::new(vec![(&points).into()]);
    let all = vec![Instance { cloud: 0, number: 1, world_from_local: DAffine3::IDENTITY }];
    let clouds = SceneInstances { color: all.clone(), geometry: all };
    let set = step.distort(render(&mut rasterizer, &clouds, &step.state, &step.options).unwrap());
    let mut empty = Vec::new();
    for (camera, maps) in state.cameras.iter().zip(&set.cameras) {
        let Camera { width, height, intrinsics, .. } = camera.view.camera;
        assert_eq!((maps.width, maps.height), (width, height));
        let projection = camera.view.camera.projection();
        let half = 2.0 * DVec2::new(f64::from(width), f64::from(height));
        let mut count = 0;
        for (pixel, number) in (0..).zip(maps.point.as_ref().unwrap()) {
            let center = DVec2::new(f64::from(pixel % width), f64::from(pixel / width)) + 0.5;
            let shown = projection.ray(center).filter(|ray| ray.z > 0.0);
            let at = shown.map(|ray| (intrinsics * (ray / ray.z)).truncate() - half / 4.0);
            let is_covered = at.is_some_and(|at| at.cmpge(-half).all() && at.cmplt(half).all());
            assert_eq!(*number > 0, is_covered, "{}: {center}", camera.view.camera.name);
            count += usize::from(!is_covered && projection.ray(center).is_some());
            let Some(index) = number.checked_sub(1) else { continue };
            let position = DVec3::from(points[index as usize].position.map(f64::from));
            let seen = camera.view.project_recorded(position).unwrap().0;
            // A splat of 3 x 3 pinhole pixels, which the lens shows no larger.
            assert!(seen.distance(center) < 2.6, "{}: {center} {seen}", camera.view.camera.name);
        }
        let share = count as f64 / f64::from(width * height);
        assert!((uncovered(&camera.view.camera) - share).abs() < 1e-12);
        empty.push(share);
    }
    assert_eq!(step.uncovered(), empty);
    assert!(empty[0] > 0.1 && empty[0] < 0.5 && empty[1] == 0.0, "{empty:?}");

    // Their metadata describe the lenses.
    let meta = FrameMeta::new(&state, &options, &PromptParts::default(), None).distorted(&state, &empty);
    let meta = serde_json::to_value(meta).unwrap();
    let [mei, f_theta] = [0, 1].map(|i| &meta["cameras"][i]["lens"]);
    assert_eq!(
        *mei,
        serde_json::json!({"model": "mei", "xi": 2.2134, "k1": 0.0168, "k2": 1.6549, "uncovered": empty[0]})
    );
    assert_eq!(f_theta["model"], "f_theta");
    assert_eq!(f_theta["polynomial"][3], -3.0 / 94.0);
}

#[test]
fn files_of_pinholes_refuse_lenses() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("c.json");
    let view = View { camera: fisheye(), camera_from_world: DAffine3::IDENTITY };
    let message = cameras::write(&path, &[view]).unwrap_err().to_string();
    assert!(message.starts_with("expected pinhole cameras, found a MEI lens of fisheye"), "{message}");
    assert!(!path.exists());
}

/// Room around a camera: a log with one frame, whose image shows a smooth texture by direction.
struct Room(Recording);

const SIDE: u32 = 400;

/// Returns the texture in a direction; its waves are 20 and more pixels long.
fn texture(ray: DVec3) -> [u8; 3] {
    let n = ray.normalize();
    [n.x, n.y, n.x + n.y].map(|at| (127.5 + 100.0 * (30.0 * at).sin()) as u8)
}

impl Room {
    fn new() -> Self {
        let f = f64::from(SIDE) * 0.5;
        let camera = Camera::new("C", SIDE, SIDE, [[f, 0.0, f], [0.0, f, f], [0.0, 0.0, 1.0]]).unwrap();
        let pose = Pose::IDENTITY;
        let image = ImageRecord {
            token: String::new(),
            channel: 0,
            path: "image".into(),
            row: None,
            t_us: 0,
            global_from_ego: pose,
            ego_from_camera: pose,
            camera: camera.clone().into(),
        };
        let sweep = SweepRecord {
            path: "sweep".into(),
            row: None,
            t_us: 0,
            global_from_ego: pose,
            ego_from_lidar: pose,
            is_key: true,
        };
        let frame = Frame {
            t_us: 0,
            global_from_ego: pose,
            sweeps: vec![sweep],
            images: vec![image],
            between_images: Vec::new(),
            boxes: Vec::new(),
        };
        Self(Recording {
            name: "room".into(),
            cameras: vec![camera.name.clone()],
            rig: vec![RigCamera { channel: 0, ego_from_camera: pose, camera }],
            frames: vec![frame],
            ..Recording::default()
        })
    }
}

impl LogReader for Room {
    fn recording(&self) -> &Recording {
        &self.0
    }

    fn read_sweep(&self, _: &SweepRecord) -> Result<Sweep, DatasetError> {
        let ray = |i: i32| DVec3::new(f64::from(i % 97) / 97.0 - 0.5, f64::from(i / 97) / 97.0 - 0.5, 0.5);
        let point =
            |ray: DVec3| SweepPoint { position: (9.0 * ray).as_vec3().to_array(), intensity: 9.0, ring: 7 };
        Ok(Sweep { points: (0..97 * 97).map(|i| point(ray(i))).collect(), ..Sweep::default() })
    }

    fn read_image(&self, record: &ImageRecord) -> Result<RgbImage, DatasetError> {
        let projection = record.camera.projection();
        let center = |x: u32, y: u32| DVec2::new(f64::from(x), f64::from(y)) + 0.5;
        let pixel = |x, y| Rgb(texture(projection.ray(center(x, y)).unwrap()));
        Ok(RgbImage::from_fn(SIDE, SIDE, pixel))
    }
}

/// Returns the PSNR of the colors of points against the texture, of points that a log's camera shows well
/// inside its image.
fn psnr(log: &dyn LogReader, shown: &Camera) -> f64 {
    let folder = tempfile::tempdir().unwrap();
    let skeleton = skeleton_of(folder.path(), log, &[0], &BuildOptions::default());
    let projection = shown.projection();
    let (mut squares, mut count) = (0.0, 0);
    let chunks = skeleton.manifest.background.iter().map(|chunk| DVec3::from(chunk.origin));
    let points = chunks.zip(skeleton.background().unwrap());
    for (origin, point) in points.flat_map(|(origin, points)| points.iter().map(move |p| (origin, p))) {
        let position = origin + DVec3::from(point.position.map(f64::from));
        let inside = projection.pixel(position).is_some_and(|pixel| {
            pixel.cmpge(DVec2::splat(20.0)).all() && pixel.cmplt(DVec2::splat(f64::from(SIDE) - 20.0)).all()
        });
        if inside {
            let off = |c: usize| f64::from(point.rgb()[c]) - f64::from(texture(position)[c]);
            squares += (0..3).map(|c| off(c).powi(2)).sum::<f64>() / 3.0;
            count += 1;
        }
    }
    assert!(count > 2500, "{count}");
    10.0 * (255.0_f64.powi(2) * f64::from(count) / squares).log10()
}

/// Points get the colors of images through other lenses as from the pinhole images that these are warped
/// from.
#[test]
fn points_are_colored_through_lenses() {
    let room: Arc<dyn LogReader> = Arc::new(Room::new());
    let lens = |lens: LensModel| WarpedLog::new(Arc::clone(&room), |camera| covered(camera, lens));
    let mei = lens(LensModel::Mei(Mei::new(2.2, [0.02, 1.6]).unwrap()));
    let f_theta = lens(wide().lens.unwrap());
    let narrow = &mei.recording().rig[0].camera;
    let [plain, by_mei, by_f_theta] = [&*room, &mei, &f_theta].map(|log| psnr(log, narrow));
    println!("PSNR: pinhole {plain:.2}, MEI {by_mei:.2}, f-theta {by_f_theta:.2} dB");
    assert!(plain > 20.0 && by_mei > plain - 0.3 && by_f_theta > plain - 0.3);
    // Read as pinhole images, the warped ones give other colors.
    let mut wrong = mei.recording().clone();
    Arc::make_mut(&mut wrong.frames[0].images[0].camera).lens = None;
    let blind = pskel_testing::shared::WithLog { drive: &mei, log: wrong };
    assert!(psnr(&blind, narrow) < plain - 3.0);
}
