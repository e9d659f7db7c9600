//! The folder of a rollout: conditions for resuming it, and its content.

use serde_json::json;

use super::{SIMULATE, assert_page_is_whole, built, planner, rows};
use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{TinyLog, assert_failed, tree};

/// Asserts that a command fails and leaves the rollout unchanged.
#[track_caller]
fn refused(log: &TinyLog, args: &str, parts: &[&str]) {
    let before = tree(&log.path("out"));
    assert_failed(&log.run(args), 1, parts);
    assert!(tree(&log.path("out")) == before, "{args}");
}

#[test]
fn a_rollout_resumes_only_with_its_original_inputs() {
    let log = built();
    std::fs::write(log.path("sunny.json"), r#"{"weather": "Sunny"}"#).unwrap();
    std::fs::write(log.path("rainy.json"), r#"{"weather": "Rainy"}"#).unwrap();
    let args = |annotations: &str, rest: &str| {
        format!("{SIMULATE} --maps depth --ego straight {annotations} {rest}")
    };
    log.succeed(&args("--annotations sunny.json", "--steps 8"));
    let more = "--steps 9 --resume";
    // Another prompt, or none.
    let expected = ["expected the prompt of out/rollout.json", "Sunny", "Rainy", ": rainy.json"];
    refused(&log, &args("--annotations rainy.json", more), &expected);
    refused(&log, &args("", more), &["Sunny", "found {\"city\":null,\"weather\":null}"]);
    // Another skeleton of the same log.
    log.succeed("build nuscenes:log --out coarse --voxel 0.5");
    let coarse = args("--annotations sunny.json", more).replace("--skeleton sk", "--skeleton coarse");
    refused(&log, &coarse, &["expected the skeleton of out/rollout.json", " points ", ": coarse\n"]);
    // Another log of the same name: one actor has another position.
    log.change("sample_annotation", "/1/translation/1", json!(3_997_005.0));
    let sunny = args("--annotations sunny.json", more);
    refused(&log, &sunny, &["expected the frames of out/rollout.json", "3 frames from", ": log\n"]);
    log.change("sample_annotation", "/1/translation/1", json!(3_997_004.0));
    // Identical inputs at other paths are accepted.
    std::fs::rename(log.path("sk"), log.path("moved")).unwrap();
    std::fs::rename(log.path("sunny.json"), log.path("same.json")).unwrap();
    log.succeed(&args("--annotations same.json", more).replace("--skeleton sk", "--skeleton moved"));
    assert_eq!(rows(&log, "out").len(), 10);
}

#[test]
fn rejects_fewer_steps_than_exist() {
    let log = built();
    let args = |rest: &str| format!("{SIMULATE} --maps depth --ego straight {rest}");
    log.succeed(&args("--steps 8"));
    let parts = ["expected 8 steps or more to resume after step 8, found 5", "states.jsonl"];
    refused(&log, &args("--steps 5 --resume"), &parts);
    refused(&log, &args("--steps 5 --resume-from 6"), &["6 steps or more", "found 5"]);
    let summary = log.succeed(&args("--steps 8 --resume"));
    assert!(
        summary.contains("no steps left to simulate") && !summary.contains("steps a second"),
        "{summary}"
    );
    assert!(summary.starts_with("simulated 8 steps, "), "{summary}");
    // An earlier step may become the last.
    log.succeed(&args("--steps 5 --resume-from 5"));
    assert_page_is_whole(&log, "out", 6);
}

#[test]
fn maps_and_rollouts_do_not_share_a_folder() {
    let log = built();
    let simulate = format!("{SIMULATE} --maps depth --steps 1");
    let render = "render nuscenes:log --skeleton sk --out out --maps depth --rasterizer cpu";
    log.succeed(&simulate);
    refused(&log, render, &["expected a folder of kind maps, or a new one, found one of kind rollout: out"]);
    std::fs::remove_dir_all(log.path("out")).unwrap();
    log.succeed(render);
    refused(
        &log,
        &simulate,
        &["expected a folder of kind rollout, or a new one, found one of kind maps: out"],
    );
    refused(
        &log,
        &format!("{simulate} --resume"),
        &["expected a folder of kind rollout, or a new one, found one of kind maps: out"],
    );
}

#[test]
fn the_result_of_a_rollout_is_reported() {
    let log = built();
    let summary = log.succeed(&format!("{SIMULATE} --maps depth --steps 8"));
    let results = ": 0 collisions; comfortable; \
        deviation from the recorded path at most 0.00 m and 0.0 degrees; a step takes";
    assert!(summary.contains(results) && !summary.contains("beyond"), "{summary}");
    assert_eq!(log.json("out/metrics.json")["steps_beyond_log"], 0);
    // The log has 12 steps.
    let summary = log.succeed(&format!("{SIMULATE} --maps depth --steps 15 --ego straight"));
    assert!(
        summary.contains("; 3 steps lie beyond the end of the log: only actors under a policy"),
        "{summary}"
    );
    assert_eq!(log.json("out/metrics.json")["steps_beyond_log"], 3);
    let left: Vec<usize> =
        rows(&log, "out")[12..].iter().map(|row| row["actors"].as_array().unwrap().len()).collect();
    assert_eq!(left, [2, 0, 0, 0]);
}

#[test]
fn a_failing_report_does_not_hide_the_rollouts_error() {
    let log = built();
    // The planner blocks the path of the metrics file with a folder, then exits.
    planner(&log, "read -r observation; mkdir -p out/metrics.json/full; exit 3");
    let output = log.run(&format!("{SIMULATE} --maps depth --steps 9 --ego external --planner ./planner.sh"));
    assert_failed(&output, 1, &["error: stopped after 7 steps", "exit status: 3"]);
    assert_failed(
        &output,
        1,
        &[
            "warning: after the rollout had failed: expected only files that pskel wrote",
            "out/metrics.json/full",
        ],
    );
}
