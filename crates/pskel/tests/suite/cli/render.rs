//! `pskel render` through the command line, on every rasterizer with validation.

use std::process::Command;

use glam::DVec3;
use point_skeleton::cloud::cameras;
use point_skeleton::geometry::{Camera, Pose, View};
use serde_json::json;

use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{
    CAMERA_Z, CAMERAS, FIRST_US, HEIGHT, INTRINSICS, PSKEL, START, STEP_US, TinyLog, WIDTH, assert_failed,
    camera_rotation, tree,
};
use pskel_testing::npz;

/// Returns a log with its skeleton in `sk`.
fn built() -> TinyLog {
    let log = TinyLog::new();
    log.succeed("build nuscenes:log --out sk");
    log
}

const RENDER: &str = "render nuscenes:log --skeleton sk --out out";

/// The car (instance 1) in the instance map of a view: nearest depth, first and last column.
#[derive(Debug, PartialEq)]
struct Car {
    depth_m: f32,
    columns: [usize; 2],
}

/// Renders single points to NPZ and finds the car in the first view.
#[track_caller]
fn car(log: &TinyLog, extra: &str, folder: &str) -> Car {
    log.succeed(&format!("{RENDER} --format npz --splat 100:0 {extra}"));
    let path = log.path(&format!("out/{folder}/maps.npz"));
    let instance = npz::read::<u32>(&path, "instance");
    let depth = npz::read::<f32>(&path, "depth").data;
    let (pixels, width) = (instance.shape[1] * instance.shape[2], instance.shape[2]);
    let on_car: Vec<usize> = (0..pixels).filter(|i| instance.data[*i] == 1).collect();
    let columns = || on_car.iter().map(|i| i % width);
    let nearest = on_car.iter().map(|i| depth[*i]).reduce(f32::min).unwrap();
    Car {
        depth_m: (nearest * 1e3).round() / 1e3,
        columns: [columns().min().unwrap(), columns().max().unwrap()],
    }
}

#[test]
fn all_formats_have_the_same_frames() {
    let log = built();
    std::fs::write(log.path("prompt.json"), r#"{"weather": "Sunny", "city": "Nowhere"}"#).unwrap();
    let summary = log.succeed(&format!("{RENDER} --annotations prompt.json"));
    assert!(summary.starts_with("rendered 3 frames, 6 camera views by compute on"), "{summary}");
    assert!(summary.contains("project"), "{summary}");
    let png = tree(&log.path("out"));
    let mut expected = vec!["index.json".to_owned()];
    for frame in ["000000", "000001", "000002"] {
        expected.extend([format!("{frame}/meta.json"), format!("{frame}/sheet.png")]);
        for camera in CAMERAS {
            let maps = ["boxes", "class", "color", "depth", "instance"];
            expected.extend(maps.map(|map| format!("{frame}/{camera}/{map}.png")));
        }
    }
    expected.sort();
    assert_eq!(png.keys().cloned().collect::<Vec<_>>(), expected);
    let index = log.json("out/index.json");
    assert_eq!(index["options"]["splat"], "15:2,35:1,100:0");
    assert_eq!(
        (&index["options"]["min_actor_points"], &index["options"]["format"]),
        (&json!(20000), &json!("png"))
    );
    let frame = &index["frames"][1];
    assert_eq!((&frame["name"], &frame["t_us"]), (&json!("000001"), &json!(FIRST_US + STEP_US)));
    assert_eq!(frame["cameras"], json!(CAMERAS));
    let actor = |instance, track, category, class| {
        json!({"instance": instance, "track": track,
        "category": category, "class": class})
    };
    let actors = [actor(1, "car", "vehicle.car", 1), actor(2, "cone", "movable_object.trafficcone", 4)];
    assert_eq!(frame["actors"], json!(actors));
    assert_eq!(frame["ego"][0][3], START.x + 1.0);
    let meta = log.json("out/000001/meta.json");
    assert_eq!((&meta["prompt"], &meta["fps"]), (&json!("Sunny. A driving scene in Nowhere"), &json!(2.0)));
    assert_eq!(meta["cameras"][0]["intrinsics"], json!(INTRINSICS));
    let class = image::open(log.path("out/000000/CAM_FRONT/class.png")).unwrap().into_luma8();
    assert_eq!(class.dimensions(), (WIDTH, HEIGHT));
    assert!(class.pixels().any(|p| p.0 == [1]) && class.pixels().any(|p| p.0 == [4]));

    log.succeed(&format!("{RENDER} --format exr --frames 0..1 --maps depth,color"));
    // The index is new; frames of the earlier run that were not rendered again remain.
    assert_eq!(log.json("out/index.json")["frames"].as_array().unwrap().len(), 1);
    let exr = tree(&log.path("out/000000"));
    assert!(
        exr.contains_key("CAM_BACK/depth.exr")
            && !exr.keys().any(|k| k.contains("class") || k.contains("depth.png"))
    );
    log.succeed(&format!("{RENDER} --format npz --size 32x48 --out-size 16x24 --frames 0..1"));
    let maps = log.path("out/000000/maps.npz");
    assert_eq!(npz::read::<u8>(&maps, "color").shape, [2, 16, 24, 3]);
    assert_eq!(npz::read::<u8>(&maps, "boxes").shape, [2, 16, 24, 3]);
    assert_eq!(npz::read::<u8>(&maps, "class").shape, [2, 16, 24]);
    let class: Vec<u32> = npz::read::<u8>(&maps, "class").data.into_iter().map(u32::from).collect();
    let instance = npz::read::<u32>(&maps, "instance").data;
    assert!(class.iter().zip(&instance).all(|(c, i)| [0, 1, 4][*i as usize] == *c));
}

#[test]
fn all_rasterizers_and_threads_give_the_same_bytes() {
    let log = built();
    let mut all = Vec::new();
    for (rasterizer, threads) in
        [("compute", "1"), ("compute", "2"), ("graphics", "1"), ("graphics", "2"), ("cpu", "1"), ("cpu", "2")]
    {
        let args = format!("{RENDER}/{rasterizer}{threads} --rasterizer {rasterizer} --frames 0..2");
        let output = log.run_with(&args, threads);
        assert!(output.status.success(), "{output:?}");
        all.push(tree(&log.path(&format!("out/{rasterizer}{threads}"))));
    }
    assert!(all.windows(2).all(|pair| pair[0] == pair[1]));
    assert_eq!(all[0].len(), 1 + 2 * (2 + 2 * 5));
}

#[test]
fn the_car_moves_in_the_image_with_the_ego() {
    let log = built();
    // The template's back is 1.75 m wide and fills the 2 m box with its mirrors; at 10 m: columns 48 -+ 4.2.
    let frame = "--frames 0..1";
    assert_eq!(car(&log, frame, "000000"), Car { depth_m: 10.0, columns: [43, 52] });
    let moved = car(&log, &format!("{frame} --ego-offset left_m=0.5"), "000000");
    assert_eq!(moved, Car { depth_m: 10.0, columns: [46, 54] });
    assert_eq!(car(&log, &format!("{frame} --ego-offset forward_m=3"), "000000").depth_m, 7.0);
    // Two meters to the left of it, at half the distance between frames 0 and 1 (10.5 m).
    let between = FIRST_US + STEP_US / 2;
    assert_eq!(car(&log, &format!("--at {between}"), &between.to_string()).depth_m, 10.5);
    assert_eq!(car(&log, "--frames 2..3", "000002").depth_m, 12.0);
    // With the ego moved back and turned around, the car is not in the front camera's view.
    log.succeed(&format!("{RENDER} --format npz {frame} --ego-offset forward_m=-1,left_m=-2,yaw_deg=180"));
    let instance = npz::read::<u32>(&log.path("out/000000/maps.npz"), "instance").data;
    let pixels = (WIDTH * HEIGHT) as usize;
    assert!(!instance[..pixels].contains(&1) && instance[pixels..].contains(&1));
    // A custom camera 5 m behind the car.
    let place = Pose { rotation: camera_rotation(0.0), translation: START + DVec3::new(5.0, 0.0, CAMERA_Z) };
    let camera = Camera::new("own", 50, 40, [[20.0, 0.0, 25.5], [0.0, 20.0, 20.0], [0.0, 0.0, 1.0]]).unwrap();
    let view = View { camera, camera_from_world: place.inverse().affine() };
    cameras::write(&log.path("c.json"), &[view]).unwrap();
    assert_eq!(
        car(&log, &format!("{frame} --cameras c.json"), "000000"),
        Car { depth_m: 5.0, columns: [22, 28] }
    );
    assert_eq!(log.json("out/000000/meta.json")["cameras"][0]["name"], "own");
    // A template in place of the car fills its box.
    log.succeed("convert sk --out npy");
    log.succeed("build nuscenes:log --out sk --template sedan=npy/actors/car.npy");
    assert_eq!(car(&log, frame, "000000").depth_m, 10.0);
}

/// Writes a map of the log's location: a drivable rectangle that extends 25 m ahead and 9 m to each side,
/// with a hole, and a crossing across the view.
fn write_map(log: &TinyLog) {
    let rings = [
        [[-5.0, -9.0], [25.0, -9.0], [25.0, 9.0], [-5.0, 9.0]],
        [[14.0, -2.0], [18.0, -2.0], [18.0, 2.0], [14.0, 2.0]],
        [[6.0, -3.0], [9.0, -3.0], [9.0, 3.0], [6.0, 3.0]],
    ];
    let tokens = |ring: usize| (0..4).map(|i| format!("{ring}-{i}")).collect::<Vec<_>>();
    let nodes: Vec<_> = (0..3)
        .flat_map(|ring| tokens(ring).into_iter().zip(rings[ring]))
        .map(|(token, [x, y])| json!({"token": token, "x": START.x + x, "y": START.y + y}))
        .collect();
    let map = json!({"node": nodes, "line": [], "lane": [], "stop_line": [], "road_divider": [],
        "lane_divider": [],
        "polygon": [
            {"token": "p0", "exterior_node_tokens": tokens(0), "holes": [{"node_tokens": tokens(1)}]},
            {"token": "p2", "exterior_node_tokens": tokens(2), "holes": []}],
        "drivable_area": [{"token": "d", "polygon_tokens": ["p0"]}],
        "ped_crossing": [{"token": "c", "polygon_token": "p2"}]});
    std::fs::create_dir_all(log.path("log/maps/expansion")).unwrap();
    std::fs::write(log.path("log/maps/expansion/nowhere.json"), map.to_string()).unwrap();
}

#[test]
fn the_map_is_drawn_where_the_log_has_one() {
    let log = built();
    let frame = "--frames 0..1";
    log.fail(
        &format!("{RENDER} {frame} --maps color,map"),
        1,
        &["an HD map of \"nowhere\" for --maps map, found none in log tiny"],
    );
    // The bird's-eye view does not need a map.
    log.succeed(&format!("{RENDER} {frame} --maps boxes --birdseye"));
    let without = std::fs::read(log.path("out/000000/birdseye.png")).unwrap();
    write_map(&log);
    log.succeed(&format!("{RENDER} {frame} --birdseye"));
    assert_ne!(std::fs::read(log.path("out/000000/birdseye.png")).unwrap(), without);
    let index = log.json("out/index.json");
    assert_eq!(index["options"]["maps"], json!(["color", "depth", "class", "instance", "boxes", "map"]));
    assert_eq!(index["options"]["birdseye"], true);
    let map = image::open(log.path("out/000000/CAM_FRONT/map.png")).unwrap().to_rgb8();
    assert_eq!((map.width(), map.height()), (WIDTH, HEIGHT));
    // A level line x meters ahead is 48 * 1.5 / x rows below row 32 and 8 rows high: the crossing's far edge
    // (9 m) is at row 40, the area's far edge (25 m) at row 35. The area ends 9 m to the sides, where its own
    // edge is lower.
    for (column, row, rgb) in
        [(48, 40, [255, 0, 0]), (48, 32, [0, 0, 255]), (10, 32, [0; 3]), (48, 30, [0; 3])]
    {
        assert_eq!(map.get_pixel(column, row), &image::Rgb(rgb), "column {column}, row {row}");
    }
    // The drivable area's near left corner is behind the camera: its left edge leaves the image, 9 m to the
    // left.
    let left = |x: f64| [(48.0 - 48.0 * 9.0 / x) as u32, (32.0 + 72.0 / x) as u32];
    let [column, row] = left(12.0);
    assert_eq!(map.get_pixel(column, row), &image::Rgb([0, 0, 255]));
    // All rasterizers draw the same map.
    for rasterizer in ["graphics", "cpu"] {
        log.succeed(&format!("{RENDER} {frame} --maps map --rasterizer {rasterizer}"));
        let other = image::open(log.path("out/000000/CAM_FRONT/map.png")).unwrap().to_rgb8();
        assert!(other == map, "{rasterizer}");
        assert!(!log.path("out/000000/birdseye.png").exists());
    }
    std::fs::write(log.path("log/maps/expansion/nowhere.json"), "{}").unwrap();
    log.succeed(&format!("{RENDER} {frame} --maps boxes"));
    std::fs::remove_dir_all(log.path("out")).unwrap();
    std::fs::create_dir(log.path("out")).unwrap();
    log.fail(&format!("{RENDER} {frame}"), 1, &["nowhere.json"]);
}

#[test]
fn cameras_without_an_image_are_rendered_and_counted() {
    let log = built();
    // The back camera's image of frame 1 is no longer a key frame.
    log.change("sample_data", "/5/is_key_frame", json!(false));
    let summary = log.succeed(RENDER);
    let reported = "6 camera views (missing images, rendered from the frame's pose: 1 of CAM_BACK)";
    assert!(summary.contains(reported), "{summary}");
    assert_eq!(log.json("out/index.json")["frames"][1]["cameras"], json!(CAMERAS));
    let meta = log.json("out/000001/meta.json");
    assert_eq!(meta["cameras"][1]["global_from_ego"], meta["cameras"][0]["global_from_ego"]);
}

#[test]
fn damaged_skeletons_are_errors_that_leave_nothing() {
    let log = built();
    log.fail(&RENDER.replace("sk ", "none "), 1, &["cannot read", "none/skeleton.json"]);
    let path = log.path("sk/skeleton.json");
    let good = std::fs::read_to_string(&path).unwrap();
    for (from, to, parts) in [
        (
            "\"version\": 4",
            "\"version\": 7",
            ["version 4, found format \"point-skeleton\" version 7", "skeleton.json"],
        ),
        ("\"log\": \"tiny\"", "\"log\": \"other\"", ["a skeleton of log tiny, found one of log other", "sk"]),
        ("\"report\"", "\"rapport\"", ["a skeleton manifest, found no field report", "skeleton.json"]),
    ] {
        assert!(good.contains(from));
        std::fs::write(&path, good.replace(from, to)).unwrap();
        log.fail(RENDER, 1, &parts);
    }
    std::fs::write(&path, &good).unwrap();
    let points = log.path("sk/background.points");
    let length = std::fs::metadata(&points).unwrap().len();
    std::fs::OpenOptions::new().write(true).open(&points).unwrap().set_len(length - 16).unwrap();
    let (expected, found) = (format!("expected {length} bytes"), format!("found {} bytes", length - 16));
    log.fail(RENDER, 1, &[&expected, &found, "background.points"]);
}

#[test]
fn a_file_size_limit_leaves_no_frame() {
    let log = built();
    for format in ["png", "exr", "npz"] {
        let script = format!("ulimit -f 1; exec '{PSKEL}' {RENDER} --rasterizer cpu --format {format}");
        let output = Command::new("bash").arg("-c").arg(script).current_dir(log.path("")).output().unwrap();
        assert_failed(&output, 1, &["cannot write", format]);
        log.assert_out_is_empty();
    }
}

#[test]
fn wrong_usage_exits_with_2_and_times_out_of_the_log_with_1() {
    let log = built();
    for (extra, part) in [
        ("--ego-offset 1,2", "like forward_m=1,left_m=-2,yaw_deg=5"),
        ("--ego-offset left_m=1,left_m=2", "each once"),
        ("--ego-offset left=1", "forward_m=1"),
        ("--ego-offset yaw_deg=nan", "finite"),
        ("--ego-offset forward_m=1,left_m=2,yaw_deg=3 --cameras c.json", "cannot be used with"),
        ("--at 5 --frames 0..1", "cannot be used with"),
        ("--at 5,x", "invalid digit"),
        ("--hz 6 --at 5", "cannot be used with"),
        ("--hz 0", "0.1 to 100"),
        ("--distort --color-filter valid-area", "bilinear with --distort"),
        ("--distort --color-filter visible-area", "bilinear with --distort"),
        ("--frames 3..1", "A..B with A < B"),
        ("--maps color,lanes", "the map color, depth, class"),
        ("--format gif", "png, exr, npz"),
        ("--size 0x4", "a size HxW"),
        ("--radius -3", "more than 0"),
        ("--far nan", "more than 0"),
        ("--splat 15:1,35:2", "radii"),
        ("--rasterizer opengl", "auto, compute, graphics, cpu"),
        ("--depth-bins cubic", "linear, log"),
    ] {
        log.fail(&format!("{RENDER} {extra}"), 2, &[part]);
    }
    let at = FIRST_US + 7;
    log.fail(&format!("{RENDER} --at {at},{at}"), 2, &["differ"]);
    let range = format!("{FIRST_US} to {}", FIRST_US + 2 * STEP_US);
    log.fail(&format!("{RENDER} --at {at},-5"), 1, &[&range, "found -5"]);
    log.fail(&format!("{RENDER} --frames 0..9"), 1, &["within 0..3, found 0..9"]);
    log.fail(&format!("{RENDER} --cameras none.json"), 1, &["none.json"]);
    std::fs::write(log.path("p.json"), r#"{"weather": 3}"#).unwrap();
    log.fail(&format!("{RENDER} --annotations p.json"), 1, &["\"weather\": text", "p.json"]);
}
