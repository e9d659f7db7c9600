//! Scenarios in maps: an inserted car has the same box, class and instance everywhere, and points of a file.

use std::path::Path;

use glam::DVec3;
use point_skeleton::cloud::{Point, ply};
use point_skeleton::conditions::{ConditionOptions, MapKind, MapSet};
use point_skeleton::dataset::ActorEdits;
use point_skeleton::raster::{RasterizerDesc, RasterizerKind};
use point_skeleton::scene::SubstituteOptions;
use point_skeleton::{Log, Maps, RenderOptions, Renderer, Skeleton};
use pskel_testing::six_cameras;
use serde_json::json;

const MAPS: [MapKind; 5] =
    [MapKind::Color, MapKind::Depth, MapKind::Class, MapKind::Instance, MapKind::Boxes];

fn render(skeleton: &Skeleton, log: &Log) -> Maps {
    let options = SubstituteOptions::default().for_log(log.recording());
    let (substitutes, _) = options.make(skeleton, log.name()).unwrap();
    let conditions = ConditionOptions { maps: MapSet::of(&MAPS), ..ConditionOptions::default() };
    let rasterizer = RasterizerDesc { kind: RasterizerKind::Cpu, ..RasterizerDesc::default() };
    let options =
        RenderOptions { conditions, rasterizer, substitutes: &substitutes, ..RenderOptions::default() };
    Renderer::new(skeleton, options).unwrap().render(&log.frame(2).unwrap()).unwrap()
}

/// Writes the surface of a box of 4 x 2 x 1.6 m in red.
fn write_car(path: &Path) {
    let steps = |n: i32| (-n..=n).map(move |i| f64::from(i) / f64::from(n));
    let faces = steps(30).flat_map(|a| steps(30).map(move |b| (a, b))).flat_map(|(a, b)| {
        [-1.0, 1.0].map(|side| [DVec3::new(side, a, b), DVec3::new(a, side, b), DVec3::new(a, b, side)])
    });
    let point = |at: DVec3| Point::new((at * DVec3::new(2.0, 1.0, 0.8)).as_vec3().to_array(), [255, 0, 0], 0);
    ply::write(path, &faces.flatten().map(point).collect::<Vec<_>>()).unwrap();
}

#[test]
fn an_inserted_car_is_the_same_in_all_maps() {
    let (folder, log) = six_cameras::read();
    let log = Log::new(Box::new(log));
    let skeleton = Skeleton::build(&log, folder.path().join("skeleton"), &Default::default()).unwrap();
    write_car(&folder.path().join("car.ply"));
    let at = json!({"in": {"ego": {"t_us": six_cameras::FIRST_US}}, "x_m": 8.0, "y_m": 0.0});
    let insert = json!({"insert": {"category": "vehicle.car", "size_m": [4.0, 2.0, 1.6], "at": at}});
    let file = folder.path().join("scenario.json");
    let text = json!({"replace": {"between": {"file": "car.ply"}},
        "changes": [{"track": "between", "action": insert}]});
    std::fs::write(&file, text.to_string()).unwrap();
    let edited = log.edited(&ActorEdits::read(&file).unwrap()).unwrap();
    let (before, after) = (render(&skeleton, &log), render(&skeleton, &edited));

    let state = &after.state;
    let tracks: Vec<&str> = state.actors.iter().map(|actor| actor.track.as_str()).collect();
    assert_eq!(tracks, ["ahead", "between", "cone", "left"]);
    assert_eq!(state.actors[1].cuboid.pose.translation, DVec3::new(1008.0, 600.0, 0.8));
    // In front of the car that is 12 m ahead.
    let [plain, front] = [&before, &after].map(|maps| &maps.set.cameras[0]);
    let instance = front.instance.as_ref().unwrap();
    let pixels: Vec<usize> = (0..instance.len()).filter(|pixel| instance[*pixel] == 2).collect();
    assert!(pixels.len() > 100, "{}", pixels.len());
    let view = &state.cameras[0].view;
    let corners = state.actors[1].cuboid.corners().map(|corner| {
        let in_camera = view.camera_from_world.transform_point3(corner);
        let image = view.camera.intrinsics * (in_camera / in_camera.z);
        (image.x, image.y, in_camera.z)
    });
    let range = |part: fn(&(f64, f64, f64)) -> f64| {
        let parts = corners.iter().map(part);
        (parts.clone().fold(f64::INFINITY, f64::min), parts.fold(f64::NEG_INFINITY, f64::max))
    };
    let ((left, right), (top, bottom), (near_m, far_m)) = (range(|c| c.0), range(|c| c.1), range(|c| c.2));
    let depth_m = front.depth_m.as_ref().unwrap();
    for pixel in &pixels {
        let (x, y) = ((pixel % front.width as usize) as f64, (pixel / front.width as usize) as f64);
        // Splats reach two pixels beyond the box.
        assert!((left - 3.0..right + 3.0).contains(&x) && (top - 3.0..bottom + 3.0).contains(&y), "{x} {y}");
        assert!((near_m - 1e-3..far_m + 1e-3).contains(&f64::from(depth_m[*pixel])));
        assert_eq!(front.class.as_ref().unwrap()[*pixel], 1);
    }
    assert_ne!(plain.boxes, front.boxes);
    // The color map has the points of the file.
    let color = front.color.as_ref().unwrap();
    let red = color.iter().filter(|color| **color == [255, 0, 0]).count();
    assert!(red > 100 && plain.color.as_ref().unwrap().iter().all(|color| *color != [255, 0, 0]), "{red}");

    // An empty scenario gives the same maps as none.
    std::fs::write(&file, "{\"changes\": []}").unwrap();
    let empty = log.edited(&ActorEdits::read(&file).unwrap()).unwrap();
    assert!(render(&skeleton, &empty).set.cameras == before.set.cameras);
    assert_eq!(empty.recording(), log.recording());
}

#[test]
fn other_files_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("scenario.json");
    for (text, found) in [
        ("{\"change\": []}", "unknown field"),
        ("{\"changes\": [{\"track\": \"a\"}]}", "no field action"),
        ("{\"changes\": [{\"track\": \"a\", \"action\": \"fly\"}]}", "fly"),
        ("{\"replace\": {\"a\": {\"files\": 1}}}", "expected the id of a track"),
        ("[]", "no object"),
    ] {
        std::fs::write(&file, text).unwrap();
        let message = ActorEdits::read(&file).unwrap_err().to_string();
        assert!(message.contains(found) && message.starts_with("expected a scenario, found"), "{message}");
        assert!(message.ends_with("scenario.json"), "{message}");
    }
}
