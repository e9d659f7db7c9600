//! Exports in the layouts of StreetCrafter and FreeVS through the command line.

use std::process::Command;

use image::codecs::jpeg::JpegEncoder;
use image::{RgbImage, imageops};
use serde_json::json;

use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{PSKEL, TinyLog, assert_failed, tree};

/// Seven frames at 5 Hz, of 16:9.
const TOWN: &str = "town:seed=7,frames=7,size=45x80";
const NAME: &str = "town-7-7f-overcast";

/// Both images are the lowest 384 rows at a width of 960 pixels, as JPEG of quality 95. Neither a killed
/// process nor the number of threads changes a byte. Python's tests read the list.
#[test]
fn freevs_images_are_the_lowest_rows_of_render() {
    let log = TinyLog::new();
    // Points of one frame are enough.
    log.succeed(&format!("build {TOWN} --frames 0..1 --out sks/{NAME}"));
    let maps = "--splat 100:0 --rasterizer cpu";
    let export = format!("export {TOWN} --skeletons sks --layout freevs {maps} --shard-frames 2");
    let reported = log.succeed(&format!("{export} --out out"));
    assert!(reported.starts_with("wrote 4 shards with 7 samples in "), "{reported}");
    let files = tree(&log.path("out"));
    let render = format!("render {TOWN} --skeleton sks/{NAME} {maps} --maps color --frames 5..6");
    log.succeed(&format!("{render} --size 540x960 --out rendered"));
    for (camera, number) in [("CAM_FRONT", 31), ("CAM_BACK", 34)] {
        let rendered = image::open(log.path(&format!("rendered/000005/{camera}/color.png"))).unwrap();
        let lowest: RgbImage = imageops::crop_imm(&rendered.into_rgb8(), 0, 156, 960, 384).to_image();
        let mut expected = Vec::new();
        JpegEncoder::new_with_quality(&mut expected, 95).encode_image(&lowest).unwrap();
        let exported = format!("waymo_pseudoimg_multiframe/{NAME}/{NAME}_10_{camera}.jpg");
        assert!(files[&exported] == expected, "{camera}");
        let recorded = &files[&format!("gt/{NAME}/{number:04}_{NAME}_10_{camera}.jpg")];
        let recorded = image::load_from_memory(recorded).unwrap();
        assert_eq!((recorded.width(), recorded.height()), (960, 384));
    }
    let clips = &log.json("out/index.json")["clips"];
    assert_eq!(*clips, json!({ "sequences": 6, "views": 42, "views_in_no_clip": 0 }));

    let again = format!("{export} --out again");
    let mut command = Command::new(PSKEL);
    let mut child = command.current_dir(log.path("")).args(again.split_whitespace()).spawn().unwrap();
    while !log.path("again/shards").exists() {
        std::thread::sleep(std::time::Duration::from_millis(5));
        assert!(child.try_wait().unwrap().is_none(), "the export has ended");
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(!log.path("again/freevs.pkl").exists());
    assert!(log.run_with(&again, "1").status.success());
    assert!(tree(&log.path("again")) == files);

    // A list of somebody else is not replaced.
    std::fs::write(log.path("again/freevs.pkl"), "years of work").unwrap();
    assert_failed(&log.run(&again), 1, &["expected a list of clips to replace", "again/freevs.pkl"]);
    std::fs::remove_file(log.path("again/freevs.pkl")).unwrap();
    log.succeed(&again);
    assert!(tree(&log.path("again")) == files);
}

#[test]
fn unsuited_rates_sizes_and_logs_are_refused() {
    let log = TinyLog::new();
    let export =
        |layout: &str| format!("export nuscenes:log --skeletons sks --rasterizer cpu --layout {layout}");
    for (layout, args, part) in [
        ("streetcrafter", "--hz 5", "expected samples at 10 Hz with the layout streetcrafter"),
        ("streetcrafter", "--between-images", "found images between key frames"),
        ("streetcrafter", "--out-size 576x1024", "expected --size alone with the layout streetcrafter"),
        ("streetcrafter", "--size 160x288", "expected a --size of at least 320x576"),
        ("freevs", "--hz 10", "expected samples at 5 Hz with the layout freevs"),
        ("freevs", "--size 256x448", "expected a size of 960 columns and at least 384 rows"),
        ("freevs", "--validation-logs a", "expected the layout streetcrafter with validation logs"),
        ("freevs", "--format npz", "expected the format png"),
    ] {
        log.fail(&format!("{} --out out {args}", export(layout)), 2, &[part]);
    }
    let rate = "expected samples at 5 Hz with the layout freevs (--hz 5, or key frames at 4.5 to 5.5 Hz)";
    let slow = log.run(&format!("{} --out slow", export("freevs")));
    assert_failed(&slow, 1, &[rate, ") in log tiny, found key frames at 2.0 Hz"]);
    let names = format!("{} --hz 10 --out names --validation-logs nobody", export("streetcrafter"));
    assert_failed(&log.run(&names), 1, &["for the validation split, found nobody"]);
    assert!(!log.path("names").exists());
    // Images of 2 Hz are not repeated for samples at other times, so there is no clip.
    let output = log.run(&format!("{} --hz 5 --out repeated", export("freevs")));
    assert_failed(&output, 1, &["at least 6 consecutive samples of a camera for a clip, found at most 2: "]);
    assert!(!log.path("repeated/index.json").exists());
}
