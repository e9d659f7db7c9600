//! `pskel protocol --images`: images of other programs, named as these name them. The images are recorded
//! ones, so each of them equals the ground truth only at its own frame and camera.

use std::path::Path;

use image::RgbImage;
use serde_json::{Value, json};

use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{
    CAMERAS, FIRST_US, FRAMES, HEIGHT, STEP_US, TinyLog, WIDTH, assert_failed, picture, tree,
};

const PROTOCOL: &str = "protocol nuscenes-val nuscenes:log --other-logs --parts 2hz --skeletons sks \
                        --rasterizer cpu --maps color,class --window 2";

/// Returns an image that differs between frames and cameras.
fn recorded(frame: usize, camera: usize) -> RgbImage {
    let level = (40 + 90 * camera + 20 * frame) as u8;
    RgbImage::from_fn(WIDTH, HEIGHT, |x, y| image::Rgb([2 * x as u8, 3 * y as u8, level]))
}

/// Returns a log with such images.
fn log() -> TinyLog {
    let log = TinyLog::new();
    for frame in 0..FRAMES {
        for (camera, name) in CAMERAS.iter().enumerate() {
            recorded(frame, camera).save(log.path(&picture(frame, name))).unwrap();
        }
    }
    log
}

/// Saves an image of the log as a file of another program.
fn save(log: &TinyLog, frame: usize, camera: usize, name: &str) {
    save_as(&recorded(frame, camera), &log.path(name));
}

fn save_as(image: &RgbImage, path: &Path) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    image.save(path).unwrap();
}

/// Runs the protocol with options, and returns its results.
#[track_caller]
fn results(log: &TinyLog, out: &str, options: &str) -> Value {
    let output = log.run(&format!("{PROTOCOL} --out {out} {options}"));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    log.json(&format!("{out}/results.json"))
}

/// Returns the scores of the only clip.
fn scores(results: &Value) -> &Value {
    &results["parts"][0]["images"]["rollouts"][0]["scores"]
}

fn counted(count: usize, first: &str) -> Value {
    json!({"count": count, "first": first})
}

#[test]
fn images_are_matched_by_name_token_and_time() {
    let log = log();
    // As MagicDrive names key frames of nuScenes.
    let gen0 = |frame: usize, name: &str| format!("magicdrive/{name}/{frame}-{name}_gen0.png");
    for (frame, (camera, name)) in (1..FRAMES).flat_map(|i| CAMERAS.iter().enumerate().map(move |c| (i, c))) {
        save(&log, frame, camera, &gen0(frame, name));
        save(&log, frame, camera, &format!("tokens/d{frame}{name}.png"));
        let t_us = FIRST_US + STEP_US * frame as i64;
        save(&log, frame, camera, &format!("times/2hz/{name}/{t_us}.png"));
    }
    for folder in ["magicdrive", "tokens", "times"] {
        let found =
            results(&log, folder.get(..2).unwrap(), &format!("--images {folder} --image-layout nuscenes"));
        assert_eq!([&scores(&found)["steps"], &scores(&found)["equal_images"]], [&json!(2), &json!(4)]);
        let none = json!({"count": 0});
        assert_eq!(
            found["method"],
            json!({"name": folder, "references": 1, "images": {
                "folder": folder,
                "options": {"layout": "nuscenes", "copy_camera": null, "first": 0, "hz": null, "rows": null,
                            "aliases": {}},
                "counts": {"used": 4, "missing": none, "doubled": none, "wrong_size": none},
                "unknown": none,
            }})
        );
    }

    // A second sample, and an image that no frame has.
    save(&log, 0, 0, "magicdrive/CAM_BACK/2-CAM_BACK_gen1.png");
    save(&log, 0, 0, "magicdrive/CAM_BACK/7-CAM_BACK_gen0.png");
    let found = results(&log, "doubled", "--images magicdrive --image-layout nuscenes --method MagicDrive");
    assert_eq!(scores(&found)["equal_images"], json!(4));
    let images = &found["method"]["images"];
    assert_eq!(images["counts"]["doubled"], counted(1, "magicdrive/CAM_BACK/2-CAM_BACK_gen1.png"));
    assert_eq!(images["unknown"], counted(1, "magicdrive/CAM_BACK/7-CAM_BACK_gen0.png"));
    assert_eq!(found["method"]["name"], json!("MagicDrive"));

    // An image of another size, then none: the frame does not take part.
    let other = RgbImage::new(WIDTH / 2, HEIGHT / 2);
    std::fs::remove_file(log.path("magicdrive/CAM_BACK/2-CAM_BACK_gen1.png")).unwrap();
    save_as(&other, &log.path(&gen0(2, "CAM_BACK")));
    let found = results(&log, "resized", "--images magicdrive --image-layout nuscenes");
    let counts = &found["method"]["images"]["counts"];
    assert_eq!(counts["wrong_size"], counted(1, "magicdrive/CAM_BACK/2-CAM_BACK_gen0.png"));
    assert_eq!([&counts["used"], &scores(&found)["steps"]], [&json!(2), &json!(1)]);
    std::fs::remove_file(log.path(&gen0(2, "CAM_BACK"))).unwrap();
    let output = log.run(&format!("{PROTOCOL} --out missing --images magicdrive --image-layout nuscenes"));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("images missing: 1, first tiny, frame 2, CAM_BACK"), "{said}");
    let table = String::from_utf8(output.stdout).unwrap();
    assert!(table.lines().nth(2).unwrap().starts_with("| 2hz | 1 | 1 of 16 |"), "{table}");
}

/// As Epona names its frames: one camera, numbers with the condition frames, rows cut at both ends, and no
/// name of the scene.
#[test]
fn one_camera_stands_for_all_if_an_option_says_so() {
    let log = log();
    let cropped = |frame: usize| image::imageops::crop_imm(&recorded(frame, 0), 0, 8, WIDTH, 48).to_image();
    for frame in 0..FRAMES {
        save_as(&cropped(frame), &log.path(&format!("epona/sliding_0/{}.png", 10 + frame)));
        save_as(&cropped(0), &log.path(&format!("epona/sliding_1/{}.png", 10 + frame)));
    }
    std::fs::write(log.path("index.json"), r#"{"sliding_0": "tiny"}"#).unwrap();
    let base = "--images epona --image-layout frames --first-image 10 --image-index index.json";
    let all = format!("{base} --image-rows 8..56/64 --copy-camera CAM_FRONT");
    let found = results(&log, "epona_all", &all);
    assert_eq!([&scores(&found)["steps"], &scores(&found)["equal_images"]], [&json!(2), &json!(2)]);
    assert_eq!(found["parts"][0]["images"]["rollouts"][0]["sizes"], json!(["48x96", "48x96"]));
    let images = &found["method"]["images"];
    assert_eq!(images["counts"]["used"], json!(2));
    assert_eq!(images["unknown"], counted(3, "epona/sliding_1/10.png"));
    let table = std::fs::read_to_string(log.path("epona_all/table.md")).unwrap();
    let remark = "Method epona (images of CAM_FRONT for all cameras, rows 8..56/64 of each image).";
    assert!(table.contains(remark), "{table}");

    let fails = |out: &str, options: &str, parts: &[&str]| {
        assert_failed(&log.run(&format!("{PROTOCOL} --out {out} {options}")), 1, parts);
    };
    let copy = "--copy-camera CAM_FRONT";
    fails(
        "bad0",
        &format!("{base} {copy}"),
        &["of the shape of CAM_FRONT, 64x96, or --image-rows", "found 48x96", "sliding_0/11.png"],
    );
    fails("bad1", base, &["expected images of clip tiny by all 2 cameras, found none among 6 files"]);
    fails(
        "bad2",
        &format!("{base} --copy-camera CAM_LEFT"),
        &["one of the cameras CAM_FRONT, CAM_BACK", "CAM_LEFT"],
    );
    let front = "epona/tiny_CAM_FRONT/1.png";
    save(&log, 1, 0, front);
    fails(
        "bad3",
        "--images epona --image-layout frames",
        &["by all 2 cameras, found 1 (--copy-camera CAM takes the images of one camera for all)"],
    );
}

#[test]
fn exported_images_have_the_same_scores() {
    let log = log();
    std::fs::write(log.path("recipe.json"), r#"{"drawn": "64x96", "size": "64x96"}"#).unwrap();
    let generated = results(&log, "fill", "--generator fill --recipe recipe.json");
    assert!(log.run("protocol export fill --out frames").status.success());
    assert!(log.run("protocol export fill --out videos --image-layout video").status.success());
    let found = results(&log, "again", "--images frames --image-layout frames");
    assert_eq!(found["parts"], generated["parts"]);
    let video = results(&log, "mp4", "--images videos --image-layout video");
    assert_eq!(
        [&scores(&video)["steps"], &video["method"]["images"]["counts"]["used"]],
        [&json!(2), &json!(4)]
    );
    // The loss of H.264 at the quantizer of `rollout.mp4`.
    let psnr = |results: &Value| results["parts"][0]["images"]["mean"]["psnr_db"]["mean"].as_f64().unwrap();
    let loss = (psnr(&video) - psnr(&generated)).abs();
    assert!(0.0 < loss && loss < 0.5, "{loss}");
    // As FreeVS names its videos, beside a frame of another camera count.
    for name in CAMERAS {
        let path = log.path(&format!("freevs/tiny_{name}.mp4"));
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::copy(log.path(&format!("videos/2hz/tiny/{name}.mp4")), path).unwrap();
    }
    let freevs = results(&log, "freevs_out", "--images freevs --image-layout video");
    assert_eq!(freevs["parts"], video["parts"]);
    // Every second frame of a video at twice the rate; half of the frames of one at half the rate.
    let double = results(&log, "double", "--images freevs --image-layout video --image-hz 4");
    assert_eq!(double["method"]["images"]["counts"]["used"], json!(2));
    let half = results(&log, "half", "--images freevs --image-layout video --image-hz 1");
    assert_eq!(half["method"]["images"]["counts"]["missing"]["count"], json!(2));

    // The methods in one table.
    let output = log.run("protocol table fill again mp4");
    let table = String::from_utf8(output.stdout).unwrap();
    let rows: Vec<&str> = table.lines().collect();
    assert_eq!(rows[2].replace("| fill |", "| frames |"), rows[3], "{table}");
    assert_eq!((rows.len(), rows[4].starts_with("| videos | 1 | 2 of 16 | 64x96 |")), (5, true), "{table}");
    let output = log.run("protocol table fill double");
    let table = String::from_utf8(output.stdout).unwrap();
    let note = "Not comparable: fill and freevs differ in the frames of 1 of 1 clips of 2hz, first 2hz/tiny.";
    assert!(table.ends_with(&format!("\n{note}\n")), "{table}");
    assert_failed(&log.run("protocol table fill fill"), 1, &["expected each method once, found fill again"]);
    assert_failed(&log.run("protocol table sks"), 1, &["sks/results.json"]);
}

#[test]
fn interrupted_imports_end_with_the_same_bytes() {
    let log = log();
    for (frame, (camera, name)) in (1..FRAMES).flat_map(|i| CAMERAS.iter().enumerate().map(move |c| (i, c))) {
        save(&log, frame, camera, &format!("images/tiny/{name}/{frame:04}.png"));
    }
    let options = "--images images --image-layout frames";
    results(&log, "whole", options);
    // Images that have changed are those of another run.
    save(&log, 0, 0, "images/tiny/CAM_FRONT/0000.png");
    let output = log.run(&format!("{PROTOCOL} --out whole {options}"));
    assert_failed(&output, 1, &["expected the images of this command, found another: whole/protocol.json"]);
    std::fs::remove_file(log.path("images/tiny/CAM_FRONT/0000.png")).unwrap();
    let whole = tree(&log.path("whole"));
    results(&log, "out", options);
    // As if the process had ended in the last step.
    for name in ["results.json", "table.md", "2hz/tiny/index.json", "2hz/tiny/metrics.json"] {
        std::fs::remove_file(log.path(&format!("out/{name}"))).unwrap();
    }
    let states = std::fs::read_to_string(log.path("out/2hz/tiny/states.jsonl")).unwrap();
    let two: String = states.lines().take(2).map(|line| format!("{line}\n")).collect();
    std::fs::write(log.path("out/2hz/tiny/states.jsonl"), two).unwrap();
    std::fs::remove_dir_all(log.path("out/2hz/tiny/steps/000002")).unwrap();
    results(&log, "out", options);
    let resumed = tree(&log.path("out"));
    assert_eq!(whole.keys().collect::<Vec<_>>(), resumed.keys().collect::<Vec<_>>());
    for (name, bytes) in &whole {
        assert!(resumed[name] == *bytes, "{name}");
    }
}

#[test]
fn invalid_images_are_rejected() {
    let log = log();
    let protocol = PROTOCOL.replace(" --window 2", "");
    let run = |args: &str| log.run(&format!("{protocol} --out bad {args}"));
    std::fs::create_dir(log.path("empty")).unwrap();
    let frames = "--image-layout frames";
    for (code, args, parts) in [
        (2, "--images log".to_owned(), &["--image-layout"][..]),
        (2, format!("--images log --generator fill {frames}"), &["--generator", "cannot be used with"]),
        (2, format!("--images log --guidance 2 {frames}"), &["--guidance", "cannot be used with"]),
        (2, format!("--images log --window 0 {frames}"), &["expected --window of 1 or more, found 0"]),
        (2, format!("--images log --image-rows 5..1/9 {frames}"), &["FIRST..END/HEIGHT", "5..1/9"]),
        (
            1,
            format!("--images empty {frames}"),
            &["expected files of type png, jpg, jpeg, found none: empty"],
        ),
        (1, "--images log --image-layout video".to_owned(), &["expected files of type mp4"]),
        (1, format!("--images none {frames}"), &["none"]),
        // Recorded images have no number of frames.
        (
            1,
            format!("--images log/samples {frames} --window 2"),
            &["expected images of clip tiny", "found none among 6 files"],
        ),
    ] {
        assert_failed(&run(&args), code, parts);
    }
    // Numbers do not tell the part.
    save(&log, 1, 0, "numbered/tiny/CAM_FRONT/1.png");
    let both = protocol.replace("--parts 2hz", "--parts 6hz,2hz");
    let command = format!("{both} --out bad3 --window 2 --images numbered {frames}");
    let parts = &["expected a folder 6hz, since several parts are selected, found none: numbered"];
    assert_failed(&log.run(&command), 1, parts);
    // Off the log, names of recorded images do not tell the clip.
    let command = "protocol lane-change nuscenes:log --skeletons sks --out bad2 --rasterizer cpu --parts \
                   lane_change --window 2 --images log/samples --image-layout nuscenes";
    let parts =
        &["expected a folder lane_change/tiny, since the ego leaves the log, found none: log/samples"];
    assert_failed(&log.run(command), 1, parts);
}
