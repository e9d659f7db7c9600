//! Interrupted and resumed builds, and builds from several logs.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::time::Duration;

use point_skeleton::cloud::Point;
use point_skeleton::error::FileError;
use point_skeleton::skeleton::{
    self, Asset, BuildError, BuildInput, BuildNeeds, BuildOptions, BuildRun, Skeleton,
};
use serde_json::json;

use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{PSKEL, TinyLog, assert_failed, tree};
use pskel_testing::synthetic_town;

/// Spawns a build and kills it after some time; returns whether it was still running.
fn killed_after(folder: &Path, args: &str, time: Duration) -> bool {
    let mut command = Command::new(PSKEL);
    command.current_dir(folder).args(args.split_whitespace()).stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = command.spawn().unwrap();
    std::thread::sleep(time);
    let running = child.try_wait().unwrap().is_none();
    child.kill().unwrap(); // SIGKILL
    child.wait().unwrap();
    running
}

#[test]
fn a_killed_build_resumes_to_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    synthetic_town::copy_to(&folder.path().join("log"), |_| true);
    let run = |args: &str| {
        let mut command = Command::new(PSKEL);
        let output = command.current_dir(folder.path()).args(args.split_whitespace()).output().unwrap();
        assert!(output.status.success(), "{args}: {}", String::from_utf8_lossy(&output.stderr));
    };
    let start = std::time::Instant::now();
    run("build nuscenes:log --out whole");
    let mut whole_ms = start.elapsed().as_millis() as u64;
    let checkpoint = folder.path().join("sk.partial/checkpoint.json");
    let (mut kills, mut resumed) = (0, 0);
    // Kill times spread over the whole build, in no order. Other load makes builds slower or faster, so the
    // times are repeated.
    for share in [61, 23, 97, 42, 78, 88, 55].into_iter().cycle().take(70) {
        let resume = if checkpoint.is_file() { "--resume" } else { "" };
        let args = format!("build nuscenes:log --out sk --checkpoint 1 {resume}");
        let killed = killed_after(folder.path(), &args, Duration::from_millis(whole_ms * share / 100));
        kills += usize::from(killed);
        resumed += usize::from(killed && !resume.is_empty());
        if folder.path().join("sk").exists() {
            assert!(tree(&folder.path().join("sk")) == tree(&folder.path().join("whole")));
            std::fs::remove_dir_all(folder.path().join("sk")).unwrap();
        }
        if kills >= 5 && resumed >= 2 {
            break;
        }
        if !killed {
            whole_ms = whole_ms * 3 / 4;
        } else if !checkpoint.is_file() {
            whole_ms = whole_ms * 5 / 4;
        }
    }
    let resume = if checkpoint.is_file() { "--resume" } else { "" };
    run(&format!("build nuscenes:log --out sk {resume}"));
    assert!(tree(&folder.path().join("sk")) == tree(&folder.path().join("whole")));
    assert!(kills >= 5 && resumed >= 2, "{kills} kills, {resumed} resumed");
    assert!(!folder.path().join("sk.partial").exists());
}

#[test]
fn rejects_builds_that_cannot_be_resumed() {
    let log = TinyLog::new();
    log.succeed("build nuscenes:log --out out/whole");
    let partial = partial_of_tiny(&log);
    for (options, words) in [
        ("--voxel 0.02", "one with other options"),
        ("--frames 0..2", "one of other frames"),
        ("--sweeps", "one with other options"),
    ] {
        let output = log.run(&format!("build nuscenes:log --out out/sk --resume {options}"));
        assert_failed(&output, 1, &[words, "checkpoint.json"]);
        assert!(partial.join("checkpoint.json").is_file());
    }
    // Another recording of the same name, with the same times and numbers of files and boxes.
    log.change("ego_pose", "/1/translation/0", json!(664_050.0));
    let output = log.run("build nuscenes:log --out out/sk --resume");
    assert_failed(&output, 1, &["one of another recording or state of tiny", "checkpoint.json"]);
    log.change("ego_pose", "/1/translation/0", json!(664_001.0));
    let run = partial.join("run-000000.sums");
    let bytes = std::fs::read(&run).unwrap();
    std::fs::write(&run, &bytes[1..]).unwrap();
    let output = log.run("build nuscenes:log --out out/sk --resume");
    assert_failed(&output, 1, &["run-000000.sums", &format!("found {} bytes", bytes.len() - 1)]);
    let mut changed = bytes.clone();
    changed[bytes.len() / 2] ^= 1;
    std::fs::write(&run, &changed).unwrap();
    let output = log.run("build nuscenes:log --out out/sk --resume");
    assert_failed(&output, 1, &["expected sums of ", "with checksum", "run-000000.sums"]);
    assert!(!log.path("out/sk").exists());
    std::fs::write(&run, &bytes).unwrap();
    let lock = std::fs::File::open(partial.join("lock")).unwrap();
    lock.lock().unwrap();
    let output = log.run("build nuscenes:log --out out/sk --resume");
    assert_failed(&output, 1, &["output is locked by process", ": out/sk\n"]);
    drop(lock);
    log.succeed("build nuscenes:log --out out/sk --resume");
    assert!(tree(&log.path("out/sk")) == tree(&log.path("out/whole")) && !partial.exists());
    // Nothing to resume: the build was killed before its first checkpoint.
    let output = log.run("build nuscenes:log --out out/sk --resume");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success() && said.contains("warning: --resume: found no unfinished build"),
        "{said}"
    );
    assert!(tree(&log.path("out/sk")) == tree(&log.path("out/whole")));
}

#[test]
fn rejects_resuming_a_folder_of_another_kind() {
    let log = TinyLog::new();
    std::fs::create_dir(log.path("out/sk.partial")).unwrap();
    std::fs::write(log.path("out/sk.partial/thesis.tex"), "years of work").unwrap();
    for resume in ["", "--resume"] {
        let output = log.run(&format!("build nuscenes:log --out out/sk {resume}"));
        assert_failed(
            &output,
            1,
            &["a folder of an unfinished run, or none", "another folder", "sk.partial"],
        );
    }
    assert!(log.path("out/sk.partial/thesis.tex").is_file());
}

#[test]
fn a_fresh_build_reports_the_discarded_work() {
    let log = TinyLog::new();
    let partial = partial_of_tiny(&log);
    let output = log.run("build nuscenes:log --out out/sk");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success() && stderr.contains("an unfinished build with 3 frames done is discarded"),
        "{stderr}"
    );
    assert!(!partial.exists());
    // An older skeleton stays until the new one replaces it.
    let older = tree(&log.path("out/sk"));
    std::fs::write(log.path(&crate::tiny_log::sweep(2)), "cut").unwrap();
    assert_failed(
        &log.run("build nuscenes:log --out out/sk --checkpoint 1 --missing error"),
        1,
        &["2.pcd.bin"],
    );
    assert!(tree(&log.path("out/sk")) == older);
}

/// Returns an unfinished build of the tiny log: templates fail after all frames are done.
fn partial_of_tiny(log: &TinyLog) -> PathBuf {
    let dataset = pskel::logs::open(&format!("nuscenes:{}", log.path("log").display()).parse().unwrap());
    let dataset = dataset.unwrap();
    let fail = |_: &[(&Asset, &[Point])]| Err(FileError::content("templates", "none", Path::new("t")));
    let inputs = [BuildInput::all(dataset.reader())];
    let built = skeleton::build(
        &log.path("out/sk"),
        &inputs,
        &BuildOptions::default(),
        &fail,
        &BuildRun { checkpoint_frames: 1, ..BuildRun::default() },
    );
    let error = built.unwrap_err();
    let BuildError::Interrupted { frames, path, .. } = &error else { panic!("{error}") };
    let text = error.to_string();
    assert!(*frames == 3 && text.contains("3 frames are done and retained"), "{text}");
    path.clone()
}

#[test]
fn logs_of_one_location_share_a_background() {
    let (log, other) = (TinyLog::new(), TinyLog::new());
    other.change("scene", "/0/name", json!("second"));
    std::fs::rename(other.path("log"), log.path("log2")).unwrap();
    log.succeed("build nuscenes:log --out out/one --voxel 0");
    let summary = log.succeed("build nuscenes:log nuscenes:log2 --out out/both --voxel 0");
    assert!(summary.starts_with("built tiny, second from 6 frames"), "{summary}");
    let (one, both) =
        (Skeleton::open(&log.path("out/one")).unwrap(), Skeleton::open(&log.path("out/both")).unwrap());
    // The second log is a copy of the first: each chunk holds the points of the first twice, next to each
    // other.
    let sorted = |points: &[Point]| {
        let bits = |p: &Point| (p.position.map(f32::to_bits), p.rgb_class);
        let mut points: Vec<_> = points.iter().map(bits).collect();
        points.sort_unstable();
        points
    };
    for (one, both) in one.background().unwrap().iter().zip(both.background().unwrap()) {
        assert!(sorted(both) == sorted(&[*one, *one].concat()));
    }
    let names: Vec<_> = both.manifest.actors.iter().map(|a| [a.track.as_str(), a.log.as_str()]).collect();
    assert_eq!(names, [["car", "tiny"], ["car", "second"], ["cone", "tiny"], ["cone", "second"]]);
    assert_eq!(both.manifest.actors[0].points, one.manifest.actors[0].points);
    // With voxels the copy adds nothing, because its points are the same.
    log.succeed("build nuscenes:log --out out/one");
    log.succeed("build nuscenes:log nuscenes:log2 --out out/both");
    let points = |name: &str| std::fs::read(log.path(name).join("background.points")).unwrap();
    assert!(points("out/one") == points("out/both"));
    for name in ["nuscenes:log", "nuscenes:log2"] {
        log.succeed(&format!("render {name} --skeleton out/both --out out/maps --frames 0..1 --maps depth"));
    }
    let output = log.run("build nuscenes:log nuscenes:log --out out/again");
    assert_failed(&output, 1, &["logs of one place with different names", "tiny (nowhere), tiny (nowhere)"]);
}

#[test]
fn foreign_files_in_a_skeleton_are_not_deleted() {
    let log = TinyLog::new();
    log.succeed("build nuscenes:log --out out/sk");
    std::fs::create_dir(log.path("out/sk/mine")).unwrap();
    let output = log.run("build nuscenes:log --out out/sk");
    assert_failed(
        &output,
        1,
        &["only files that pskel wrote where it is to write, found another folder: out/sk/mine"],
    );
    assert!(log.path("out/sk/mine").is_dir() && !log.path("out/sk.partial").exists());
}

#[test]
fn frames_without_sweeps_are_reported() {
    let log = TinyLog::new();
    log.change("sensor", "/0/modality", json!("radar"));
    let lidar: serde_json::Value = log.json("log/v1.0-mini/sensor.json");
    assert!(
        lidar.as_array().unwrap().iter().any(|s| s["channel"] == "LIDAR_TOP" && s["modality"] == "radar")
    );
    assert_failed(
        &log.run("build nuscenes:log --out out/sk"),
        1,
        &["frames with a LiDAR sweep, found none in 3 frames of tiny"],
    );
    assert!(!log.path("out/sk.partial").exists());
}

/// Notes what a build needs.
#[derive(Default)]
struct Noted(Mutex<Option<BuildNeeds>>);

impl skeleton::Progress for Noted {
    fn needs(&self, estimate: &dyn Fn() -> BuildNeeds) {
        *self.0.lock().unwrap() = Some(estimate());
    }

    fn start(&self, _: &str, _: usize) {
        assert!(self.0.lock().unwrap().is_some(), "needs are known before the work starts");
    }

    fn step(&self) {}
}

#[test]
fn builds_need_at_most_what_they_say() {
    let log = TinyLog::new();
    let dataset = pskel::logs::open(&format!("nuscenes:{}", log.path("log").display()).parse().unwrap());
    let (dataset, noted, out) = (dataset.unwrap(), Noted::default(), log.path("out/sk"));
    let intermediate = |_: &[(&Asset, &[Point])]| {
        let sizes = tree(&log.path("out/sk.partial")).into_iter();
        let bytes: usize =
            sizes.filter(|(name, _)| name.ends_with(".sums")).map(|(_, file)| file.len()).sum();
        let needs = noted.0.lock().unwrap().clone().unwrap();
        assert!(bytes > 0 && bytes as u64 <= needs.disk_bytes - needs.skeleton_bytes, "{bytes}: {needs:?}");
        Ok(Vec::new())
    };
    let run = BuildRun { progress: &noted, ..BuildRun::default() };
    let inputs = [BuildInput::all(dataset.reader())];
    let built = skeleton::build(&out, &inputs, &BuildOptions::default(), &intermediate, &run).unwrap();
    let (needs, report) = (noted.0.lock().unwrap().clone().unwrap(), &built.manifest.report);
    assert_eq!(
        (needs.sweeps, needs.points),
        (report.sweeps, report.points_read as u64),
        "all sweeps are alike"
    );
    let files = ["background.points", "actors.points"].map(|name| out.join(name).metadata().unwrap().len());
    assert!(files.iter().sum::<u64>() <= needs.skeleton_bytes, "{files:?}: {needs:?}");
    assert!(needs.free_bytes.is_some() && needs.memory_bytes > 100 << 20, "{needs:?}");
}
