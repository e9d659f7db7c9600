//! LiDAR sweeps beside the maps: files of frames and steps, resuming, planners and MCAP files.

use foxglove::messages::PointCloud;
use serde_json::{Value, json};

use super::mcap_file::McapFile;
use super::{SIMULATE, built, planner, rows};
use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{TinyLog, assert_failed, tree};

/// Writes the description of a small device.
fn device(log: &TinyLog, name: &str, columns: usize) {
    let elevations: Vec<f64> = (0..16).map(|beam| -20.0 + 1.5 * f64::from(beam)).collect();
    let device = json!({"name": "top", "elevations_deg": elevations, "columns": columns,
        "range_m": [1.0, 80.0], "sweep_s": 0.1, "dropout": 0.1});
    std::fs::write(log.path(name), json!({"devices": [device], "seed": 1}).to_string()).unwrap();
}

/// Returns the rows of `lidar.pcd.bin` of a folder: x, y, z, intensity, ring.
fn points(log: &TinyLog, folder: &str) -> Vec<[f32; 5]> {
    let bytes = std::fs::read(log.path(&format!("{folder}/lidar.pcd.bin"))).unwrap();
    let number = |bytes: &[u8]| f32::from_le_bytes(bytes.try_into().unwrap());
    bytes.chunks(20).map(|row| [0, 4, 8, 12, 16].map(|at| number(&row[at..at + 4]))).collect()
}

fn simulate(out: &str, rest: &str) -> String {
    let command = SIMULATE.replace("--out out", &format!("--out {out}"));
    format!("{command} --maps depth --lidar top.json {rest}")
}

#[test]
fn frames_and_steps_have_sweeps() {
    let log = built();
    device(&log, "top.json", 180);
    log.succeed(
        "render nuscenes:log --skeleton sk --out maps --rasterizer cpu --maps depth --lidar top.json",
    );
    log.succeed(&simulate("out", "--steps 8 --mcap out.mcap"));
    let meta = log.json("out/steps/000006/lidar.json");
    let found = points(&log, "out/steps/000006");
    assert!(found.len() > 100, "{}", found.len());
    assert_eq!((&meta["points"], &meta["file"]), (&found.len().into(), &"lidar.pcd.bin".into()));
    assert_eq!(meta["t_us"], rows(&log, "out")[6]["t_us"]);
    assert!(found.iter().all(|[x, y, z, _, ring]| x.hypot(*y).hypot(*z) < 82.0 && *ring < 16.0));
    // A frame and the step at its time have the same poses, as the ego of the log moves evenly.
    let frame = points(&log, "maps/000001");
    let apart = |a: &[f32; 5], b: &[f32; 5]| (0..3).map(|i| (a[i] - b[i]).abs()).fold(0.0, f32::max);
    assert!(frame.len().abs_diff(found.len()) <= frame.len() / 50, "{} and {}", frame.len(), found.len());
    let same = frame.iter().filter(|point| found.iter().any(|other| apart(point, other) < 0.05)).count();
    assert!(same * 50 >= frame.len() * 49, "{same} of {}", frame.len());
    // The MCAP file has the same points, in the ego frame.
    let mcap = McapFile::of(&log, "out.mcap");
    let sweeps = mcap.decoded::<PointCloud>("/lidar");
    assert_eq!(sweeps.len(), 9);
    let (time, sweep) = &sweeps[6];
    assert_eq!((*time, sweep.frame_id.as_str()), (1000 * meta["t_us"].as_u64().unwrap(), "ego"));
    assert_eq!(sweep.data, std::fs::read(log.path("out/steps/000006/lidar.pcd.bin")).unwrap());
    let fields: Vec<_> = sweep.fields.iter().map(|field| (field.name.as_str(), field.offset)).collect();
    assert_eq!(fields, [("x", 0), ("y", 4), ("z", 8), ("intensity", 12), ("ring", 16)]);
    assert_eq!(sweep.point_stride, 20);
    let options = &log.json("out/rollout.json")["lidar"]["devices"][0];
    assert_eq!((&options["name"], &options["columns"]), (&json!("top"), &json!(180)));
    assert!(options["ego_from_lidar"].is_object(), "mounted where the log's LiDAR is: {options}");
}

#[test]
fn resumed_rollouts_have_the_same_sweeps() {
    let log = built();
    device(&log, "top.json", 90);
    device(&log, "other.json", 91);
    let policies = "--ego lane_change --actors idm --lidar-format pcd";
    log.succeed(&simulate("whole", &format!("--steps 9 {policies} --mcap whole.mcap")));
    let whole = tree(&log.path("whole"));
    assert!(whole.contains_key("steps/000009/lidar.pcd"));
    log.succeed(&simulate("out", &format!("--steps 4 {policies}")));
    log.succeed(&simulate("out", &format!("--steps 9 --resume {policies} --mcap out.mcap")));
    assert!(tree(&log.path("out")) == whole);
    assert!(McapFile::of(&log, "out.mcap") == McapFile::of(&log, "whole.mcap"));
    for other in ["other.json", "hdl-32e"] {
        let args = simulate("out", &format!("--steps 9 --resume {policies}")).replace("top.json", other);
        assert_failed(&log.run(&args), 1, &["the options of the rollout, lidar", "rollout.json"]);
        assert!(tree(&log.path("out")) == whole);
    }
    let none = simulate("out", "--steps 9 --resume --ego lane_change --actors idm");
    assert_failed(&log.run(&none.replace(" --lidar top.json", "")), 1, &["lidar", "rollout.json"]);
}

#[test]
fn planners_read_the_sweep_of_each_step() {
    let log = built();
    device(&log, "top.json", 90);
    let first = "read -r observation\necho \"$observation\" > observed.json\nanswer";
    planner(&log, &format!("{first}\nwhile read -r observation; do answer; done"));
    log.succeed(&simulate("out", "--steps 8 --ego external --planner ./planner.sh"));
    let observed: Value = log.json("observed.json");
    let files: Vec<&str> = observed["files"].as_array().unwrap().iter().flat_map(Value::as_str).collect();
    for name in ["000006/lidar.pcd.bin", "000006/lidar.json"] {
        assert!(files.iter().any(|file| file.ends_with(name)), "{files:?}");
    }
}
