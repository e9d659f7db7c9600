//! Lens distortion compared with OpenCV, and distorted maps.

use glam::{DAffine3, DVec2, DVec3};
use point_skeleton::cloud::Point;
use point_skeleton::conditions::distort::Distorter;
use point_skeleton::conditions::{
    ColorFilter, ConditionError, ConditionOptions, ConditionSet, ImageSize, MapKind, MapSet, render,
};
use point_skeleton::dataset::Class;
use point_skeleton::geometry::{Camera, Cuboid, LensModel, Pose, View};
use point_skeleton::raster::Instance;
use point_skeleton::raster::reference::ReferenceRasterizer;
use point_skeleton::scene::{ActorState, SceneCamera, SceneInstances, SceneState};
use point_skeleton::skeleton::Projector;

#[derive(serde::Deserialize)]
struct Peers {
    cameras: Vec<PeerCamera>,
}

#[derive(serde::Deserialize)]
struct PeerCamera {
    name: String,
    width: u32,
    height: u32,
    intrinsics: [[f64; 3]; 3],
    distortion: [f64; 5],
    points: Vec<[f64; 3]>,
    pixels: Vec<[f64; 2]>,
}

#[test]
fn projected_points_match_opencv() {
    const ALLOWED_PX: f64 = 1e-8;
    let peers: Peers = serde_json::from_str(include_str!("../peers/distortion.json")).unwrap();
    for peer in peers.cameras {
        let lens = LensModel::from_opencv(peer.distortion);
        let camera = Camera::new(&peer.name, peer.width, peer.height, peer.intrinsics).unwrap();
        let camera = Camera { lens, ..camera };
        let view = View { camera, camera_from_world: DAffine3::IDENTITY };
        let project = Projector::new(&view, &DAffine3::IDENTITY);
        let size = DVec2::new(f64::from(peer.width), f64::from(peer.height));
        let (mut farthest, mut moved, mut inside) = (0.0_f64, 0.0_f64, 0);
        for (point, pixel) in peer.points.iter().zip(&peer.pixels) {
            let (point, expected) = (DVec3::from(*point), DVec2::from(*pixel));
            let (found, depth_m) = view.project_recorded(point).unwrap();
            assert_eq!(depth_m, point.z);
            farthest = farthest.max(found.distance(expected));
            moved = moved.max(view.project(point).unwrap().0.distance(expected));
            // The projection used for coloring agrees, and rejects points outside the image.
            let in_image = expected.cmpge(DVec2::ZERO).all() && expected.cmplt(size).all();
            let found = project.pixel(point).map(|(pixel, _)| pixel);
            assert_eq!(found.is_some(), in_image, "{}: {point}", peer.name);
            inside += usize::from(in_image);
            farthest = farthest.max(found.map_or(0.0, |found| found.distance(expected)));
        }
        println!("{}: {farthest:.1e} px off, {moved:.0} px moved, {inside} inside", peer.name);
        assert!(farthest < ALLOWED_PX, "{}: {farthest} px", peer.name);
        assert!(moved > 10.0 && inside > 30, "{}: {moved} px, {inside} inside", peer.name);
    }
}

const BARREL: [f64; 5] = [-0.28, 0.071, 0.0011, -0.0007, -0.0079];
const BUMP: [f64; 5] = [0.18, -0.05, -0.004, 0.006, 0.012];

/// Returns a camera at the origin that looks along z.
fn view(name: &str, coefficients: [f64; 5]) -> View {
    let rows = [[90.0, 0.0, 81.0], [0.0, 91.0, 44.0], [0.0, 0.0, 1.0]];
    let camera = Camera::new(name, 160, 90, rows).unwrap();
    let camera = Camera { lens: LensModel::from_opencv(coefficients), ..camera };
    View { camera, camera_from_world: DAffine3::IDENTITY }
}

/// A wall 5 m ahead with more points than pixels, and an actor's box in front of it.
struct Wall {
    points: Vec<Point>,
    state: SceneState,
}

fn wall(views: Vec<View>) -> Wall {
    const SIDE: usize = 700;
    let at = |i: usize| 30.0 * (i as f32 / SIDE as f32 - 0.5);
    let point = |i: usize| {
        let rgb = [(i % SIDE / 4) as u8 + 20, (i / SIDE / 4) as u8 + 20, 90];
        Point::new([at(i % SIDE), at(i / SIDE), 5.0], rgb, (i % 3) as u8)
    };
    let camera = |view: View| SceneCamera { view, ego_from_camera: None, global_from_ego: Pose::IDENTITY };
    let place = Pose { translation: DVec3::new(-2.5, -1.0, 4.0), ..Pose::IDENTITY };
    let actor = ActorState {
        track: "car".into(),
        category: "vehicle.car".into(),
        class: Class::MotorVehicle,
        cuboid: Cuboid::new(place, DVec3::new(2.0, 1.0, 1.0)).unwrap(),
        appearance: None,
    };
    let state = SceneState {
        name: "000000".into(),
        t_us: 0,
        global_from_ego: Pose::IDENTITY,
        cameras: views.into_iter().map(camera).collect(),
        actors: vec![actor],
        map: None,
    };
    Wall { points: (0..SIDE * SIDE).map(point).collect(), state }
}

fn options(maps: &[MapKind]) -> ConditionOptions {
    let (maps, splat) = (MapSet::of(maps), "100:0".parse().unwrap());
    ConditionOptions { maps, splat, ..ConditionOptions::default() }
}

impl Wall {
    fn render(&self, state: &SceneState, options: &ConditionOptions) -> ConditionSet {
        let mut rasterizer = ReferenceRasterizer::new(vec![(&self.points).into()]);
        let all = vec![Instance { cloud: 0, number: 1, world_from_local: DAffine3::IDENTITY }];
        let clouds = SceneInstances { color: all.clone(), geometry: all };
        render(&mut rasterizer, &clouds, state, options).unwrap()
    }

    fn distorted(&self, options: &ConditionOptions) -> ConditionSet {
        let step = Distorter::new(options).unwrap().pinholes(&self.state, options.maps).unwrap();
        step.distort(self.render(&step.state, &step.options))
    }
}

/// Returns the maximum distance between a pixel's center and the projection of the point it shows, and the
/// number of empty pixels.
fn farthest_px(wall: &Wall, camera: usize, set: &ConditionSet) -> (f64, usize) {
    let view = &wall.state.cameras[camera].view;
    let camera = &set.cameras[camera];
    let view = View { camera: view.camera.resized(camera.height, camera.width), ..*view };
    let (points, width) = (camera.point.as_ref().unwrap(), camera.width);
    let (mut farthest, mut empty) = (0.0_f64, 0);
    for (pixel, number) in (0..).zip(points) {
        let Some(index) = number.checked_sub(1) else {
            empty += 1;
            continue;
        };
        let position = DVec3::from(wall.points[index as usize].position.map(f64::from));
        let center = DVec2::new(f64::from(pixel % width), f64::from(pixel / width)) + 0.5;
        let seen = view.project_recorded(position).unwrap().0;
        farthest = farthest.max(seen.distance(center));
    }
    (farthest, empty)
}

#[test]
fn distorted_maps_show_points_where_the_lens_does() {
    let wall = wall(vec![view("barrel", BARREL), view("bump", BUMP), view("pinhole", [0.0; 5])]);
    let options = options(&[MapKind::Point, MapKind::Color, MapKind::Depth, MapKind::Class, MapKind::Boxes]);
    let set = wall.distorted(&options);
    for (index, camera) in set.cameras.iter().enumerate() {
        assert_eq!((camera.height, camera.width), (90, 160));
        let (farthest, empty) = farthest_px(&wall, index, &set);
        println!("{}: {farthest:.2} px, {empty} empty", camera.name);
        // A point lies somewhere in the pinhole pixel that the ray hits; the splat enlarges it.
        assert!(farthest < 1.6 && empty == 0, "{}: {farthest} px, {empty} empty", camera.name);
        for (pixel, number) in camera.point.as_ref().unwrap().iter().enumerate() {
            let point = wall.points[*number as usize - 1];
            assert_eq!(camera.color.as_ref().unwrap()[pixel], point.rgb());
            assert_eq!(camera.class.as_ref().unwrap()[pixel], point.class());
            assert_eq!(camera.depth_m.as_ref().unwrap()[pixel], 5.0);
        }
    }
    // Without distortion the check fails as it must, and the pinhole camera's maps are the usual ones.
    let plain = wall.render(&wall.state, &options);
    assert!(farthest_px(&wall, 0, &plain).0 > 10.0 && farthest_px(&wall, 1, &plain).0 > 5.0);
    assert_eq!(set.cameras[2], plain.cameras[2]);
}

/// Returns the center of the drawn pixels' bounding box, pixels.
fn middle(image: &[[u8; 3]], width: u32) -> DVec2 {
    let drawn = (0_u32..).zip(image).filter(|(_, rgb)| **rgb != [0; 3]).map(|(i, _)| [i % width, i / width]);
    let [mut low, mut high] = [[u32::MAX; 2], [0; 2]];
    drawn.for_each(|at| (0..2).for_each(|k| (low[k], high[k]) = (low[k].min(at[k]), high[k].max(at[k]))));
    DVec2::new(f64::from(low[0] + high[0] + 1), f64::from(low[1] + high[1] + 1)) / 2.0
}

#[test]
fn boxes_are_distorted_like_points() {
    let mut wall = wall(vec![view("barrel", BARREL)]);
    // A small box, so that its lines stay near its center.
    let center = DVec3::new(-3.2, -1.6, 5.0);
    wall.state.actors[0].cuboid.size = DVec3::splat(0.05);
    wall.state.actors[0].cuboid.pose.translation = center;
    let set = wall.distorted(&options(&[MapKind::Boxes]));
    let found = middle(set.cameras[0].boxes.as_ref().unwrap(), 160);
    let view = &wall.state.cameras[0].view;
    let (seen, ideal) = (view.project_recorded(center).unwrap().0, view.project(center).unwrap().0);
    assert!(found.distance(seen) < 2.0 && seen.distance(ideal) > 6.0, "{found} {seen} {ideal}");
}

#[test]
fn distortion_does_not_affect_pinhole_cameras() {
    let wall = wall(vec![view("a", [0.0; 5]), view("b", [0.0; 5])]);
    // There is no HD map.
    let others = |kind| matches!(kind, MapKind::Class | MapKind::Map);
    let kinds = MapKind::ALL.map(|kind| if others(kind) { MapKind::Tensor } else { kind });
    for (size, out_size) in
        [(None, Some((31, 50))), (Some((45, 80)), None), (Some((120, 200)), Some((30, 40)))]
    {
        let size_of = |(height, width): (u32, u32)| ImageSize { height, width };
        let options =
            ConditionOptions { size: size.map(size_of), out_size: out_size.map(size_of), ..options(&kinds) };
        let expected = wall.render(&wall.state, &options);
        assert!(expected.cameras[1].tensor.is_some() && expected.cameras[1].class.is_none());
        assert_eq!(wall.distorted(&options), expected);
    }
}

#[test]
fn distorted_maps_have_the_requested_size() {
    let wall = wall(vec![view("barrel", BARREL)]);
    let half = Some(ImageSize { height: 45, width: 80 });
    let maps = options(&[MapKind::Point, MapKind::Tensor]);
    for options in
        [ConditionOptions { size: half, ..maps.clone() }, ConditionOptions { out_size: half, ..maps.clone() }]
    {
        let set = wall.distorted(&options);
        let camera = &set.cameras[0];
        assert_eq!((camera.height, camera.width, camera.color.as_ref()), (45, 80, None));
        assert_eq!(camera.tensor.as_ref().unwrap().points.len(), 20 * 45 * 80);
        let (farthest, empty) = farthest_px(&wall, 0, &set);
        assert!(farthest < 1.6 && empty == 0, "{farthest} px, {empty} empty");
    }
}

#[test]
fn rejects_cameras_that_cannot_be_distorted() {
    for color_filter in [ColorFilter::ValidArea, ColorFilter::VisibleArea] {
        let area = ConditionOptions { color_filter, ..ConditionOptions::default() };
        assert!(matches!(Distorter::new(&area), Err(ConditionError::DistortedArea)));
    }
    // A crop at the corner of a wide image: there the lens shows points that a pinhole sees far outside the
    // image.
    let mut view = view("corner", BARREL);
    view.camera.intrinsics.z_axis = DVec3::new(-80.0, -44.0, 1.0);
    (view.camera.width, view.camera.height) = (8, 4);
    let depth = options(&[MapKind::Depth]);
    let error = Distorter::new(&depth).unwrap().pinholes(&wall(vec![view]).state, depth.maps);
    let message = error.unwrap_err().to_string();
    assert!(message.contains("4 times as large as 4x8") && message.ends_with("camera corner"), "{message}");
}
