//! Logs of other formats than nuScenes.

use std::process::Command;

use point_skeleton::dataset::{LogLocator, expand};
use pskel::logs;
use pskel_eval::protocol::SIMGEN;

use crate::tiny_log::PSKEL;
use pskel_testing::av2_log::{SIZE, TinyAv2};
use pskel_testing::nuplan_log::{FRAMES, LOG, NuplanLog, RING, assert_says, image_file, sweep_file};

fn pskel(folder: &std::path::Path, args: &str) -> String {
    let mut command = Command::new(PSKEL);
    let output = command
        .current_dir(folder)
        .args(args.split_whitespace())
        .env("PSKEL_VALIDATION", "1")
        .output()
        .unwrap();
    assert!(output.status.success(), "{args}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// The front camera sees the car 8 m away, with and without images.
#[test]
fn a_log_is_built_and_rendered_with_images_and_without() {
    let made = TinyAv2::new();
    let root = made.root();
    let info = pskel(root, "info av2:.");
    for part in [
        "0a1b2c3d (PIT)",
        "3 over 0.2 s at 10.0 Hz",
        "3 with 7431 points",
        "ring_front_left",
        "vehicle.car.regular_vehicle",
        "PIT with 1 crossings, 2 dividers, 1 drivable areas, 1 lane connectors, 2 lanes, 0 stop lines",
        "damaged    nothing",
    ] {
        assert!(info.contains(part), "{info}\nlacks {part}");
    }
    for images in [true, false] {
        if !images {
            std::fs::remove_dir_all(made.path("sensors/cameras")).unwrap();
        }
        pskel(root, "build av2:0a1b2c3d --out sk");
        let render = "render av2:0a1b2c3d --skeleton sk --out out --rasterizer cpu --format npz --splat \
            100:0 --frames 1..2 --no-default-templates";
        let summary = pskel(root, render);
        assert_eq!(summary.contains("missing images"), !images, "{summary}");
        assert!(summary.contains("7 camera views"), "{summary}");
        let maps = root.join("out/000001/maps.npz");
        let class = pskel_testing::npz::read::<u8>(&maps, "class");
        let depth = pskel_testing::npz::read::<f32>(&maps, "depth").data;
        let pixels = usize::from(SIZE[0]) * usize::from(SIZE[1]);
        assert_eq!(class.shape, [7, SIZE[0].into(), SIZE[1].into()]);
        let on_car: Vec<usize> = (0..7 * pixels).filter(|i| class.data[*i] == 1).collect();
        // The car is in the front view, at the inner edges of the two adjacent views, and nowhere else.
        let mut seen_by: Vec<usize> = on_car.iter().map(|i| i / pixels).collect();
        seen_by.dedup();
        assert_eq!(seen_by, [0, 1, 6]);
        // Images are taken when the ego is 0.1 m further along; without images the camera is at the frame's
        // own pose.
        let expected = if images { 7.9 } else { 8.0 };
        let in_front = || on_car.iter().filter(|i| **i < pixels);
        assert!(in_front().all(|i| (depth[*i] - expected).abs() < 2e-3), "{}", depth[on_car[0]]);
        let color = pskel_testing::npz::read::<u8>(&maps, "color").data;
        let grey = color.chunks(3).filter(|p| *p != [0; 3]).all(|p| p == [128; 3]);
        assert_eq!(grey, !images);
    }
}

#[test]
fn folders_and_sets_name_several_logs() {
    let made = NuplanLog::new();
    let folder = made.path("nuplan-v1.1/splits/mini");
    let name = |text: &str| logs::locate(&format!("{text}{}", folder.display())).unwrap();
    let expanded = |locator: &LogLocator| {
        let logs = expand(locator).map(|logs| logs.into_iter().map(|l| l.path).collect::<Vec<_>>());
        logs.map_err(|e| e.to_string())
    };
    assert_eq!(logs::open(&name("nuplan:")).unwrap().recording().name, LOG);
    std::fs::copy(made.database(), folder.join("b.db")).unwrap();
    std::fs::write(folder.join("notes.txt"), "").unwrap();
    assert_eq!(expanded(&name("nuplan:")).unwrap(), [made.database(), folder.join("b.db")]);
    let message = logs::open(&name("nuplan:")).err().unwrap().to_string();
    assert_says(&message, &[&format!("#LOG to name one of {LOG}, b, found none")], "splits/mini");
    let chosen = LogLocator { scene: Some("b".into()), ..name("nuplan:") };
    assert_eq!(expanded(&chosen).unwrap(), [folder.join("b.db")]);
    let unknown = LogLocator { scene: Some("c".into()), ..name("nuplan:") };
    assert_says(&expanded(&unknown).unwrap_err(), &["found c"], "splits/mini");
    let versioned = LogLocator { version: Some("v1.1".into()), ..name("nuplan:") };
    assert_says(&expanded(&versioned).unwrap_err(), &["without @VERSION, found @v1.1"], "splits/mini");

    for log in &SIMGEN[..8] {
        std::fs::copy(made.database(), folder.join(format!("{log}.db"))).unwrap();
    }
    let missing = format!("found none named {}, {}", SIMGEN[8], SIMGEN[9]);
    assert_says(&expanded(&name("nuplan-simgen:")).unwrap_err(), &[&missing], "splits/mini");
    for log in &SIMGEN[8..] {
        std::fs::copy(made.database(), folder.join(format!("{log}.db"))).unwrap();
    }
    assert_eq!(
        expanded(&name("nuplan-simgen:")).unwrap(),
        SIMGEN.map(|log| folder.join(format!("{log}.db")))
    );
    let one = LogLocator { scene: Some(SIMGEN[3].into()), ..name("nuplan-simgen:") };
    assert_eq!(logs::open(&one).unwrap().recording().frames.len(), FRAMES);
    let file = LogLocator { format: &pskel_eval::protocol::SIMGEN_FORMAT, ..made.locator() };
    assert!(expanded(&file).unwrap_err().contains("found a file"));
    let empty = LogLocator::new(&point_skeleton::dataset::nuplan::FORMAT, made.path("maps"));
    assert_says(&expanded(&empty).unwrap_err(), &["nuPlan logs (.db)", "found none"], "maps");
}

#[test]
fn the_commands_run_on_eight_cameras() {
    let made = NuplanLog::new();
    std::fs::remove_file(made.blob(&image_file(RING[5], 1))).unwrap();
    let log = format!("nuplan:{}", made.database().display());
    let run = |args: &[&str]| {
        let output = Command::new(PSKEL).args(args).current_dir(made.path("")).output().unwrap();
        assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    let output = Command::new(PSKEL).args(["info", &log]).output().unwrap();
    let info = String::from_utf8(output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(info.contains("missing image files: 1") && info.contains("damaged    1 file, missing"), "{info}");
    assert!(info.contains("4 over 0.1 s at 20.0 Hz"), "{info}");
    let built = run(&["build", &log, "--out", "skeleton"]);
    assert!(
        built.contains("from 4 frames") && built.contains("the log has 1 missing image files"),
        "{built}"
    );
    run(&[
        "render",
        &log,
        "--skeleton",
        "skeleton",
        "--out",
        "maps",
        "--rasterizer",
        "cpu",
        "--frames",
        "0..1",
    ]);
    let cameras = RING.map(|camera| made.path(&format!("maps/000000/{camera}/color.png")).is_file());
    assert_eq!(cameras, [true; 8]);
    assert!(run(&["info", &made.blob(&sweep_file(0)).to_string_lossy()]).contains("3220"));
}
