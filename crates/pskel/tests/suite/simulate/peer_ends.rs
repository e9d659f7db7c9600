//! Peer commands end with the program, however it ends.

use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};

use super::{SIMULATE, built};
use crate::tiny_log::with_default_signals;
use pskel_testing::stubborn_peer::{group_of, planner, started};

/// Maximum time that processes may outlive the program.
const MAX_TIME: Duration = Duration::from_secs(2);

/// Returns the running processes of a group.
fn members(group: u32) -> Vec<u32> {
    let all = std::fs::read_dir("/proc").unwrap();
    let pids = all.filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok());
    pids.filter(|pid| group_of(*pid) == Some(group)).collect()
}

#[track_caller]
fn assert_all_end(group: u32, what: &str) {
    let start = Instant::now();
    while !members(group).is_empty() {
        assert!(start.elapsed() < MAX_TIME, "{what}: {:?} go on", members(group));
        std::thread::sleep(Duration::from_millis(10));
    }
}

fn simulate(folder: &Path, planner: &str) -> Child {
    let mut command = with_default_signals();
    let args = format!("{SIMULATE} --steps 12 --ego external --planner-timeout 600 --planner");
    command.current_dir(folder).args(args.split(' ')).arg(planner);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

#[test]
fn planners_end_with_the_program() {
    let log = built();
    for (signal, name) in [(Signal::KILL, "SIGKILL"), (Signal::TERM, "SIGTERM"), (Signal::INT, "SIGINT")] {
        let folder = tempfile::tempdir().unwrap();
        let mut child = simulate(&log.path(""), &planner(folder.path()));
        let pids = started(folder.path());
        let group = group_of(pids[0]).unwrap();
        assert!(pids.iter().all(|pid| group_of(*pid) == Some(group)), "one group");
        kill_process(Pid::from_child(&child), signal).unwrap();
        let start = Instant::now();
        while child.try_wait().unwrap().is_none() {
            assert!(start.elapsed() < Duration::from_secs(30), "{name}");
            std::thread::sleep(Duration::from_millis(10));
        }
        assert_all_end(group, name);
    }
}
