//! Output folders and files: replaced files, untouched files, and the state after an interruption.

use std::io::Read;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};

use crate::simulate::{built, planner};
use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{PSKEL, TinyLog, assert_failed, tree, with_default_signals};

const RENDER: &str = "render nuscenes:log --skeleton sk --out out --maps depth --rasterizer cpu";
const SIMULATE: &str =
    "simulate nuscenes:log --skeleton sk --out out --maps depth --rasterizer cpu --steps 2";
const EXTERNAL: &str = "simulate nuscenes:log --skeleton sk --out out --maps depth --rasterizer cpu --steps \
    20 \
    --ego external --planner ./planner.sh --planner-timeout 600";
const TOWN: &str = "town seed=5,frames=1,size=57x100 --out out";
const TEMPLATES: &str = "templates sk --min-points 1 --out out";
const CONVERT: &str = "convert sk --out out";

/// Returns a log with a skeleton, without a folder `out`.
fn ready() -> TinyLog {
    let log = built();
    std::fs::remove_dir_all(log.path("out")).unwrap();
    log
}

/// Creates a file that was not written by any run.
fn put(log: &TinyLog, name: &str) {
    let path = log.path(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, "years of work").unwrap();
}

#[test]
fn foreign_files_are_never_deleted() {
    // Foreign files in a folder that was never an output, and in the output of an earlier run.
    for (args, fresh, within) in [
        (CONVERT, "thesis.tex", "out/actors/thesis.tex"),
        (TOWN, "thesis.tex", "out/samples/CAM_FRONT/thesis.tex"),
        (TEMPLATES, "car.png", "out/thesis.png"),
        (RENDER, "index.json", "out/000001/CAM_FRONT/thesis.tex"),
        (SIMULATE, "steps/thesis.tex", "out/steps/000001/thesis.tex"),
    ] {
        let log = ready();
        put(&log, &format!("out/{fresh}"));
        let before = tree(&log.path("out"));
        assert_failed(&log.run(args), 1, &["expected only files that pskel wrote", "another file: out/"]);
        assert!(tree(&log.path("out")) == before, "{args}");
        std::fs::remove_dir_all(log.path("out")).unwrap();

        assert!(log.run(args).status.success(), "{args}");
        let whole = tree(&log.path("out"));
        assert!(log.run(args).status.success(), "what a run wrote is replaced: {args}");
        assert!(tree(&log.path("out")) == whole, "{args}");
        if within.starts_with("out/loss.svg") {
            std::fs::remove_file(log.path("out/loss.svg")).unwrap();
        }
        put(&log, within);
        let before = tree(&log.path("out"));
        assert_failed(
            &log.run(args),
            1,
            &["expected only files that pskel wrote", &format!("another file: {within}")],
        );
        assert!(tree(&log.path("out")) == before, "{args}");
        assert!(!log.path("out/.pskel").exists() && !log.path("out.partial").exists(), "{args}");
    }
}

/// Returns the listed files: every file of the folder except the list itself.
fn listed(log: &TinyLog) -> Vec<String> {
    let text = std::fs::read_to_string(log.path("out/.pskel-files")).unwrap();
    let (header, lines) = text.split_once('\n').unwrap();
    assert!(header.starts_with("pskel files 1: "), "{header}");
    lines.lines().map(str::to_owned).collect()
}

#[test]
fn folders_list_their_files() {
    for args in [RENDER, SIMULATE, CONVERT, "build nuscenes:log --out out"] {
        let log = ready();
        // A shorter run after a longer one.
        for args in [args, &args.replace("--steps 2", "--steps 1")] {
            log.succeed(args);
            let mut expected: Vec<String> = tree(&log.path("out")).into_keys().collect();
            if args == CONVERT {
                expected.push("templates".to_owned()); // an empty folder
            }
            expected.sort();
            let mut found = listed(&log);
            found.sort();
            assert_eq!(found, expected, "{args}");
        }
    }
}

#[test]
fn foreign_files_beside_maps_stay() {
    for args in [RENDER, SIMULATE] {
        let log = ready();
        put(&log, "out/thesis.tex");
        for _ in 0..2 {
            assert!(log.run(args).status.success(), "{args}");
            assert_eq!(std::fs::read(log.path("out/thesis.tex")).unwrap(), b"years of work");
        }
    }
}

#[test]
fn a_folder_of_one_kind_is_not_replaced_by_another() {
    let log = ready();
    log.succeed(RENDER);
    for args in [SIMULATE, TOWN, TEMPLATES, CONVERT, "build nuscenes:log --out out"] {
        let before = tree(&log.path("out"));
        assert_failed(&log.run(args), 1, &["expected a folder of kind", "found one of kind maps: out"]);
        assert!(tree(&log.path("out")) == before, "{args}");
    }
}

#[test]
fn inputs_are_not_overwritten() {
    let log = ready();
    log.succeed(SIMULATE);
    log.succeed("convert sk --out clouds");
    std::fs::copy(log.path("clouds/background.npy"), log.path("p.npy")).unwrap();
    let camera = r#"{"cameras": [{"name": "a", "width": 8, "height": 8,
    "intrinsics": [[8, 0, 4], [0, 8, 4], [0, 0, 1]],
        "camera_from_world": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}]}"#;
    std::fs::write(log.path("c.json"), camera).unwrap();
    std::fs::write(log.path("a.json"), r#"{"city": "Boston"}"#).unwrap();
    std::os::unix::fs::symlink("p.npy", log.path("link.npy")).unwrap();
    let before = tree(&log.path(""));
    for (args, found) in [
        ("splat --points p.npy --cameras c.json --rasterizer cpu --out p.npy", "p.npy"),
        ("splat --points p.npy --cameras c.json --rasterizer cpu --out c.json", "c.json"),
        ("convert p.npy --out p.npy", "p.npy"),
        ("convert p.npy --out link.npy", "link.npy"),
        ("convert sk --out sk", "sk"),
        ("templates sk --min-points 1 --out sk", "sk"),
        ("render nuscenes:log --skeleton sk --out sk", "sk"),
        ("render nuscenes:log --skeleton sk --out log", "log"),
        ("simulate nuscenes:log --skeleton sk --out log --steps 1", "log"),
        ("bench --points p.npy --cameras c.json --rasterizer cpu --trace p.npy", "p.npy"),
        (
            "simulate nuscenes:log --skeleton sk --out new --steps 1 --annotations a.json --profile a.json",
            "a.json",
        ),
    ] {
        assert_failed(
            &log.run(args),
            1,
            &["expected an output apart from the input", &format!("the same: {found}\n")],
        );
    }
    // Files that the run itself would write, in an existing or a new folder.
    for profile in ["new/index.json", "./new/steps/p.json", "out/p.json"] {
        let out = if profile.starts_with("out") { "out" } else { "new" };
        let args = format!("simulate nuscenes:log --skeleton sk --out {out} --steps 1 --profile {profile}");
        assert_failed(&log.run(&args), 1, &["expected a file outside of the output", "found one in it"]);
    }
    // Files that belong to another output.
    for args in [
        "splat --points p.npy --cameras c.json --rasterizer cpu --out out/rollout.json",
        "convert p.npy --out sk/background.points --format npy",
        "simulate nuscenes:log --skeleton sk --out new --steps 1 --profile sk/skeleton.json",
    ] {
        assert_failed(&log.run(args), 1, &["expected a file that is no part of another output"]);
    }
    assert!(tree(&log.path("")) == before);
}

#[test]
fn only_regular_files_are_replaced() {
    let log = ready();
    log.succeed("convert sk --out clouds");
    let args = "convert clouds/background.npy --format ply --out";
    for (path, found) in [("/dev/null", "a device or pipe"), ("clouds", "a folder")] {
        assert_failed(
            &log.run(&format!("{args} {path}")),
            1,
            &["expected a regular file or none", found, path],
        );
    }
    assert!(!Path::new("/dev/null").is_file());
    // Links are followed.
    std::fs::write(log.path("real.ply"), "").unwrap();
    std::os::unix::fs::symlink("real.ply", log.path("link.ply")).unwrap();
    log.succeed(&format!("{args} link.ply"));
    assert!(log.path("link.ply").is_symlink() && log.path("real.ply").metadata().unwrap().len() > 100);
}

#[test]
fn output_paths_follow_links() {
    let log = ready();
    let whole = tree(&log.path("sk"));
    // A link stays a link.
    std::fs::create_dir(log.path("disk")).unwrap();
    std::os::unix::fs::symlink("disk", log.path("link")).unwrap();
    log.succeed("build nuscenes:log --out link");
    assert!(log.path("link").is_symlink() && tree(&log.path("disk")) == whole);
    log.succeed("build nuscenes:log --out new/.");
    assert!(tree(&log.path("new")) == whole);
    log.succeed("convert sk --out clouds/.");
    log.succeed(&RENDER.replace("--out out", "--out maps/."));
    assert!(log.path("clouds/origins.json").is_file() && log.path("maps/index.json").is_file());
    // A folder that would replace itself, and a dangling link.
    std::os::unix::fs::symlink("nothing", log.path("dangling")).unwrap();
    for (out, found) in [(".", "a path that ends without one"), ("dangling", "a link")] {
        for command in ["build nuscenes:log", "convert sk", "templates sk --min-points 1"] {
            assert_failed(&log.run(&format!("{command} --out {out}")), 1, &[found]);
        }
    }
    assert!(!log.path(".partial").exists() && !log.path("nothing").exists());
}

/// Starts a command in the background.
fn start(log: &TinyLog, args: &str) -> Child {
    let mut command = with_default_signals();
    command.current_dir(log.path("")).args(args.split_whitespace());
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

fn send(child: &Child, signal: Signal) {
    kill_process(Pid::from_child(child), signal).unwrap();
}

#[track_caller]
fn wait_for(what: &str, is_there: impl Fn() -> bool) {
    let begin = Instant::now();
    while !is_there() {
        assert!(begin.elapsed() < Duration::from_secs(60), "waited for {what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Starts a simulation with a planner that answers once and then hangs.
fn start_hanging(log: &TinyLog) -> Child {
    planner(log, "read -r observation; sleep 600");
    start(log, EXTERNAL)
}

fn said(child: &mut Child) -> String {
    let mut text = String::new();
    child.stderr.take().unwrap().read_to_string(&mut text).unwrap();
    text
}

#[test]
fn a_signal_leaves_no_partial_files() {
    for (signal, code) in [(Signal::INT, 130), (Signal::TERM, 143), (Signal::HUP, 129)] {
        let log = ready();
        let mut child = start_hanging(&log);
        wait_for("steps", || log.path("out/steps/000000").is_dir() && log.path("out/.pskel/lock").is_file());
        // Twice in a row, as `timeout` does: to the process, then to its group.
        send(&child, signal);
        send(&child, signal);
        let status = child.wait().unwrap();
        let text = said(&mut child);
        assert_eq!(status.code(), Some(code), "{text}");
        assert!(text.contains(": partial files were removed"), "{text}");
        assert!(!log.path("out/.pskel").exists(), "{signal:?}");
        assert!(tree(&log.path("out")).keys().all(|name| !name.ends_with(".pskel-part")));
    }
}

#[test]
fn a_second_process_reports_the_first() {
    let log = ready();
    let mut child = start_hanging(&log);
    wait_for("steps", || log.path("out/steps/000000").is_dir());
    for other in [SIMULATE, "simulate nuscenes:log --skeleton sk --out out --maps depth --steps 3 --resume"] {
        let found = format!("output is locked by process {}: out", child.id());
        assert_failed(&log.run(other), 1, &[&found]);
    }
    send(&child, Signal::KILL);
    assert_eq!(child.wait().unwrap().signal(), Some(9));
    // The next run removes the leftovers of the killed process.
    std::fs::write(log.path("out/.pskel/half"), "half").unwrap();
    log.succeed(SIMULATE);
    assert!(!log.path("out/.pskel").exists());
    let found = tree(&log.path("out"));
    std::fs::remove_dir_all(log.path("out")).unwrap();
    log.succeed(SIMULATE);
    assert!(tree(&log.path("out")) == found, "the same as without the killed one");
}

#[test]
fn a_rollout_without_a_step_resumes_from_the_start() {
    let log = ready();
    log.succeed(SIMULATE);
    let whole = tree(&log.path("out"));
    // Killed before the folder, before `rollout.json`, before `states.jsonl`, and before the first step.
    for left in ["", ".pskel-files", ".pskel-files rollout.json", ".pskel-files rollout.json states.jsonl"] {
        let keep: Vec<&str> = left.split_whitespace().collect();
        let old = log.path("old");
        std::fs::rename(log.path("out"), &old).unwrap();
        if !keep.is_empty() {
            std::fs::create_dir(log.path("out")).unwrap();
        }
        for name in keep {
            std::fs::copy(old.join(name), log.path("out").join(name)).unwrap();
        }
        if left.contains("states") {
            std::fs::write(log.path("out/states.jsonl"), "").unwrap();
            // Before the first step's folder was renamed into it.
            std::fs::create_dir(log.path("out/steps")).unwrap();
        }
        std::fs::remove_dir_all(old).unwrap();
        let output = log.run(&format!("{SIMULATE} --resume"));
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(
            output.status.success() && stderr.contains("warning: --resume: found no earlier steps"),
            "{stderr}"
        );
        assert!(tree(&log.path("out")) == whole, "{left}");
    }
}

#[test]
fn closed_or_full_streams_do_not_stop_the_work() {
    let log = ready();
    let shell = |line: &str| {
        let mut command = Command::new("bash");
        command.args(["-c", line]).current_dir(log.path("")).env("PSKEL", PSKEL).output().unwrap()
    };
    // Progress output that cannot be written is not a failure.
    for redirected in ["2>/dev/full", "2>&-", "2> >(true)"] {
        let output = shell(&format!("$PSKEL {RENDER} {redirected}"));
        assert!(output.status.success(), "{redirected}: {output:?}");
        assert!(log.path("out/index.json").is_file(), "{redirected}");
        std::fs::remove_dir_all(log.path("out")).unwrap();
    }
    // A result that cannot be written is a failure; a reader that closes the pipe early is not.
    for args in ["info sk", "info --json sk", "--help", RENDER] {
        let output = shell(&format!("$PSKEL {args} >/dev/full"));
        assert_eq!(output.status.code(), Some(1), "{args}: {output:?}");
        let output = shell(&format!("set -o pipefail; $PSKEL {args} | true"));
        assert!(output.status.success(), "{args}: {output:?}");
    }
    let output = shell("$PSKEL info sk >/dev/full");
    assert!(
        String::from_utf8_lossy(&output.stderr).contains("cannot write the result to stdout: No space left")
    );
}
