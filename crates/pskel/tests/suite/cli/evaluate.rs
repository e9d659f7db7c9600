//! `pskel evaluate` on small synthetic rollouts.

use std::path::PathBuf;
use std::process::{Command, Output};

use image::{GrayImage, ImageBuffer, Luma, Rgb, RgbImage};
use serde_json::{Value, json};

use crate::tiny_log::{PSKEL, assert_failed};

const WIDTH: u32 = 28;
const HEIGHT: u32 = 16;
/// Scale of the maps relative to the images.
const SCALE: u32 = 4;
/// Images are generated at every second step; the first two are references.
const STEPS: u32 = 36;
const GENERATED: usize = 16;
const CAMERAS: [&str; 2] = ["CAM_BACK", "CAM_FRONT"];

/// A folder of rollouts.
struct Rollouts(tempfile::TempDir);

/// Returns the number of the actor at a pixel: 1 drives to the right, 2 is parked.
fn actor(step: u32, x: u32, y: u32) -> u32 {
    let (left, top) = (2 + step / 3, 5);
    match ((left..left + 7).contains(&x) && (top..top + 5).contains(&y), x >= 22 && y >= 11) {
        (true, _) => 1,
        (_, true) => 2,
        _ => 0,
    }
}

fn truth(step: u32, camera: usize) -> RgbImage {
    RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
        let back = (70 + 25 * (x % 2) + 15 * (y % 3) + (step / 2) % 4 + 20 * camera as u32) as u8;
        Rgb(match actor(step, x, y) {
            1 => [210, 40, 50],
            2 => [190, 60, 70],
            _ => [back, back, back + 20],
        })
    })
}

/// Blends an image with gray by `parts` percent; 0 leaves it unchanged.
fn faded(image: &RgbImage, parts: u32) -> RgbImage {
    let mut image = image.clone();
    image.iter_mut().for_each(|v| *v = ((u32::from(*v) * (100 - parts) + 128 * parts) / 100) as u8);
    image
}

fn state(step: u32) -> Value {
    let actor = |instance: u32, speed_mps: f64| {
        json!({
            "instance": instance, "track": format!("t{instance}"), "category": "vehicle.car", "class": 1,
            "center_m": [0.0, 0.0, 0.0], "heading_rad": 0.0, "size_m": [4.0, 2.0, 1.5],
            "speed_mps": speed_mps,
            "velocity_mps": [speed_mps, 0.0], "yaw_rate_radps": 0.0, "seen": null, "new_in_view": null,
        })
    };
    let pose = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    json!({
        "step": step, "t_us": 7_000_000 + 100_000 * step, "phase": "policy",
        "ego": {
            "global_from_ego": pose, "heading_rad": 0.0, "speed_mps": 0.0, "acceleration_mps2": 0.0,
            "yaw_rate_radps": 0.0, "steering_rad": 0.0, "lateral_deviation_m": 0.0,
            "heading_deviation_rad": 0.0,
        },
        "actors": [actor(1, -3.0), actor(2, 0.4)], "lights": [], "driving_command": "straight",
        "plan": null,
    })
}

impl Rollouts {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Adds a rollout whose images fade by `fade` percent more at each step.
    fn add(&self, name: &str, fade: u32) {
        let folder = self.path(name);
        std::fs::create_dir(&folder).unwrap();
        std::fs::write(folder.join("rollout.json"), "{}").unwrap();
        let states: String = (0..STEPS).map(|step| state(step).to_string() + "\n").collect();
        std::fs::write(folder.join("states.jsonl"), states).unwrap();
        for step in 0..STEPS {
            let folder = folder.join(format!("steps/{step:06}"));
            for (number, camera) in CAMERAS.iter().enumerate() {
                std::fs::create_dir_all(folder.join(camera)).unwrap();
                let at = |x: u32, y: u32| actor(step, x / SCALE, y / SCALE);
                let (width, height) = (WIDTH * SCALE, HEIGHT * SCALE);
                let class = GrayImage::from_fn(width, height, |x, y| Luma([u8::from(at(x, y) > 0)]));
                class.save(folder.join(camera).join("class.png")).unwrap();
                let instance: ImageBuffer<Luma<u16>, Vec<u16>> =
                    ImageBuffer::from_fn(width, height, |x, y| Luma([at(x, y) as u16]));
                instance.save(folder.join(camera).join("instance.png")).unwrap();
                if step % 2 == 0 {
                    let image = truth(step, number);
                    for (kind, image) in [("truth", &image), ("generated", &faded(&image, fade * step))] {
                        std::fs::create_dir_all(folder.join(kind)).unwrap();
                        image.save(folder.join(format!("{kind}/{camera}.png"))).unwrap();
                    }
                    let kind = if step < 4 { "reference" } else { "generated" };
                    std::fs::write(folder.join("generated.json"), json!({ "kind": kind }).to_string())
                        .unwrap();
                }
            }
        }
    }

    fn run_with(&self, args: &str, threads: &str) -> Output {
        let mut command = Command::new(PSKEL);
        command.current_dir(self.0.path()).arg("evaluate").args(args.split_whitespace());
        command.env("RAYON_NUM_THREADS", threads).output().unwrap()
    }

    /// Returns standard output, standard error, and the content of `out.json`.
    #[track_caller]
    fn succeed(&self, args: &str) -> (String, String, Value) {
        let output = self.run_with(&format!("{args} --out out.json"), "2");
        let [stdout, stderr] = [output.stdout, output.stderr].map(|text| String::from_utf8(text).unwrap());
        assert!(output.status.success(), "{args}: {stderr}");
        let json = serde_json::from_slice(&std::fs::read(self.path("out.json")).unwrap()).unwrap();
        (stdout, stderr, json)
    }

    #[track_caller]
    fn fail(&self, args: &str, code: i32, parts: &[&str]) {
        let _ = std::fs::remove_file(self.path("out.json"));
        assert_failed(&self.run_with(&format!("{args} --out out.json"), "2"), code, parts);
        assert!(!self.path("out.json").exists());
    }

    fn step(&self, name: &str, step: u32) -> PathBuf {
        self.path(name).join(format!("steps/{step:06}"))
    }
}

#[track_caller]
fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value}"))
}

#[test]
fn rollouts_are_scored_individually_and_together() {
    let rollouts = Rollouts::new();
    rollouts.add("copy", 0);
    rollouts.add("faded", 2);
    let (stdout, stderr, json) = rollouts.succeed("copy faded");
    // A header, two rollouts, their means, the summary.
    let lines: Vec<&str> = stdout.lines().collect();
    assert_eq!(lines.len(), 5, "{stdout}");
    assert!(
        lines[0].contains("PSNR (dB)") && lines[2].contains("faded") && lines[3].contains("±"),
        "{stdout}"
    );
    assert!(
        lines[4].starts_with("scored 64 images of 2 rollouts: PSNR ") && lines[4].ends_with(": out.json")
    );
    assert!(stderr.contains("note: 32 images equal the ground truth and have no PSNR: copy"), "{stderr}");
    let [copy, faded] = [0, 1].map(|i| &json["rollouts"][i]["scores"]);
    assert_eq!(
        (&json["rollouts"][0]["references"], &json["rollouts"][1]["sizes"][0]),
        (&json!(2), &json!("16x28"))
    );
    assert_eq!(
        (&copy["steps"], &copy["cameras"], &copy["steps_with_truth"]),
        (&json!(16), &json!(2), &json!(16))
    );
    assert_eq!((&copy["psnr_db"]["mean"], &copy["equal_images"]), (&Value::Null, &json!(32)));
    assert!((number(&copy["ssim"]["mean"]) - 1.0).abs() < 1e-12);
    assert_eq!((&copy["motion"]["slope"], &copy["motion"]["flicker"]), (&json!(1.0), &json!(1.0)));
    // The parked car and the actor without pixels do not count as moving.
    let moving = number(&copy["motion"]["moving_pixels"]) / (2.0 * (GENERATED - 1) as f64);
    assert!((35.0..=40.0).contains(&moving), "{moving}");
    assert_eq!(copy["iou"], json!({}));
    assert_eq!(copy["t_s"][0], json!(0.4));
    // Every step is 0.1 s and 2 % closer to gray.
    for metric in ["psnr_db", "ssim", "sharpness_ratio"] {
        let drift = &faded[metric]["drift"];
        assert!(number(&drift["slope_per_s"]) < 0.0, "{metric}: {drift}");
        assert!(number(&drift["last_minus_first_third"]) < 0.0, "{metric}: {drift}");
    }
    assert!((number(&faded["sharpness_ratio"]["drift"]["slope_per_s"]) + 0.2).abs() < 0.03);
    let slope = number(&faded["motion"]["slope"]);
    assert!(slope > 0.3 && slope < 0.9, "{slope}");
    let mean = &json["mean"];
    assert_eq!((&mean["ssim"]["count"], &mean["psnr_db"]["count"]), (&json!(2), &json!(1)));
    // The number of threads does not change the result.
    let bytes = std::fs::read(rollouts.path("out.json")).unwrap();
    assert!(rollouts.run_with("copy faded --out again.json", "1").status.success());
    assert!(std::fs::read(rollouts.path("again.json")).unwrap() == bytes);
}

#[test]
fn external_masks_are_used() {
    let rollouts = Rollouts::new();
    rollouts.add("a", 1);
    for step in (4..STEPS).step_by(2) {
        let folder = rollouts.path(&format!("masks/{step:06}"));
        std::fs::create_dir_all(&folder).unwrap();
        // Masks may have another size and any nonzero level.
        let mask =
            GrayImage::from_fn(2 * WIDTH, 2 * HEIGHT, |x, y| Luma([3 * actor(step, x / 2, y / 2) as u8]));
        CAMERAS.iter().for_each(|camera| mask.save(folder.join(format!("{camera}.png"))).unwrap());
    }
    let args = "a --masks masks";
    let (stdout, _, json) = rollouts.succeed(args);
    let iou = &json["rollouts"][0]["scores"]["iou"];
    assert!(number(&iou["masks"]["generated"]) > 0.9, "{}", iou["masks"]);
    let mut lines = stdout.lines();
    let (header, row) = (lines.next().unwrap(), lines.next().unwrap());
    let printed: f64 = row.split_whitespace().last().unwrap().parse().unwrap();
    assert!(header.ends_with("IoU masks"), "{header}");
    assert!((printed - number(&iou["masks"]["generated"])).abs() < 1e-3, "{row}");
    let (_, _, blurred) = rollouts.succeed("a --masks masks --mask-rule paper");
    let blurred = &blurred["rollouts"][0]["scores"]["iou"]["masks"]["generated"];
    assert!(number(blurred) > 0.9, "{blurred}");
    rollouts.fail("a --mask-rule paper", 2, &["--masks"]);
    // Masks are read per camera.
    std::fs::remove_file(rollouts.path("masks/000010/CAM_FRONT.png")).unwrap();
    rollouts.fail(args, 1, &["cannot read", "masks/000010/CAM_FRONT.png"]);
}

#[test]
fn unknown_metrics_are_null_and_noted() {
    let rollouts = Rollouts::new();
    rollouts.add("a", 1);
    for step in 0..STEPS {
        for camera in CAMERAS {
            std::fs::remove_file(rollouts.step("a", step).join(camera).join("instance.png")).unwrap();
        }
        if step % 2 == 0 && step != 10 {
            std::fs::remove_dir_all(rollouts.step("a", step).join("truth")).unwrap();
        }
    }
    let (stdout, stderr, json) = rollouts.succeed("a");
    for note in [
        "note: 15 of 16 steps have no ground truth: a",
        "note: no motion: requires ground truth and instance maps of two consecutive steps",
    ] {
        assert!(stderr.contains(note), "{stderr}");
    }
    assert_eq!(json["notes"].as_array().unwrap().len(), 2);
    assert!(stdout.contains(" - "), "{stdout}");
    let scores = &json["rollouts"][0]["scores"];
    assert_eq!((&scores["psnr_db"]["steps"][0], &scores["motion"]), (&Value::Null, &Value::Null));
    assert!(number(&scores["psnr_db"]["steps"][3]) > 20.0 && scores["psnr_db"]["drift"].is_null());
    assert!(number(&scores["sharpness"]["mean"]) > 0.0);
    assert_eq!(json["mean"]["motion_slope"], Value::Null);
    assert_eq!(json["mean"]["ssim"]["half_width"], Value::Null);
}

#[test]
fn damaged_rollouts_are_refused() {
    let rollouts = Rollouts::new();
    rollouts.add("a", 1);
    rollouts.fail("", 2, &["required arguments"]);
    rollouts.fail("a --masks x --masks y", 2, &["expected masks for each of 1 rollouts, found 2"]);
    rollouts.fail("a --masks x y", 2, &["expected masks for each of 2 rollouts, found 1"]);
    rollouts.fail("none", 1, &["expected a rollout with generated images, found no rollout.json: none"]);
    let class = rollouts.step("a", 8).join("CAM_BACK/class.png");
    RgbImage::new(4, 4).save(&class).unwrap();
    rollouts.fail("a", 1, &["expected a class map of 8-bit grey, found Rgb8", "000008/CAM_BACK/class.png"]);
    std::fs::remove_file(&class).unwrap();
    let true_image = rollouts.step("a", 6).join("truth/CAM_FRONT.png");
    RgbImage::new(7, 9).save(&true_image).unwrap();
    rollouts.fail("a", 1, &["expected an image of 16x28 pixels, found 9x7", "000006/truth/CAM_FRONT.png"]);
    let image = rollouts.step("a", 4).join("generated/CAM_FRONT.png");
    let bytes = std::fs::read(&image).unwrap();
    truth(6, 1).save(&true_image).unwrap();
    std::fs::write(&image, &bytes[..bytes.len() - 30]).unwrap();
    rollouts.fail("a", 1, &["expected a whole PNG image, found", "000004/generated/CAM_FRONT.png"]);
    std::fs::write(&image, bytes).unwrap();
    let kind = rollouts.step("a", 4).join("generated.json");
    std::fs::write(&kind, r#"{"kind": "painted"}"#).unwrap();
    rollouts.fail(
        "a",
        1,
        &["expected kind \"generated\" or \"reference\"", "`painted`", "000004/generated.json"],
    );
    std::fs::remove_file(&kind).unwrap();
    rollouts.fail("a", 1, &["cannot read", "000004/generated.json"]);
    for step in (0..STEPS).step_by(2) {
        std::fs::write(rollouts.step("a", step).join("generated.json"), r#"{"kind": "reference"}"#).unwrap();
    }
    let expected = "expected generated images, found none in 36 steps (18 with references): a";
    rollouts.fail("a", 1, &[expected]);
    std::fs::write(rollouts.path("a/states.jsonl"), "{}\n").unwrap();
    rollouts.fail("a", 1, &["expected a state of step 0 in line 1", "states.jsonl"]);
}
