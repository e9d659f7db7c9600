//! `pskel export` through the command line: layouts, shards, and everything that can go wrong with them.

use std::collections::BTreeMap;
use std::io::Read;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::{Value, json};

use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{CAMERAS, FRAMES, HEIGHT, PSKEL, TinyLog, WIDTH, assert_failed, tree};

const EXPORT: &str = "export nuscenes:log --skeletons sks --out out --out-size 32x48 --rasterizer cpu";

/// Returns the files of a tar archive in order.
fn untar(path: &Path) -> Vec<(String, Vec<u8>)> {
    let mut archive = tar::Archive::new(std::fs::File::open(path).unwrap());
    let file = |entry: std::io::Result<tar::Entry<'_, std::fs::File>>| {
        let mut entry = entry.unwrap();
        let mut bytes = Vec::new();
        entry.read_to_end(&mut bytes).unwrap();
        (entry.path().unwrap().to_str().unwrap().to_owned(), bytes)
    };
    archive.entries().unwrap().map(file).collect()
}

/// Copies the log to another folder with another scene name.
fn copy(log: &TinyLog, folder: &str, scene: &str) {
    let copied = Command::new("cp").arg("-r").arg(log.path("log")).arg(log.path(folder)).status().unwrap();
    assert!(copied.success());
    let path = log.path(&format!("{folder}/v1.0-mini/scene.json"));
    let mut scenes: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    scenes[0]["name"] = json!(scene);
    std::fs::write(path, scenes.to_string()).unwrap();
}

#[test]
fn tar_shards_contain_the_maps_of_render() {
    let log = TinyLog::new();
    let reported = log.succeed(&format!("{EXPORT} --layout webdataset --format safetensors --images"));
    assert!(reported.starts_with("wrote 1 shards with 3 samples, 1 skeletons built"), "{reported}");
    let render = "render nuscenes:log --skeleton sks/tiny --rasterizer cpu --out-size 32x48";
    log.succeed(&format!("{render} --format safetensors --out rendered"));
    let files = untar(&log.path("out/tiny-000000.tar"));
    let names: Vec<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(
        names[..5],
        [
            "tiny-000000.json",
            "tiny-000000.conditions.safetensors",
            "tiny-000000.image.cam_front.jpg",
            "tiny-000000.image.cam_back.jpg",
            "tiny-000001.json"
        ]
    );
    let files: BTreeMap<String, Vec<u8>> = files.into_iter().collect();
    for frame in ["000000", "000001", "000002"] {
        let rendered = std::fs::read(log.path(&format!("rendered/{frame}/conditions.safetensors"))).unwrap();
        assert!(files[&format!("tiny-{frame}.conditions.safetensors")] == rendered, "{frame}");
    }
    let meta: Value = serde_json::from_slice(&files["tiny-000001.json"]).unwrap();
    assert_eq!((&meta["cameras"][1]["token"], &meta["caption"]), (&json!("d1CAM_BACK"), &json!("made up")));
    let rendered = log.json("rendered/000001/meta.json");
    assert_eq!(meta["cameras"][1]["camera_from_global"], rendered["cameras"][1]["camera_from_global"]);
    let image = image::load_from_memory(&files["tiny-000002.image.cam_back.jpg"]).unwrap().into_rgb8();
    let pixel = image.get_pixel(20, 10).0;
    // The image is 2x, 3y, 150 at twice the size.
    assert_eq!((image.width(), image.height()), (48, 32));
    assert!(pixel.iter().zip([81, 62, 150]).all(|(a, b): (&u8, u8)| a.abs_diff(b) < 6), "{pixel:?}");
    let index = log.json("out/index.json");
    let record = log.json("out/shards/tiny-000000.json");
    assert_eq!(index["shardlist"][0]["sha256"], record["files"][0]["sha256"]);
    assert_eq!((&index["nsamples"], &index["shardlist"][0]["url"]), (&json!(3), &json!("tiny-000000.tar")));

    // PNG: the files of render, and arrays of 16 bits with the samples of those.
    std::fs::remove_dir_all(log.path("out")).unwrap();
    log.succeed(&format!("{EXPORT} --layout webdataset"));
    log.succeed(&format!("{render} --out png"));
    let files: BTreeMap<String, Vec<u8>> = untar(&log.path("out/tiny-000000.tar")).into_iter().collect();
    for (camera, map) in [("CAM_FRONT", "color"), ("CAM_BACK", "class")] {
        let rendered = std::fs::read(log.path(&format!("png/000001/{camera}/{map}.png"))).unwrap();
        assert!(files[&format!("tiny-000001.{map}.{}.png", camera.to_lowercase())] == rendered, "{map}");
    }
    for (camera, map) in [("CAM_BACK", "depth"), ("CAM_FRONT", "instance")] {
        let rendered =
            image::open(log.path(&format!("png/000001/{camera}/{map}.png"))).unwrap().into_luma16();
        let name = format!("tiny-000001.{map}.{}", camera.to_lowercase());
        let array = npyz::NpyFile::new(files[&format!("{name}.npy")].as_slice()).unwrap();
        assert_eq!(array.shape(), [32, 48]);
        assert!(array.into_vec::<u16>().unwrap() == rendered.into_raw(), "{map}");
        assert!(!files.contains_key(&format!("{name}.png")), "{map}");
    }
}

#[test]
fn frames_equal_the_maps_of_render() {
    let log = TinyLog::new();
    log.succeed(&format!("{EXPORT} --layout frames --shard-frames 2"));
    log.succeed("render nuscenes:log --skeleton sks/tiny --rasterizer cpu --out-size 32x48 --out rendered");
    let exported = tree(&log.path("out/tiny"));
    let mut rendered = tree(&log.path("rendered"));
    rendered.retain(|name, _| !name.ends_with("sheet.png") && name != "index.json");
    assert_eq!(exported.keys().collect::<Vec<_>>(), rendered.keys().collect::<Vec<_>>());
    for (name, bytes) in &exported {
        if name.ends_with("meta.json") {
            let [a, b]: [Value; 2] =
                [bytes, &rendered[name]].map(|json| serde_json::from_slice(json).unwrap());
            assert_eq!(a, b, "{name}");
        } else {
            assert!(bytes == &rendered[name], "{name}");
        }
    }
}

/// The cache has the tokens of images as names, layouts at the size of the images, and bins times 255.
#[test]
fn the_papers_cache_is_keyed_by_token() {
    let log = TinyLog::new();
    log.succeed(&format!("{EXPORT} --layout pas-cache --color-folder proj_clr_v2"));
    let files = tree(&log.path("out"));
    let in_folder = |folder: &str| {
        let names = files.keys().filter_map(|name| name.strip_prefix(folder)?.strip_prefix('/'));
        names.map(str::to_owned).collect::<Vec<_>>()
    };
    let mut tokens: Vec<String> =
        (0..FRAMES).flat_map(|frame| CAMERAS.map(|camera| format!("d{frame}{camera}.png"))).collect();
    tokens.sort();
    for folder in ["3dbox_images", "proj_depth_g1.0", "proj_clr_v2"] {
        assert_eq!(in_folder(folder), tokens, "{folder}");
    }
    assert!(in_folder("hdmap_images").is_empty(), "the log has no HD map");
    let open = |name: &str| image::load_from_memory(&files[name]).unwrap();
    let boxes = open("3dbox_images/d1CAM_FRONT.png");
    assert_eq!((boxes.width(), boxes.height(), boxes.color()), (WIDTH, HEIGHT, image::ColorType::Rgb8));
    log.succeed("render nuscenes:log --skeleton sks/tiny --rasterizer cpu --maps boxes --out boxes");
    assert_eq!(boxes, image::open(log.path("boxes/000001/CAM_FRONT/boxes.png")).unwrap());
    // u = min(bin, 255) / 255 in the network input gives the bin back.
    let render =
        "render nuscenes:log --skeleton sks/tiny --rasterizer cpu --maps tensor --format npz --out tensor";
    log.succeed(&format!("{render} --out-size 32x48"));
    let points = pskel_testing::npz::read::<f32>(&log.path("tensor/000001/maps.npz"), "points");
    let depth = open("proj_depth_g1.0/d1CAM_FRONT.png");
    assert_eq!((depth.width(), depth.height(), depth.color()), (48, 32, image::ColorType::L16));
    let channel = &points.data[3 * 48 * 32..4 * 48 * 32];
    let depth = depth.into_luma16();
    for (value, u) in depth.iter().zip(channel) {
        let bin = if *u < 0.0 { 0 } else { (u * 255.0).round() as u16 };
        assert!(*value == bin * 255 || (*value == 256 * 255 && bin == 255), "{value} {u}");
    }
    assert!(depth.iter().collect::<std::collections::BTreeSet<_>>().len() > 10);
}

#[test]
fn packages_list_their_content() {
    let log = TinyLog::new();
    std::fs::write(log.path("c.json"), r#"{"tiny": "of the log", "d2CAM_BACK": "of the image"}"#).unwrap();
    log.succeed(&format!("{EXPORT} --layout opendwm-preview --images --captions c.json"));
    let data = log.json("out/tiny-000000/data.json");
    assert_eq!(data.as_object().unwrap().len(), FRAMES);
    let back = &data["2"]["camera_infos"]["CAM_BACK"];
    assert_eq!((&back["image_description"], &back["hdmap"]), (&json!("of the image"), &Value::Null));
    assert_eq!(data["1"]["camera_infos"]["CAM_BACK"]["image_description"], "of the log");
    assert_eq!(data["1"]["timestamp"], json!(1000.5));
    assert_eq!(data["1"]["ego_pose"][0][3], json!(664_001.0));
    for key in ["rgb", "3dbox", "color", "depth"] {
        let path = log.path(&format!("out/tiny-000000/{}", back[key].as_str().unwrap()));
        assert_eq!(image::image_dimensions(path).unwrap(), (48, 32), "{key}");
    }
}

#[test]
fn parts_and_later_runs_give_the_same_bytes_as_one_run() {
    let log = TinyLog::new();
    copy(&log, "log2", "other.scene");
    let both = "export nuscenes:log nuscenes:log2 --skeletons sks --out-size 32x48 --rasterizer cpu --layout \
        webdataset \
        --shard-frames 1";
    let listed = log.run(&format!("{both} --out listed --list"));
    let listed = String::from_utf8(listed.stdout).unwrap();
    assert_eq!(listed.lines().count(), 2 * FRAMES);
    assert!(listed.ends_with("5 other_scene-000002 2..3 nuscenes:log2\n"), "{listed}");
    assert!(!log.path("listed").exists());
    let reported = log.succeed(&format!("{both} --out whole --jobs 2"));
    assert!(reported.contains("wrote 6 shards with 6 samples"), "{reported}");
    let part = |part: usize| {
        let mut command = Command::new(PSKEL);
        command.current_dir(log.path("")).args(both.split_whitespace()).args(["--out", "parts"]);
        command.args(["--only", &format!("{part}/3")]).stdout(Stdio::null()).spawn().unwrap()
    };
    for mut child in [part(2), part(0), part(1)] {
        assert!(child.wait().unwrap().success());
    }
    let whole = tree(&log.path("whole"));
    assert!(whole == tree(&log.path("parts")), "the index included");

    // A later run writes what is missing or damaged, and nothing else.
    std::fs::remove_file(log.path("parts/tiny-000001.tar")).unwrap();
    std::fs::remove_file(log.path("parts/shards/other_scene-000000.json")).unwrap();
    let reported = log.succeed(&format!("{both} --out parts"));
    assert!(reported.starts_with("wrote 2 shards with 2 samples, 4 already existed"), "{reported}");
    let mut bytes = whole["tiny-000002.tar"].clone();
    bytes[700] ^= 1;
    std::fs::write(log.path("parts/tiny-000002.tar"), bytes).unwrap();
    assert!(log.succeed(&format!("{both} --out parts")).starts_with("wrote 0 shards"));
    assert!(log.succeed(&format!("{both} --out parts --verify")).starts_with("wrote 1 shards"));
    assert!(whole == tree(&log.path("parts")));
}

#[test]
fn a_killed_export_is_resumed() {
    let log = TinyLog::new();
    let export = format!("{EXPORT} --layout webdataset --shard-frames 1");
    log.succeed(&export);
    let whole = tree(&log.path("out"));
    std::fs::remove_dir_all(log.path("out")).unwrap();
    for kill_after_ms in [5, 20, 40, 80, 120] {
        let mut command = Command::new(PSKEL);
        let mut child = command.current_dir(log.path("")).args(export.split_whitespace()).spawn().unwrap();
        std::thread::sleep(std::time::Duration::from_millis(kill_after_ms));
        child.kill().unwrap();
        let status = child.wait().unwrap();
        assert!(status.signal() == Some(9) || status.success());
        // What is there is whole; a run that is killed early has not begun.
        std::fs::create_dir_all(log.path("out")).unwrap();
        for (name, bytes) in tree(&log.path("out")).iter().filter(|(name, _)| name.ends_with(".tar")) {
            assert!(name.starts_with(".unfinished") || whole[name] == *bytes, "{name}");
        }
    }
    log.succeed(&export);
    assert!(tree(&log.path("out")) == whole);
}

/// Damaged logs, and a disk that is full for one shard: the rest is exported.
#[test]
fn failures_affect_only_their_own_shards() {
    let log = TinyLog::new();
    copy(&log, "bad", "bad");
    copy(&log, "unlisted", "unlisted");
    std::fs::remove_file(log.path("bad/v1.0-mini/ego_pose.json")).unwrap();
    std::fs::write(log.path("unlisted/v1.0-mini/sample.json"), "[{").unwrap();
    let args = "export nuscenes:bad nuscenes:unlisted nuscenes:log --skeletons sks --out out --out-size \
        32x48 \
        --rasterizer cpu --layout webdataset";
    let output = log.run(args);
    let parts = [
        "failed: nuscenes:bad: ",
        "ego_pose.json",
        "failed: nuscenes:unlisted: ",
        "sample.json",
        "failed recordings and shards: 2",
    ];
    assert_failed(&output, 1, &parts);
    let reported = String::from_utf8(output.stdout).unwrap();
    assert!(reported.starts_with("wrote 1 shards with 3 samples"), "{reported}");
    assert!(log.path("out/tiny-000000.tar").exists() && tree(&log.path("out/.unfinished")).is_empty());

    // A limit on the size of files, which only the shard of three frames reaches.
    let export = "export nuscenes:log --skeletons sks --out full --out-size 64x96 --rasterizer cpu --layout \
        webdataset \
        --format safetensors --frames 0..3 --shard-frames 2";
    let limited = format!("ulimit -f 250; exec {PSKEL} {export}");
    let output = Command::new("bash").current_dir(log.path("")).args(["-c", &limited]).output().unwrap();
    assert_failed(&output, 1, &["failed: tiny-000000: cannot write: ", "full/tiny-000000.tar"]);
    let files: Vec<String> = tree(&log.path("full")).into_keys().collect();
    assert_eq!(files, ["export.json", "shards/tiny-000002.json", "tiny-000002.tar"]);
    log.succeed(export);
    assert!(log.path("full/index.json").exists());
}

#[test]
fn exports_are_not_mixed() {
    let log = TinyLog::new();
    log.succeed(&format!("{EXPORT} --layout frames"));
    let before = tree(&log.path("out"));
    let other = log.run(&format!("{EXPORT} --layout frames --radius 50"));
    assert_failed(&other, 1, &["expected an export with the same options", "out/export.json"]);
    assert!(tree(&log.path("out")) == before);
    // Options that no shard was written with are no obstacle.
    let again =
        |size: &str| format!("{EXPORT} --layout opendwm-preview {size}").replace("--out out", "--out again");
    let tables = log.path("log/v1.0-mini/calibrated_sensor.json");
    let retained = std::fs::read(&tables).unwrap();
    std::fs::write(&tables, "[]").unwrap();
    assert!(!log.run(&again("--radius 50")).status.success());
    std::fs::write(&tables, retained).unwrap();
    assert!(log.path("again/export.json").exists());
    log.succeed(&again("--radius 60"));
    std::fs::create_dir(log.path("thesis")).unwrap();
    std::fs::write(log.path("thesis/thesis.tex"), "years of work").unwrap();
    let args = EXPORT.replace("--out out", "--out thesis");
    let output = log.run(&format!("{args} --layout frames"));
    assert_failed(&output, 1, &["expected an export or an empty folder, found thesis.tex: thesis"]);
    for (args, parts) in [
        (
            "--layout frames --format npz",
            "expected the format png, or safetensors with the layout webdataset, found npz",
        ),
        ("--layout pas-cache --hz 5", "expected no rate with the layout pas-cache"),
        ("--layout frames --only 3/3", "a part I/N"),
        ("--layout mosaic", "mosaic"),
        ("--layout frames --maps tensor", "tensor"),
    ] {
        assert_failed(&log.run(&format!("{EXPORT} {args}")), 2, &[parts]);
    }
    let twice = "export nuscenes:log nuscenes:log --skeletons sks --out o --layout frames";
    assert_failed(&log.run(twice), 1, &["expected logs whose names differ as file names, found tiny twice"]);
}

/// Images between key frames: six of them per camera and second in nuScenes, at their own times and poses.
#[test]
fn images_between_frames_are_samples() {
    let log = TinyLog::new();
    let path = log.path("log/v1.0-mini/sample_data.json");
    let mut data: Vec<Value> = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    let of = |data: &[Value], token: &str| data.iter().find(|d| d["token"] == token).unwrap().clone();
    for (camera, delay_us) in [("CAM_FRONT", 100_000), ("CAM_BACK", 140_000), ("CAM_FRONT", 300_000)] {
        let mut new = of(&data, &format!("d1{camera}"));
        new["token"] = json!(format!("between{camera}{delay_us}"));
        new["is_key_frame"] = json!(false);
        new["timestamp"] = json!(1_000_000_000 + delay_us);
        new["ego_pose_token"] = json!("e0");
        data.push(new);
    }
    std::fs::write(&path, Value::from(data).to_string()).unwrap();
    let reported = log.succeed(&format!("{EXPORT} --layout pas-cache --between-images"));
    assert!(reported.contains("with 5 samples"), "{reported}");
    for token in ["betweenCAM_FRONT100000", "betweenCAM_BACK140000", "betweenCAM_FRONT300000", "d2CAM_BACK"] {
        assert!(log.path(&format!("out/proj_depth_g1.0/{token}.png")).exists(), "{token}");
    }
    // Their ego and points belong to frame 0; the car has moved on.
    let color = |token: &str| std::fs::read(log.path(&format!("out/proj_clr/{token}.png"))).unwrap();
    assert!(color("betweenCAM_BACK140000") == color("d0CAM_BACK"));
    assert!(color("betweenCAM_FRONT300000") != color("d0CAM_FRONT"));
    std::fs::remove_dir_all(log.path("out")).unwrap();
    log.succeed(&format!("{EXPORT} --layout webdataset --between-images"));
    let names: Vec<String> =
        untar(&log.path("out/tiny-000000.tar")).into_iter().map(|(name, _)| name).collect();
    let keys: Vec<&str> = names.iter().filter_map(|name| name.strip_suffix(".json")).collect();
    assert_eq!(keys, ["tiny-000000", "tiny-000000_01", "tiny-000000_02", "tiny-000001", "tiny-000002"]);
}
