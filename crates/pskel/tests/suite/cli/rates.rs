//! `pskel render --hz`: frames at other rates than the log's.

use serde_json::json;

use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{FIRST_US, START, STEP_US, TinyLog, WIDTH};
use pskel_testing::npz;

#[test]
fn render_at_a_rate_covers_the_selected_frames() {
    let log = TinyLog::new();
    log.succeed("build nuscenes:log --out sk");
    let render = "render nuscenes:log --skeleton sk --format npz --splat 100:0 --out out";
    let summary = log.succeed(&format!("{render} --hz 12 --maps depth,instance"));
    assert!(summary.starts_with("rendered 13 frames, 26 camera views"), "{summary}");
    let index = log.json("out/index.json");
    assert_eq!(index["options"]["hz"], 12.0);
    for (i, frame) in index["frames"].as_array().unwrap().iter().enumerate() {
        let t_us = FIRST_US + (i as f64 * 1e6 / 12.0).round() as i64;
        assert_eq!((&frame["name"], &frame["t_us"]), (&json!(t_us.to_string()), &json!(t_us)));
        // The ego drives at 2 m/s; the car at 4 m/s, starting 10 m ahead.
        let seconds = (t_us - FIRST_US) as f64 * 1e-6;
        let x = frame["ego"][0][3].as_f64().unwrap();
        assert!((x - START.x - 2.0 * seconds).abs() < 1e-8, "{i}: {x}");
        assert_eq!(frame["actors"].as_array().unwrap().len(), 2);
        let meta = log.json(&format!("out/{t_us}/meta.json"));
        assert_eq!(meta["fps"], 12.0);
        for camera in meta["cameras"].as_array().unwrap() {
            assert_eq!(camera["global_from_ego"], frame["ego"]);
        }
        let maps = log.path(&format!("out/{t_us}/maps.npz"));
        let (instance, depth) =
            (npz::read::<u32>(&maps, "instance").data, npz::read::<f32>(&maps, "depth").data);
        let on_car = depth.iter().zip(&instance).filter(|(_, number)| **number == 1).map(|(d, _)| *d);
        let nearest = on_car.reduce(f32::min).unwrap();
        assert!((f64::from(nearest) - 10.0 - 2.0 * seconds).abs() < 1e-3, "{i}: {nearest}");
    }
    // Only the selected frames: from frame 1 to frame 2, at a rate that does not hit the end.
    log.succeed(&format!("{render}/part --hz 3 --frames 1..3 --ego-offset left_m=1"));
    let index = log.json("out/part/index.json");
    let names: Vec<String> =
        index["frames"].as_array().unwrap().iter().map(|f| f["name"].as_str().unwrap().into()).collect();
    let from = FIRST_US + STEP_US;
    assert_eq!(names, [from.to_string(), (from + 333_333).to_string()]);
    assert_eq!(index["frames"][0]["ego"][1][3], START.y + 1.0);
    // A single frame gives a single time.
    log.succeed(&format!("{render}/one --hz 100 --frames 1..2"));
    assert_eq!(log.json("out/one/index.json")["frames"].as_array().unwrap().len(), 1);
    assert_eq!(
        npz::read::<f32>(&log.path(&format!("out/one/{from}/maps.npz")), "depth").shape[2],
        WIDTH as usize
    );
}
