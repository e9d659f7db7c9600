//! Peer commands end with the program, however it ends.

use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use pskel_sim::peer::PeerAddress;
use pskel_sim::{EgoPolicy, PlannerSpec, SimOptions, Simulation};
use rustix::process::{Pid, Signal, kill_process};

use super::{SIMULATE, built};
use crate::sim::made;
use crate::tiny_log::with_default_signals;

/// Maximum time that processes may outlive the program.
const MAX_TIME: Duration = Duration::from_secs(2);

/// Returns a command that neither reads nor answers nor ends, with a child and a grandchild; all ignore
/// termination signals. Each writes its process id to a file.
fn planner(folder: &Path) -> String {
    let at = |name: &str| folder.join(name).display().to_string();
    let sleep =
        |name: &str| format!("echo $$ > {0}.new; mv {0}.new {0}; while :; do sleep 1; done", at(name));
    let script = |name: &str, lines: String| {
        let path = folder.join(name);
        std::fs::write(&path, format!("trap '' HUP TERM INT\n{lines}\n")).unwrap();
        path.display().to_string()
    };
    let grandchild = script("grandchild.sh", sleep("grandchild"));
    let child = script("child.sh", format!("sh {grandchild} &\n{}", sleep("child")));
    let group = format!("cut -d' ' -f5 /proc/$$/stat > {}", at("group"));
    let command = script("command.sh", format!("{group}\nsh {child} &\n{}", sleep("command")));
    format!("sh {command}")
}

/// Returns the process ids of the planner's processes, once all have started.
fn started(folder: &Path) -> Vec<u32> {
    let files: Vec<PathBuf> = ["command", "child", "grandchild"].map(|name| folder.join(name)).into();
    let start = Instant::now();
    while !files.iter().all(|file| file.exists()) {
        assert!(start.elapsed() < Duration::from_secs(60), "the planner starts");
        std::thread::sleep(Duration::from_millis(10));
    }
    files.iter().map(|file| std::fs::read_to_string(file).unwrap().trim().parse().unwrap()).collect()
}

/// Returns the group of a process; `None` if it has ended, even as a zombie.
fn group_of(pid: u32) -> Option<u32> {
    let about = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    let (_, rest) = about.rsplit_once(')')?;
    let mut fields = rest.split_whitespace();
    let state = fields.next()?;
    let group = fields.nth(1)?.parse().ok()?;
    (state != "Z" && state != "X").then_some(group)
}

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

/// A stopped planner leaves no guard process behind, neither running nor as a zombie.
#[test]
fn a_stopped_planner_leaves_no_process() {
    let log = made::log(6);
    let folder = tempfile::tempdir().unwrap();
    let address = PeerAddress::Command(planner(folder.path()));
    let ego = EgoPolicy::External(PlannerSpec { address, timeout_s: 5.0 });
    let options = SimOptions { steps: 60, warmup_frames: 3, ego, ..SimOptions::default() };
    assert!(Simulation::new(&made::scenario(&log), options).is_err(), "it does not answer");
    let pids = started(folder.path());
    for pid in pids {
        let start = Instant::now();
        while group_of(pid).is_some() {
            assert!(start.elapsed() < MAX_TIME, "{pid} goes on");
            std::thread::sleep(Duration::from_millis(10));
        }
    }
    // The guard's process id is also its group's. A zombie would still have an entry.
    let guard = std::fs::read_to_string(folder.path().join("group")).unwrap();
    assert!(!Path::new("/proc").join(guard.trim()).exists(), "guard {guard}");
}
