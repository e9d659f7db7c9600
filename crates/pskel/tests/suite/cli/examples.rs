//! The examples write the maps that the command writes.

#[allow(unreachable_pub)] // `run` is public in the example
#[path = "../../../../../examples/closed_loop.rs"]
mod closed_loop;
#[allow(unreachable_pub)]
#[path = "../../../../../examples/render_frame.rs"]
mod render_frame;

use std::collections::BTreeMap;

use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{TinyLog, tree};

/// Returns the PNGs of all cameras below a folder; there must be some.
fn maps(log: &TinyLog, folder: &str) -> BTreeMap<String, Vec<u8>> {
    let mut files = tree(&log.path(folder));
    files.retain(|name, _| name.split('/').any(|part| part.starts_with("CAM")) && name.ends_with(".png"));
    assert!(files.len() >= 10, "{folder}: {} files", files.len());
    files
}

#[test]
fn render_frame_writes_the_maps_of_the_command() {
    let log = TinyLog::new();
    let name = format!("nuscenes:{}", log.path("log").display());
    render_frame::run(&name, &log.path("example")).unwrap();
    log.succeed("build nuscenes:log --out sk");
    let options = "--frames 0..1 --ego-offset left_m=2 --maps color,depth,class,instance,boxes";
    log.succeed(&format!("render nuscenes:log --skeleton sk --out maps {options}"));
    assert!(maps(&log, "example/maps") == maps(&log, "maps"));
}

#[test]
fn closed_loop_writes_the_maps_of_the_command() {
    let log = TinyLog::new();
    let name = format!("nuscenes:{}", log.path("log").display());
    closed_loop::run(&name, 4, &log.path("example")).unwrap();
    log.succeed("build nuscenes:log --out sk");
    let options = "--steps 4 --ego straight --actors idm --sim-hz 10 --plan-hz 5 --warmup 1";
    log.succeed(&format!(
        "simulate nuscenes:log --skeleton sk --out out {options} --maps color,depth,class,instance,boxes"
    ));
    let mut expected = maps(&log, "out/steps");
    expected.retain(|name, _| !name.contains("view/"));
    assert!(maps(&log, "example/steps") == expected);
}
