//! From towns to images, scores and tables: `pskel generate`, `evaluate` and `protocol ablation` through the
//! command line.

use std::path::Path;
use std::process::Command;

use pskel_network::{NetworkConfig, Weights};
use pskel_testing::small_network::{config, statistics};
use serde_json::Value;

use crate::tiny_log::{PSKEL, assert_failed, tree};

/// A small town that is quick to generate.
const TOWN: &str = "town:seed=5,frames=5,size=57x100";

fn command(folder: &Path, args: &str) -> Command {
    let mut command = Command::new(PSKEL);
    command.current_dir(folder).args(args.split_whitespace()).env("PSKEL_VALIDATION", "1");
    command
}

/// Returns the standard output of a run, which must succeed.
#[track_caller]
fn succeed(folder: &Path, args: &str) -> String {
    let output = command(folder, args).output().unwrap();
    assert!(output.status.success(), "{args}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

#[test]
fn generates_evaluates_and_ablates() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let config = NetworkConfig { frames: 2, ..config() };
    let weights = Weights::random(&config, &statistics(), 1).unwrap();
    weights.write(&folder.join("w.safetensors")).unwrap();
    succeed(folder, &format!("build {TOWN} --out sk"));
    let maps = "--skeleton sk --size 32x64 --maps color,class,instance --generator \
        network:w.safetensors";
    succeed(folder, &format!("generate {TOWN} {maps} --out images"));
    let reported = succeed(folder, "evaluate images --out scores.json");
    assert!(reported.contains("scored 24 images of 1 rollout"), "{reported}");
    let scores = &json(&folder.join("scores.json"))["rollouts"][0]["scores"];
    assert_eq!((&scores["steps"], &scores["steps_with_truth"]), (&Value::from(4), &Value::from(4)));
    assert!(scores["psnr_db"]["mean"].as_f64() > Some(8.0), "{}", scores["psnr_db"]["mean"]);
    shipped(folder);
    filled(folder);
    moved(folder);
    compared(folder);
}

/// Evaluates the shipped network in a town that it was not trained on.
fn shipped(folder: &Path) {
    let reported = succeed(folder, &format!("generate {TOWN} --skeleton sk --maps color --out shipped"));
    assert!(reported.contains("2 frames generated"), "{reported}");
    succeed(folder, "evaluate shipped --out shipped.json");
    let scores = &json(&folder.join("shipped.json"))["rollouts"][0]["scores"];
    assert!(scores["psnr_db"]["mean"].as_f64() > Some(20.0), "{}", scores["psnr_db"]["mean"]);
}

/// A recorded log has no images from a moved ego.
fn moved(folder: &Path) {
    succeed(folder, "town seed=6,frames=6,size=57x100 --out log");
    let moved = "generate nuscenes:log --skeleton none --out moved --ego-offset left_m=2,yaw_deg=5";
    assert_failed(
        &command(folder, moved).output().unwrap(),
        1,
        &["expected a synthetic log (town:..) with --ego-offset", "nuscenes:log"],
    );
}

/// Holes of color maps are filled from an ego that is moved; the town has the truth there.
fn filled(folder: &Path) {
    let fill = format!(
        "generate {TOWN} --skeleton sk --generator fill --maps color --ego-offset left_m=2,yaw_deg=5 --out \
            filled"
    );
    assert!(succeed(folder, &fill).contains("2 frames generated"));
    std::fs::write(folder.join("coarse.json"), r#"{"splat": "100:3"}"#).unwrap();
    let coarse = fill.replace("--out filled", "--recipe coarse.json --out coarse");
    assert!(succeed(folder, &coarse).contains("2 frames generated"));
    let filled =
        |out: &str| std::fs::read(folder.join(out).join("steps/000003/generated/CAM_FRONT.png")).unwrap();
    assert!(filled("coarse") != filled("filled"));
    succeed(folder, "evaluate filled --out filled.json");
    let report = &json(&folder.join("filled.json"))["rollouts"][0]["scores"];
    let (psnr, seams) = (&report["psnr_db"]["mean"], &report["seams"]["4"]);
    assert!(psnr.as_f64() > Some(12.0) && seams.as_f64() > Some(0.8), "{psnr} {seams}");
    let output = command(folder, "evaluate filled --hold-out 9").output().unwrap();
    assert_failed(&output, 1, &["every frame 9 N - 1", "none in 2 steps", "filled"]);
    let truth = |out: &str| std::fs::read(folder.join(out).join("steps/000003/truth/CAM_FRONT.png")).unwrap();
    assert!(truth("filled") != truth("shipped"));
}

/// Existing results are not computed again, and lost ones are restored.
fn compared(folder: &Path) {
    let weights = "w.safetensors";
    let few = format!(
        "protocol ablation {TOWN} --skeletons sks --generator network:{weights} --steps 4 --out table"
    );
    let reported = succeed(folder, &few);
    assert!(reported.contains("10 variants in 1 scenes") && !reported.contains("seed 1"), "{reported}");
    let variants = format!("--variant depth={weights} --variant layout={weights}");
    let ablate = format!("{few} {variants} --other-seed {weights}");
    let reported = succeed(folder, &ablate);
    assert!(reported.contains("13 variants in 1 scenes"), "{reported}");
    let all = tree(&folder.join("table"));
    let text = String::from_utf8(all["table.md"].clone()).unwrap();
    let trained = "| trained: Layout, noisy previous frame, color and depth |";
    for part in ["| rolling |", "| layout alone, difference |", trained, "| seed 1 |"] {
        assert!(text.contains(part), "{part} in {text}");
    }
    // A variant has the conditions of its training: here those of the row without color and depth.
    let row = |name: &str| {
        let line = text.lines().find(|line| line.starts_with(&format!("| {name} |"))).unwrap();
        line.split_once('|').unwrap().1.split_once('|').unwrap().1
    };
    assert_eq!(row("trained: Layout"), row("layout alone"));
    assert_ne!(row("trained: Layout"), row("seed 1"));
    // A network does not differ from itself.
    let line = text.lines().find(|line| line.starts_with("| seed 1, difference |")).unwrap();
    let first = line.split('|').nth(2).unwrap().trim();
    assert_eq!(first, "0.00");
    let scene = "town-5-5f-";
    let lost = all.keys().find(|name| name.starts_with(scene) && name.ends_with("/rolling.json")).unwrap();
    std::fs::remove_file(folder.join("table").join(lost)).unwrap();
    let retained = folder.join("table").join(lost.replace("rolling", "causal"));
    let written = || std::fs::metadata(&retained).unwrap().modified().unwrap();
    let before = written();
    succeed(folder, &ablate);
    assert_eq!(written(), before, "what is there is not made again");
    assert!(tree(&folder.join("table")) == all);
    // In a recorded log the ego follows the log, where images of it are known.
    let reported = succeed(
        folder,
        &format!(
            "protocol ablation nuscenes:log --skeletons sks --generator network:{weights} --parts forecasts \
                --steps 2 --out recorded"
        ),
    );
    assert!(
        reported.contains("4 variants in 1 scenes") && reported.contains("| rolling, static forecasts |"),
        "{reported}"
    );
    let result =
        tree(&folder.join("recorded")).into_keys().find(|name| name.ends_with("/rolling.json")).unwrap();
    let result = json(&folder.join("recorded").join(result));
    assert!(result["numbers"]["psnr_db"].as_f64() > Some(5.0), "{result}");
    let seeds = ablate.replace(&variants, "--parts seeds");
    let reported = succeed(folder, &seeds);
    assert!(
        reported.contains("2 variants in 1 scenes") && reported.contains("| seed 1, difference | 0.00 |"),
        "{reported}"
    );
    assert!(!reported.contains("layout"), "{reported}");
    let neither = seeds.replace("--parts seeds", "--parts strategies");
    let output = command(folder, &neither).output().unwrap();
    assert_failed(&output, 2, &["expected --other-seed and part seeds together, found the weights alone"]);
    let twice = format!("{ablate} --variant layout={weights}");
    let output = command(folder, &twice).output().unwrap();
    assert_failed(&output, 2, &["expected each --variant once, found layout again"]);
    let other = ablate.replace("--steps 4", "--steps 3");
    let output = command(folder, &other).output().unwrap();
    assert_failed(&output, 1, &["expected scores of {", "\"steps\":4", "reset_and_roll.json"]);
    let output = command(folder, &few.replace(&format!("network:{weights}"), "fill")).output().unwrap();
    assert_failed(&output, 2, &["expected --generator network or network:FILE, found fill"]);
    let long = ablate.replace("--steps 4", "--steps 30").replace("--out table", "--out long");
    assert_failed(&command(folder, &long).output().unwrap(), 1, &["31 plan steps", "found 5"]);
}
