//! Another recording with the name of an earlier one is not taken for it: in skeletons, rollouts, protocols
//! and drives.

use point_skeleton::cloud::Bounds;
use point_skeleton::error::FileError;
use point_skeleton::files::Checksum;
use point_skeleton::files::Inputs;
use point_skeleton::skeleton::{
    Template, TemplateLibrary, TemplateOptions, TemplateReport, default_templates,
};
use serde_json::{Value, json};

use crate::simulate::mcap_file::McapFile;
use crate::simulate::{SIMULATE, built};
use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{START, TinyLog, assert_failed, tree};

/// Focal length of the camera in front.
const FOCAL: (&str, &str) = ("calibrated_sensor", "/1/camera_intrinsic/0/0");
const EXPORT: &str =
    "export nuscenes:log --skeletons sks --out out --layout webdataset --out-size 32x48 --rasterizer cpu";

/// Writes a library of one template to `templates`, without some of its points.
fn write_templates(log: &TinyLog, left_out: usize) {
    let (template, mut points) = default_templates().swap_remove(0);
    points.truncate(points.len() - left_out);
    let (bounds, xxh3) = (Bounds::of(&points).unwrap(), Checksum::of(&points));
    let template = Template { points: points.len(), bounds, xxh3, ..template };
    let nuplan = (vec![(template, points)], TemplateReport::default());
    let library = TemplateLibrary::new(Vec::new(), TemplateOptions::default(), nuplan);
    let target = TemplateLibrary::target(&log.path("templates"), &Inputs::default()).unwrap();
    library.write::<FileError>(target, |_| Ok(())).unwrap();
}

#[test]
fn rollouts_of_other_cameras_or_templates_are_not_continued() {
    let log = built();
    write_templates(&log, 0);
    let simulate = format!("{SIMULATE} --maps depth --templates templates --steps");
    log.succeed(&format!("{simulate} 1"));
    let whole = tree(&log.path("out"));
    log.change(FOCAL.0, FOCAL.1, json!(30.0));
    let output = log.run(&format!("{simulate} 2 --resume"));
    assert_failed(&output, 1, &["expected the frames of out/rollout.json", "use another folder"]);
    // The skeleton is one of the other recording, which may be wanted.
    assert_failed(&output, 1, &["warning: the skeleton was built from another recording", ": sk\n"]);
    log.change(FOCAL.0, FOCAL.1, json!(48.0));
    write_templates(&log, 1);
    let output = log.run(&format!("{simulate} 2 --resume"));
    assert_failed(&output, 1, &["the options of the rollout, library", "out/rollout.json"]);
    assert!(!String::from_utf8_lossy(&output.stderr).contains("another recording"));
    assert!(tree(&log.path("out")) == whole);
}

#[test]
fn rejects_shards_with_other_templates() {
    let log = built();
    write_templates(&log, 0);
    let export = format!("{EXPORT} --templates templates");
    log.succeed(&export);
    let whole = tree(&log.path("out"));
    let again = log.succeed(&export);
    assert!(again.contains("1 already existed"), "{again}");
    write_templates(&log, 1);
    assert_failed(&log.run(&export), 1, &["expected a shard of this template library", "--verify"]);
    assert!(tree(&log.path("out")) == whole);
    let verified = log.succeed(&format!("{export} --verify"));
    assert!(!verified.contains("there already"), "{verified}");
    log.succeed(&export);
}

#[test]
fn protocols_retain_only_rollouts_of_the_same_recording() {
    let log = built();
    let protocol = "protocol lane-change nuscenes:log --skeletons sks --out p --rasterizer cpu --maps color \
        --parts replay \
                    --window 2 --generator fill";
    for _ in 0..2 {
        let output = log.run(protocol);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    log.change(FOCAL.0, FOCAL.1, json!(30.0));
    assert_failed(&log.run(protocol), 1, &["expected a skeleton of the recording tiny", "sks/tiny"]);
    std::fs::remove_dir_all(log.path("sks")).unwrap();
    let parts = ["part replay, clip tiny", "expected the frames of p/replay/tiny/rollout.json"];
    assert_failed(&log.run(protocol), 1, &parts);
}

#[test]
fn protocols_retain_only_rollouts_with_the_same_captions() {
    let log = built();
    let protocol = "protocol lane-change nuscenes:log --skeletons sks --out p --rasterizer cpu --maps color \
        --parts replay \
                    --window 2 --generator fill --captions c.json";
    for (caption, refused) in [("sun", false), ("rain", true), ("sun", false)] {
        std::fs::write(log.path("c.json"), json!({"tiny": caption}).to_string()).unwrap();
        let output = log.run(protocol);
        if refused {
            assert_failed(&output, 1, &["expected the captions of this command", "p/protocol.json"]);
        } else {
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        }
    }
}

#[test]
fn a_lost_first_pose_is_noted_and_does_not_move_the_origin() {
    for frame in [0, 2] {
        let log = TinyLog::new();
        log.change("ego_pose", &format!("/{frame}/translation"), json!([0, 0, 0]));
        let jumps = "jumps of the ego by more than 1 km from one pose to the next";
        let output = log.run("info --json nuscenes:log");
        let info: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(info["left_out"][jumps], json!(1));
        let built = log.succeed("build nuscenes:log --out sk");
        assert!(built.contains(&format!("1 {jumps}")), "{built}");
        let output = log.run("convert sk --out clouds");
        let reported = String::from_utf8_lossy(&output.stderr);
        assert!(
            output.status.success() && reported.contains("lie more than 16384 m from the origin"),
            "{reported}"
        );
        let origin = &log.json("clouds/origins.json")["background"]["origin"];
        let origin: [f64; 3] = serde_json::from_value(origin.clone()).unwrap();
        assert!((glam::DVec3::from(origin) - START).abs().max_element() < 100.0, "{origin:?}");
        log.succeed(&format!("{SIMULATE} --steps 1 --maps depth --mcap a.mcap"));
        let read = McapFile::of(&log, "a.mcap");
        let first = if frame == 0 { START + glam::DVec3::X } else { START };
        assert_eq!(read.metadata["log"]["map_origin"], json!(first.to_array()).to_string());
    }
    let log = built();
    let output = log.run("convert sk --out clouds");
    assert!(
        output.status.success() && !String::from_utf8_lossy(&output.stderr).contains("note"),
        "{output:?}"
    );
    let info: Value = serde_json::from_slice(&log.run("info --json nuscenes:log").stdout).unwrap();
    assert!(!info["left_out"].to_string().contains("jumps"), "{}", info["left_out"]);
}
