//! Checks of options and outputs that come before all work: outputs that cannot be written, too few frames,
//! other options of a run that is resumed.

use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;
use std::process::{Command, Output};

use crate::simulate::built;
use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{PSKEL, TinyLog, assert_failed, tree};

const SIMULATE: &str =
    "simulate nuscenes:log --skeleton sk --out rollout --maps depth --rasterizer cpu --steps 1";
const GENERATE: &str = "generate nuscenes:log --skeleton sk --every 1 --generator fill --window 2 --maps \
    color,depth,class \
    --rasterizer cpu";

/// Runs a command as a user who may not write to the folder `ro`; `None` where there is no other user.
fn run_as_other_user(log: &TinyLog, args: &str) -> Option<Output> {
    let run = |program: &str, args: &str| {
        let mut command = Command::new("setpriv");
        command.args([
            "--reuid",
            "54331",
            "--clear-groups",
            "--inh-caps=-all",
            "--bounding-set=-all",
            program,
        ]);
        command.args(args.split_whitespace()).current_dir(log.path("")).output()
    };
    run("test", &format!("-x {PSKEL} -a -r sk/skeleton.json")).ok().filter(|tried| tried.status.success())?;
    Some(run(PSKEL, args).unwrap())
}

/// Asserts that a command fails, and that no rollout was begun.
#[track_caller]
fn assert_early(log: &TinyLog, output: &Output, parts: &[&str]) {
    assert_failed(output, 1, parts);
    for name in ["rollout", "copy", "copy.partial"] {
        assert!(!log.path(name).exists(), "{name} is there: {parts:?}");
    }
}

#[test]
fn unwritable_files_are_rejected_before_the_work() {
    let log = built();
    let long = "a".repeat(256);
    for option in ["--mcap", "--profile"] {
        for (name, part) in [
            ("new/", "expected the path of a file, found one that ends without a name: new/"),
            (long.as_str(), "cannot write: File name too long"),
        ] {
            assert_early(&log, &log.run(&format!("{SIMULATE} {option} {name}")), &[part]);
        }
    }
    assert_early(
        &log,
        &log.run(&format!("{GENERATE} --out rollout --dataset {long}")),
        &["File name too long"],
    );
    let write = |folder: &str, mode| {
        std::fs::set_permissions(log.path(folder), std::fs::Permissions::from_mode(mode)).unwrap();
    };
    std::fs::create_dir(log.path("ro")).unwrap();
    write("", 0o777);
    write("ro", 0o555);
    for args in [
        format!("{SIMULATE} --mcap ro/a.mcap"),
        format!("{SIMULATE} --profile ro/p.json"),
        format!("{GENERATE} --out rollout --dataset ro/copy"),
        "bench --synthetic 9 --rasterizer cpu --warm-up 0 --repeat 1 --size 45x80 --trace ro/t.json"
            .to_owned(),
    ] {
        let Some(output) = run_as_other_user(&log, &args) else {
            return pskel_testing::shared::skip("setpriv and another user");
        };
        assert_early(&log, &output, &["Permission denied", "ro/"]);
    }
}

#[test]
fn rejects_copies_and_rollouts_inside_each_other() {
    let log = built();
    for (out, copy, found) in [
        ("rollout", "rollout", "the same"),
        ("rollout", "rollout/steps/copy", "one in it"),
        ("copy/rollout", "copy", "one that contains it"),
    ] {
        let output = log.run(&format!("{GENERATE} --out {out} --dataset {copy}"));
        let expected = format!("expected a folder apart from the output {out}, found {found}: {copy}");
        assert_early(&log, &output, &[&expected]);
    }
    std::fs::create_dir(log.path("real")).unwrap();
    symlink("real", log.path("link")).unwrap();
    let output = log.run(&format!("{GENERATE} --out real/rollout --dataset link/rollout"));
    assert_early(&log, &output, &["found the same: link/rollout"]);
    // A refusal of the rollout's options leaves nothing of the copy.
    let output = log.run(&format!("{GENERATE} --out rollout --dataset copy --steps 0"));
    assert!(!output.status.success() && !log.path("copy.partial").exists());
}

#[test]
fn scores_are_printed_if_their_file_cannot_be_written() {
    let log = built();
    let output = log.run(&format!("{GENERATE} --out rollout"));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let scores = log.run("evaluate rollout");
    // No file of that size can be written.
    let limited = Command::new("sh")
        .args(["-c", "ulimit -f 0; exec \"$@\"", "sh", PSKEL, "evaluate", "rollout", "--out", "s.json"])
        .current_dir(log.path(""))
        .output()
        .unwrap();
    assert_failed(&limited, 1, &["cannot write", "s.json"]);
    let table = |output: &Output| {
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        text.lines().filter(|line| !line.contains(" in ")).map(|line| format!("{line}\n")).collect::<String>()
    };
    assert!(table(&limited) == table(&scores) && table(&scores).contains("PSNR (dB)"), "{}", table(&limited));
    assert_failed(&log.run("evaluate rollout --out new/"), 1, &["expected the path of a file"]);
}

#[test]
fn rollouts_without_a_step_are_not_resumed() {
    let log = built();
    log.succeed(SIMULATE);
    std::fs::remove_dir_all(log.path("rollout/steps/000000")).unwrap();
    let before = tree(&log.path("rollout"));
    let output = log.run(&format!("{} --resume", SIMULATE.replace("--steps 1", "--steps 2")));
    let expected = "expected the folder of a step to resume after, or a rollout without --resume, found \
        none: \
        rollout/steps/000000";
    assert_failed(&output, 1, &[expected]);
    assert!(tree(&log.path("rollout")) == before);
}

#[test]
fn links_to_new_files_are_followed() {
    let log = built();
    std::fs::create_dir(log.path("disk")).unwrap();
    for (target, link) in [("disk/big.mcap", "l.mcap"), ("log/v1.0-mini/new.json", "in-log.json")] {
        symlink(target, log.path(link)).unwrap();
    }
    log.succeed(&format!("{SIMULATE} --mcap l.mcap"));
    assert!(log.path("l.mcap").is_symlink() && log.path("disk/big.mcap").is_file());
    std::fs::remove_dir_all(log.path("rollout")).unwrap();
    let output = log.run(&format!("{SIMULATE} --profile in-log.json"));
    assert_early(&log, &output, &["expected an output outside of the input log, found one in it"]);
    symlink("rollout/p.json", log.path("p.json")).unwrap();
    assert_early(&log, &log.run(&format!("{SIMULATE} --profile p.json")), &["outside of the output"]);
    symlink("nowhere", log.path("rollout")).unwrap();
    let output = log.run(SIMULATE);
    assert_failed(&output, 1, &["expected a folder or none, found a link that leads nowhere: rollout"]);
    assert!(!Path::new(&log.path("nowhere")).exists());
}
