//! `pskel info` on logs, skeletons and files.

use serde_json::{Value, json};

use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{CAMERAS, FRAMES, TinyLog, assert_failed, picture, sweep};
use pskel_testing::av2_log::TinyAv2;
use pskel_testing::nuplan_log::{NuplanLog, RING, image_file};

/// Returns the description as JSON. The exit code must be 1 if it names missing or damaged files, else 0.
#[track_caller]
fn info(log: &TinyLog, target: &str) -> Value {
    let output = log.run(&format!("info --json {target}"));
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    let damaged = json["damaged"].as_array().is_some_and(|damaged| !damaged.is_empty());
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(i32::from(damaged)), "{errors}");
    assert_eq!(errors.contains("missing or damaged files: "), damaged, "{errors}");
    json
}

/// Returns the description as text. The exit code must equal the JSON description's.
#[track_caller]
fn text(log: &TinyLog, target: &str) -> String {
    let [text, json] = ["", "--json "].map(|option| log.run(&format!("info {option}{target}")));
    assert_eq!(text.status, json.status, "{}", String::from_utf8_lossy(&text.stderr));
    String::from_utf8(text.stdout).unwrap()
}

#[test]
fn describes_a_log_and_its_damage() {
    let log = TinyLog::new();
    let whole = info(&log, "nuscenes:log");
    assert_eq!(
        (&whole["kind"], &whole["frames"], &whole["damaged"]),
        (&json!("log"), &json!(FRAMES), &json!([]))
    );
    assert_eq!((&whole["frame_rate_hz"], &whole["seconds"]), (&json!(2.0), &json!(1.0)));
    assert_eq!(whole["categories"]["vehicle.car"], json!({"tracks": 1, "boxes": FRAMES}));
    let cameras = whole["cameras"].as_array().unwrap();
    assert_eq!((cameras.len(), &cameras[0]["name"]), (2, &json!(CAMERAS[0])));
    assert_eq!((&cameras[0]["size"], &cameras[0]["focal_px"]), (&json!("64x96"), &json!(48.0)));

    std::fs::remove_file(log.path(&picture(1, CAMERAS[1]))).unwrap();
    std::fs::write(log.path(&sweep(2)), [0; 33]).unwrap();
    image::RgbImage::new(5, 4).save(log.path(&picture(0, CAMERAS[0]))).unwrap();
    let damaged = info(&log, "nuscenes:log")["damaged"].to_string();
    for part in ["1-CAM_BACK.png", "found 33 bytes", "2.pcd.bin", "found 4x5", "0-CAM_FRONT.png"] {
        assert!(damaged.contains(part), "{damaged}");
    }
    let text = text(&log, "nuscenes:log");
    assert!(text.contains("3 over 1.0 s at 2.0 Hz") && text.contains("damaged    3 files"), "{text}");
}

#[test]
fn lists_tracks() {
    let log = TinyLog::new();
    let json = info(&log, "--tracks nuscenes:log");
    let tracks = json["track_list"].as_array().unwrap();
    assert_eq!((tracks.len(), &json["tracks"]), (2, &json!(2)));
    let (car, cone) = (&tracks[0], &tracks[1]);
    assert_eq!((&car["track"], &car["category"]), (&json!("car"), &json!("vehicle.car")));
    assert_eq!((&car["size_m"], &car["frames"]), (&json!([4.0, 2.0, 1.5]), &json!(FRAMES)));
    assert_eq!(car["t_us"][1].as_i64().unwrap() - car["t_us"][0].as_i64().unwrap(), 1_000_000);
    assert!(car["path_m"].as_f64().unwrap() > 1.0 && cone["path_m"] == json!(0.0));
    let text = text(&log, "--tracks nuscenes:log");
    let line = "track      car vehicle.car, 4.0 x 2.0 x 1.5 m, 0.0 to 1.0 s, path ";
    assert!(text.lines().any(|found| found.starts_with(line)), "{text}");
    assert!(info(&log, "nuscenes:log").get("track_list").is_none());
    std::fs::write(log.path("a.npy"), "").unwrap();
    assert_failed(&log.run("info --tracks a.npy"), 2, &["--tracks lists the tracks of a log", "a file"]);
}

/// Reports features that the map reader skipped; checks an image that serves two frames only once.
#[test]
fn describes_a_nuplan_log_and_its_map() {
    let (log, nuplan) = (TinyLog::new(), NuplanLog::new());
    nuplan.map_sql("UPDATE baseline_paths SET lane_fid = 99 WHERE fid = 41;");
    std::fs::write(nuplan.blob(&image_file(RING[0], 0)), "text").unwrap();
    let target = format!("nuplan:{}", nuplan.database().display());
    let reported = info(&log, &target);
    let merged = "sweeps of merged LiDARs (--ring-is beam if not), in 4 sweeps read";
    assert_eq!(reported["left_out"], json!({"map: baseline paths of unknown lanes": 1, merged: 4}));
    assert_eq!(reported["damaged"].as_array().unwrap().len(), 1, "{}", reported["damaged"]);
    assert!(text(&log, &target).contains("noted      map: baseline paths of unknown lanes: 1"));
}

#[test]
fn describes_a_skeleton_and_files() {
    let log = TinyLog::new();
    log.succeed("build nuscenes:log --out out/sk");
    let skeleton = info(&log, "out/sk");
    let manifest = log.json("out/sk/skeleton.json");
    assert_eq!((&skeleton["kind"], &skeleton["report"]), (&json!("skeleton"), &manifest["report"]));
    assert!(text(&log, "out/sk").contains("vehicle.car"));
    let points = std::fs::metadata(log.path(&sweep(0))).unwrap().len() / 20;
    let file = info(&log, &sweep(0));
    assert_eq!(
        (&file["kind"], &file["points"], &file["not_finite"]),
        (&json!("sweep"), &json!(points), &json!(0))
    );
    let image = info(&log, &picture(0, CAMERAS[0]));
    assert_eq!((&image["kind"], &image["size"]), (&json!("image"), &json!("64x96")));
    log.succeed("convert out/sk --out out/clouds --format ply");
    let cloud = info(&log, "out/clouds/background.ply");
    let background: u64 =
        manifest["background"].as_array().unwrap().iter().map(|c| c["points"].as_u64().unwrap()).sum();
    assert_eq!((&cloud["kind"], &cloud["points"]), (&json!("points"), &json!(background)));
}

/// Paths without a format, with and without the version and scene.
#[test]
fn logs_are_recognized_by_their_files() {
    let (log, nuplan, argoverse) = (TinyLog::new(), NuplanLog::new(), TinyAv2::new());
    for name in ["log", "log@v1.0-mini"] {
        assert_eq!(info(&log, name), info(&log, "nuscenes:log"), "{name}");
    }
    let database = nuplan.database();
    for path in [&*database, database.parent().unwrap()] {
        let path = path.display();
        assert_eq!(info(&log, &path.to_string()), info(&log, &format!("nuplan:{path}")));
    }
    for path in [argoverse.path(""), argoverse.root().to_owned()] {
        let path = path.display();
        assert_eq!(info(&log, &path.to_string()), info(&log, &format!("av2:{path}")));
    }
    // Every command reads logs by such names.
    log.succeed("build log --out out/sk");
    let message = ["expected #SCENE to name one of", "gone"];
    assert_failed(&log.run("build log#gone --out out/other"), 1, &message);
    std::fs::copy(&database, log.path("log/a.db")).unwrap();
    let several =
        "expected files of one format, or its name before the path, found those of nuscenes, nuplan: log";
    assert_failed(&log.run("info log"), 2, &[several]);
    assert_failed(&log.run("build log --out out/other"), 2, &[several]);
    let none = "or the path of one, found \"out\"";
    assert_failed(&log.run("build out --out out/other"), 2, &[none]);
}

#[test]
fn anything_else_is_an_error() {
    let log = TinyLog::new();
    std::fs::write(log.path("notes.txt"), "hello").unwrap();
    assert_failed(&log.run("info notes.txt"), 1, &["a file ending in .npy", "notes.txt"]);
    assert_failed(&log.run("info out"), 1, &["a skeleton's folder or a file", "another folder: out"]);
    assert_failed(&log.run("info gone"), 1, &["found nothing: gone"]);
    pskel::logs::register_formats();
    let known: Vec<&str> = point_skeleton::dataset::formats().iter().map(|format| format.name).collect();
    assert_failed(
        &log.run("info kitti:log"),
        2,
        &[&format!("FORMAT {}", known.join(", ").replace(", town", " or town")), "kitti:log"],
    );
    assert_failed(&log.run("info nuscenes:gone"), 1, &["gone"]);
    assert_failed(&log.run("info"), 2, &["Usage"]);
}
