//! Planners that fail: the errors of their rollouts, and that no process of theirs goes on.

use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

use point_skeleton::dataset::Recording;
use pskel_sim::{PlannerAddress, PlannerError, SimError, SimOptions, Simulation};
use pskel_testing::shared::assert_error_contains;
use pskel_testing::winding_road;

use super::{HELLO, Server, command, options, script};

/// Planner that answers the hello and then always sends the same text.
fn answers(folder: &Path, answer: &str) -> PlannerAddress {
    let lines = format!("see()\n{HELLO}\nwhile True:\n    see()\n    print({answer}, flush=True)");
    script(folder, &lines)
}

/// Returns the error of a rollout, and checks that the rollout keeps its earlier steps.
fn fails(log: &Recording, options: SimOptions) -> PlannerError {
    let mut sim = match Simulation::new(&winding_road::scenario(log), options) {
        Err(SimError::Planner(error)) => return error,
        Err(error) => panic!("{error}"),
        Ok(sim) => sim,
    };
    let error = loop {
        match sim.step() {
            Ok(Some(_)) => {}
            Ok(None) => panic!("no error"),
            Err(SimError::Planner(error)) => break error,
            Err(error) => panic!("{error}"),
        }
    };
    // The warm-up remains, and the next attempt fails too.
    assert_eq!(sim.committed().get().step, sim.takeover_step());
    assert_eq!(sim.committed().get().ego.pose, log.frames[sim.takeover_step()].global_from_ego);
    assert_eq!(sim.save().step(), sim.takeover_step());
    assert!(matches!(sim.step(), Err(SimError::Planner(PlannerError::Gone { .. }))));
    error
}

/// An unsolicited line of a planner is not taken as an answer to the next observation.
#[test]
fn unsolicited_lines_are_an_error() {
    let log = winding_road::log(2);
    let folder = tempfile::tempdir().unwrap();
    let lines = format!("see()\n{HELLO}\nprint('model loaded', flush=True)\ntime.sleep(60)");
    let address = script(folder.path(), &lines);
    // The line may arrive only after the first observation was sent; then it is a bad answer.
    let unasked = |_: i32| {
        let mut sim = Simulation::new(&winding_road::scenario(&log), options(address.clone(), 20.0)).unwrap();
        std::thread::sleep(std::time::Duration::from_millis(100));
        let error = loop {
            match sim.step() {
                Ok(outcome) => assert!(outcome.is_some()),
                Err(error) => break error.to_string(),
            }
        };
        assert!(error.contains("found \"model loaded\""), "{error}");
        error.contains("expected no unsolicited line")
    };
    assert!((0..50).any(unasked));
}

/// A server with a full queue blocks a client until its timeout, not forever.
#[test]
fn planners_that_do_not_accept_time_out() {
    let log = winding_road::log(2);
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("planner");
    let listens = format!(
        "import socket, time\ns = socket.socket(socket.AF_UNIX)\ns.bind({:?})\ns.listen(0)\ntime.sleep(600)",
        socket.display().to_string()
    );
    let _server = Server(Command::new("python3").arg("-c").arg(listens).spawn().unwrap());
    let first = loop {
        match UnixStream::connect(&socket) {
            Ok(stream) => break stream,
            Err(_) => std::thread::sleep(std::time::Duration::from_millis(10)),
        }
    };
    let error = fails(&log, options(PlannerAddress::Unix(socket), 0.5));
    assert!(matches!(error, PlannerError::Io { verb: "reach", .. }), "{error}");
    assert!(error.to_string().contains("no connection within 0.5 s"), "{error}");
    drop(first);
}

#[test]
fn bad_answers_end_the_rollout_with_the_reason() {
    let log = winding_road::log(2);
    let folder = tempfile::tempdir().unwrap();
    let plan = |points: &str| format!("'{{\"trajectory\": [{points}]}}'");
    let point = |t: &str, x: &str, v: &str| {
        format!("{{\"t\": {t}, \"x\": {x}, \"y\": 3997001.5, \"heading\": 0.4, \"v\": {v}}}")
    };
    let good = |t: &str| point(t, "664004.0", "8");
    let cases = [
        ("'hello'".to_owned(), "hello"),
        ("''".to_owned(), "trajectory"),
        ("'{}'".to_owned(), "missing field `trajectory`"),
        (r#"'{"error": "no checkpoint"}'"#.to_owned(), "found the error \"no checkpoint\""),
        (plan(""), "found 0"),
        (plan(&point("0.2", "NaN", "8")), "NaN"),
        (plan(&point("0.2", "1e999", "8")), "out of range"),
        (plan(&point("0.2", "null", "8")), "null"),
        (plan(&point("0.2", "664004.0", "800")), "v 800"),
        (plan(&point("0.2", "669004.0", "8")), "a jump at"),
        (plan(&point("-1", "664004.0", "8")), "t -1"),
        (plan(&point("200000", "664004.0", "8")), "t 200000"),
        (plan(&format!("{}, {}", good("0.2"), good("0.2"))), "times that rise"),
        (plan(&format!("{}, {}", good("0.2"), good("0.1"))), "times that rise"),
        (plan(&good("0.1")), "at least 0.2 s from the planner, found one of 0.1 s"),
        (plan(&good("0")), "at least 0.2 s from the planner, found one of 0 s"),
        (format!("'{{\"step\": 9, \"trajectory\": [{}]}}'", good("1")), "step 9"),
        (format!("'{{\"frame\": \"moon\", \"trajectory\": [{}]}}'", good("1")), "moon"),
        (format!("'{{\"trajectory\": [' + ', '.join(['{}'] * 10001) + ']}}'", good("1")), "found 10001"),
        (r#"'{"more": ' + '[' * 100000"#.to_owned(), "EOF while parsing a list"),
        ("'x' * (17 << 20)".to_owned(), "a longer one"),
    ];
    for (answer, part) in cases {
        let address = answers(folder.path(), &answer);
        let error = fails(&log, options(address.clone(), 20.0));
        assert!(matches!(error, PlannerError::Answer { .. }), "{error}");
        assert_error_contains(&error, part, &address);
    }
}

#[test]
fn bad_hellos_are_errors() {
    let log = winding_road::log(2);
    let folder = tempfile::tempdir().unwrap();
    for (answer, part) in [
        (r#"{"protocol": "pskel-planner", "version": 2}"#, "version 2"),
        (r#"{"protocol": "other", "version": 1}"#, "other"),
        ("loading the model ...", "loading the model"),
        (r#"{"error": "no GPU"}"#, "no GPU"),
    ] {
        let address = script(folder.path(), &format!("see()\nprint('{answer}', flush=True)\ntime.sleep(60)"));
        let message = fails(&log, options(address, 20.0)).to_string();
        assert!(message.contains(part), "{message}");
    }
    let address = || command("exec sleep 60".into());
    for timeout_s in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(fails(&log, options(address(), timeout_s)), PlannerError::Timeout { .. }));
    }
    let gone = fails(&log, options(command("exit 3".into()), 20.0)).to_string();
    assert!(gone.contains("exit status: 3"), "{gone}");
    let missing = fails(&log, options(command("/nowhere/planner".into()), 20.0)).to_string();
    assert!(missing.contains("127"), "{missing}");
    let nobody = PlannerAddress::Unix(folder.path().join("nobody"));
    assert!(matches!(fails(&log, options(nobody, 0.2)), PlannerError::Io { verb: "reach", .. }));
}

/// Returns whether a process exists and is not a zombie.
fn lives(pid: &str) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    stat.rsplit_once(')').is_some_and(|(_, rest)| !rest.trim_start().starts_with('Z'))
}

#[test]
fn planners_that_hang_or_die_are_detected_and_killed() {
    let log = winding_road::log(2);
    let folder = tempfile::tempdir().unwrap();
    let pids = folder.path().join("pids");
    // The planner has a child that holds its pipes, and ignores that its input is closed.
    let child = format!(
        "import os, subprocess\nchild = subprocess.Popen(['sleep', '600'])\nwith open({:?}, 'w') as f:\n    \
         f.write(f'{{os.getpid()}} {{child.pid}}')\nsee()\n{HELLO}\nsee()\n",
        pids.display().to_string()
    );
    let ended = || {
        let pids = std::fs::read_to_string(&pids).unwrap();
        assert_eq!(pids.split_whitespace().count(), 2);
        for pid in pids.split_whitespace() {
            // The kernel needs some time.
            let start = Instant::now();
            while lives(pid) && start.elapsed().as_secs() < 10 {
                std::thread::sleep(std::time::Duration::from_millis(10));
            }
            assert!(!lives(pid), "process {pid} goes on");
        }
    };
    let start = Instant::now();
    let hangs = script(folder.path(), &format!("{child}time.sleep(600)"));
    let error = fails(&log, options(hangs, 3.0));
    assert!(
        matches!(error, PlannerError::Silent { .. }) && error.to_string().contains("within 3 s"),
        "{error}"
    );
    assert!(start.elapsed().as_secs() < 60);
    ended();
    // The child is killed first, since it would hold the pipe open.
    let dies = script(folder.path(), &format!("{child}child.kill()\nchild.wait()\nsys.exit(5)"));
    let error = fails(&log, options(dies, 20.0)).to_string();
    assert!(error.contains("exit status: 5"), "{error}");
    ended();
    // Half a line without an end.
    let half = script(
        folder.path(),
        &format!("see()\n{HELLO}\nsee()\nprint('{{\"traj', end='', flush=True)\ntime.sleep(600)"),
    );
    assert!(matches!(fails(&log, options(half, 1.5)), PlannerError::Silent { .. }));
}
