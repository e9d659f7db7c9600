//! Outputs never replace inputs or files that no run wrote.

use crate::simulate::built;
use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{TinyLog, assert_failed, tree};
use std::os::unix::fs::symlink;
use std::path::Path;

const SIMULATE: &str =
    "simulate nuscenes:log --skeleton sk --out out --maps depth --rasterizer cpu --steps 1";
const RENDER: &str = "render nuscenes:log --skeleton sk --out out --maps depth --rasterizer cpu";
pub(super) const EXPORT: &str =
    "export nuscenes:log --skeletons sks --out out --out-size 32x48 --rasterizer cpu";
const CAMERAS: &str = r#"{"cameras": [{"name": "a", "width": 8, "height": 8,
    "intrinsics": [[8, 0, 4], [0, 8, 4], [0, 0, 1]],
    "camera_from_world": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}]}"#;

/// Returns a log with a skeleton and the files that commands read, without a folder `out`.
fn ready() -> TinyLog {
    let log = built();
    std::fs::remove_dir_all(log.path("out")).unwrap();
    log.succeed("convert sk --out clouds");
    log.succeed("templates sk --min-points 1 --out templates");
    std::fs::copy(log.path("clouds/background.npy"), log.path("p.npy")).unwrap();
    std::fs::write(log.path("c.json"), CAMERAS).unwrap();
    std::fs::write(log.path("recipe.json"), r#"{"drawn": "32x64", "size": "16x32"}"#).unwrap();
    log
}

/// Asserts that commands fail without changing a file.
#[track_caller]
pub(super) fn assert_refused(log: &TinyLog, args: &str, part: &str) {
    let before = tree(&log.path(""));
    let output = log.run(args);
    assert_failed(&output, 1, &[part]);
    let after = tree(&log.path(""));
    let changed: Vec<&String> = after.keys().filter(|name| before.get(*name) != after.get(*name)).collect();
    assert!(changed.is_empty() && after.len() == before.len(), "{args}: {changed:?}");
}

#[test]
fn single_files_do_not_replace_files_in_input_folders() {
    let log = ready();
    let generator = "--generator fill --recipe recipe.json --window 2";
    let simulate = "simulate nuscenes:log --skeleton sk --templates templates --steps 1 --dry --out new \
        --maps depth --rasterizer cpu";
    std::fs::create_dir(log.path("elsewhere")).unwrap();
    for (link, target) in [
        ("log/linked", "../elsewhere"),
        ("table.mcap", "log/v1.0-mini/scene.json"),
        ("folder", "log/v1.0-mini"),
    ] {
        symlink(target, log.path(link)).unwrap();
    }
    std::fs::write(log.path("elsewhere/x.json"), "{}").unwrap();
    std::fs::write(log.path("p.csv"), "camera,images\n").unwrap();
    std::fs::hard_link(log.path("log/v1.0-mini/scene.json"), log.path("hard.mcap")).unwrap();
    let outside = "expected an output outside of the input";
    let part = "expected a file that is no part of another output";
    for (args, found) in [
        (format!("{simulate} --mcap log/v1.0-mini/scene.json"), outside),
        (format!("{simulate} --mcap log/v1.0-mini/new.mcap"), outside),
        (format!("{simulate} --mcap table.mcap"), outside),
        (
            format!("{simulate} --mcap hard.mcap"),
            "expected an MCAP file of pskel to replace, or none, found another file",
        ),
        (format!("{simulate} --mcap folder/map.json"), outside),
        (format!("{simulate} --profile log/samples/0-CAM_FRONT.png"), outside),
        (format!("{simulate} --profile log/linked/x.json"), outside),
        (format!("{simulate} --profile elsewhere/x.json"), outside),
        (format!("{simulate} --profile sk/actors.points"), part),
        (format!("{simulate} --profile sk/new.json"), outside),
        (format!("{simulate} --profile templates/templates.json"), part),
        (format!("{simulate} {generator} --profile recipe.json"), "apart from the input recipe.json"),
        (
            format!("{simulate} --profile c.json"),
            "expected a profile of pskel to replace, or none, found another file",
        ),
        ("bench nuscenes:log --skeleton sk --rasterizer cpu --trace log/v1.0-mini/log.json".into(), outside),
        (
            "bench nuscenes:log --skeleton sk --rasterizer cpu --trace c.json".into(),
            "expected a trace of pskel bench",
        ),
        (
            "splat --points p.npy --cameras c.json --rasterizer cpu --out recipe.json".into(),
            "expected an archive of pskel",
        ),
        ("convert p.npy --format ply --out log/v1.0-mini/scene.json".into(), "expected a PLY file of pskel"),
        ("fidelity town:seed=5,frames=2,size=57x100 --skeleton sk --out sk/skeleton.json".into(), part),
        (
            "fidelity town:seed=5,frames=2,size=57x100 --skeleton sk --out p.csv".into(),
            "expected a table of pskel",
        ),
    ] {
        assert_refused(&log, &args, found);
    }
    // What an earlier run wrote is replaced, and so is an empty file.
    std::fs::write(log.path("t.json"), "").unwrap();
    for args in [
        format!("{simulate} --profile p.json --mcap a.mcap"),
        "splat --points p.npy --cameras c.json --rasterizer cpu --out f.npz".to_owned(),
        "convert p.npy --out f.ply".to_owned(),
        "convert f.ply --out f.npy".to_owned(),
        "bench --synthetic 9 --rasterizer cpu --warm-up 0 --repeat 1 --size 45x80 --trace t.json".to_owned(),
    ] {
        for _ in 0..2 {
            let output = log.run(&args);
            assert!(output.status.success(), "{args}: {}", String::from_utf8_lossy(&output.stderr));
        }
    }
}

#[test]
fn scores_do_not_replace_rollout_files() {
    let log = ready();
    let generate = "generate nuscenes:log --skeleton sk --out rollout --every 1 --generator fill --window 2 \
        --maps color,depth,class --rasterizer cpu";
    log.succeed(generate);
    std::fs::create_dir_all(log.path("masks/000000")).unwrap();
    std::fs::write(log.path("masks/000000/CAM_FRONT.png"), "").unwrap();
    assert_refused(&log, "evaluate rollout --out rollout/rollout.json", "no part of another output");
    assert_refused(&log, "evaluate rollout --out rollout/steps/scores.json", "outside of the input rollout");
    assert_refused(
        &log,
        "evaluate rollout --masks masks --out masks/000000/CAM_FRONT.png",
        "outside of the input masks",
    );
    assert_refused(&log, "evaluate rollout --out c.json", "expected scores of pskel evaluate");
    assert_refused(&log, "evaluate rollout --out none/scores.json", "cannot read");
    for _ in 0..2 {
        assert!(log.run("evaluate rollout --out scores.json").status.success());
    }
}

#[test]
fn links_and_foreign_work_folders_are_not_touched() {
    let log = ready();
    let put = |name: &str| {
        std::fs::create_dir_all(log.path(name).parent().unwrap()).unwrap();
        std::fs::write(log.path(name), "precious").unwrap();
    };
    // A link in place of the work folder.
    log.succeed(RENDER);
    for name in ["victim/lock", "victim/thesis.tex"] {
        put(name);
    }
    symlink("../victim", log.path("out/.pskel")).unwrap();
    assert_refused(&log, RENDER, "expected a folder of an unfinished run, or none, found a link: out/.pskel");
    std::fs::remove_file(log.path("out/.pskel")).unwrap();
    symlink("victim", log.path("sk2.partial")).unwrap();
    assert_refused(&log, "build nuscenes:log --out sk2", "found a link: sk2.partial");
    // Folders of others with a file `lock`.
    for name in ["sk3.partial/lock", "sk3.partial/thesis.tex", "out/.pskel/lock", "out/.pskel/thesis.tex"] {
        put(name);
    }
    assert_refused(
        &log,
        "build nuscenes:log --out sk3",
        "expected a folder of an unfinished run, or none, found another folder",
    );
    assert_refused(&log, "convert sk --out sk3", "found another folder: sk3.partial");
    assert_refused(&log, RENDER, "found another folder: out/.pskel");
    std::fs::write(log.path("sk3.partial/lock"), "4711").unwrap();
    assert_refused(&log, "build nuscenes:log --out sk3", "found another folder: sk3.partial");
}

#[test]
fn rollouts_are_not_resumed_through_links() {
    for name in ["steps", "states.jsonl", "rollout.json", "steps/000000"] {
        let log = ready();
        log.succeed(SIMULATE);
        std::fs::rename(log.path("out").join(name), log.path("moved")).unwrap();
        symlink(log.path("moved"), log.path("out").join(name)).unwrap();
        let more = SIMULATE.replace("--steps 1", "--steps 2");
        for args in [format!("{more} --resume"), format!("{more} --resume-from 0"), more.clone()] {
            let before = tree(&log.path(""));
            assert_failed(
                &log.run(&args),
                1,
                &["expected only files that pskel wrote", "found a link: out/"],
            );
            assert!(tree(&log.path("")) == before, "{args}");
        }
    }
}

#[test]
fn output_folders_must_be_outside_inputs() {
    let log = ready();
    std::fs::create_dir(log.path("sks")).unwrap();
    let skeleton = "expected an output outside of the skeleton";
    for (args, part) in [
        (SIMULATE.replace("--out out", "--out log/v1.0-mini"), "expected an output outside of the input log"),
        (SIMULATE.replace("--out out", "--out log/samples"), "expected an output outside of the input log"),
        (SIMULATE.replace("--out out", "--out sk/sub"), skeleton),
        (RENDER.replace("--out out", "--out sk/maps"), skeleton),
        ("convert sk --out sk/clouds".to_owned(), skeleton),
        ("build nuscenes:log --out sk/sub/sk".to_owned(), skeleton),
        ("templates sk --min-points 1 --out templates/more".to_owned(), "outside of the templates"),
        (
            "protocol ablation nuscenes:log --skeletons sks --rasterizer cpu --out log/samples".to_owned(),
            "expected an output outside of the input log, found one in it: log/samples",
        ),
        (EXPORT.replace("--out out", "--out sk/export --layout frames"), skeleton),
        (
            EXPORT.replace("--out out", "--out none/../templates/export --layout frames"),
            "outside of the templates",
        ),
        (
            EXPORT.replace("--out out", "--out log/samples --layout frames"),
            "expected an output outside of the input log",
        ),
        (EXPORT.replace("--out out", "--out sks --layout frames"), "apart from that of the export"),
    ] {
        assert_refused(&log, &args, part);
    }
    // An export in a folder of the data is continued.
    for _ in 0..2 {
        log.succeed(&EXPORT.replace("--out out", "--out log/export --layout frames"));
    }
}

/// Sensor data may be in another folder than the tables.
#[test]
fn rollouts_must_be_outside_the_sensor_data() {
    let log = ready();
    std::fs::create_dir(log.path("s")).unwrap();
    std::fs::rename(log.path("log/samples"), log.path("s/samples")).unwrap();
    let simulate = format!("{SIMULATE} --sensor-root s");
    let part = "expected an output outside of the input s, found one in it: s/samples";
    assert_refused(&log, &simulate.replace("--out out", "--out s/samples"), part);
    log.succeed(&simulate);
}

/// Arrays of NumPy have other shapes, and its archives another header.
#[test]
fn foreign_arrays_are_not_replaced() {
    let log = ready();
    let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (9, 512), }";
    let array = format!("{header:117}\n");
    std::fs::write(log.path("features.npy"), [b"\x93NUMPY\x01\0\x76\0", array.as_bytes()].concat()).unwrap();
    let local = [b"PK\x03\x04\x2d", &[0; 21][..], b"\x09\0\x14\0color.npy", &[0; 20]].concat();
    std::fs::write(log.path("mine.npz"), local).unwrap();
    assert_refused(&log, "convert p.npy --out features.npy", "found another file: features.npy");
    let splat = "splat --points p.npy --cameras c.json --rasterizer cpu";
    assert_refused(&log, &format!("{splat} --out mine.npz"), "found another file: mine.npz");
    // This program's files are replaced.
    for args in ["convert p.npy --out q.npy".to_owned(), format!("{splat} --out q.npz")] {
        log.succeed(&args);
        log.succeed(&args);
    }
}

/// A town has a list of its files, which its copy must not share.
#[test]
fn copies_do_not_change_their_data_set() {
    let log = TinyLog::new();
    log.succeed("town seed=5,frames=3,size=57x100 --out town");
    log.succeed("build nuscenes:town --out sk");
    let list = std::fs::read(log.path("town/.pskel-files")).unwrap();
    let before = tree(&log.path("town"));
    let generate = "generate nuscenes:town --skeleton sk --out rollout --every 1 --generator fill --window 2 \
        --maps color --rasterizer cpu --dataset copy";
    for _ in 0..2 {
        let output = log.run(generate);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert!(!log.path("copy/.pskel-files").is_symlink());
        assert_eq!(std::fs::read(log.path("town/.pskel-files")).unwrap(), list);
        assert!(tree(&log.path("town")) == before);
    }
    // References alone would leave nothing to copy; that is known before the work.
    let output = log
        .run(&generate.replace("--window 2", "--window 3 --steps 1").replace("--out rollout", "--out new"));
    assert_failed(&output, 2, &["expected 2 steps or more with --dataset"]);
    assert!(!log.path("new").exists());
}

/// Checks that are made before the work: no step is generated, no skeleton is built.
#[test]
fn invalid_options_are_rejected_before_the_work() {
    let log = ready();
    let generate = "generate nuscenes:log --skeleton sk --out rollout --every 1 --generator fill --window 2 \
        --maps color --rasterizer cpu";
    for name in ["file", "broken.npy"] {
        std::fs::write(log.path(name), "").unwrap();
    }
    std::fs::write(log.path("q.ply.origin.json"), "{\"mine\": 1}").unwrap();
    symlink("log", log.path("link")).unwrap();
    for (args, part) in [
        (
            format!("{generate} --dataset log/copy"),
            "expected an output outside of the input log, found one in it: log/copy",
        ),
        (format!("{generate} --dataset log/v1.0-mini/a/b"), "outside of the input log"),
        (format!("{generate} --dataset link/copy"), "outside of the input log"),
        (format!("{generate} --dataset log"), "expected only files that pskel wrote"),
        (format!("{generate} --dataset file"), "expected a folder or none, found a file"),
        ("convert broken.npy --out q.ply".to_owned(), "expected an origin of points to replace, or none"),
    ] {
        assert_refused(&log, &args, part);
        assert!(!log.path("rollout").exists(), "{args}");
    }
    log.succeed("town seed=5,frames=2,size=57x100 --out town");
    let export = "export nuscenes:town --skeletons none --out videos --layout cosmos-video --rasterizer cpu";
    for size in ["--out-size 31x48", "--size 9x16", ""] {
        let output = log.run(&format!("{export} {size}"));
        assert_failed(&output, 1, &["failed: nuscenes:town: ", "expected"]);
        assert!(!Path::new(&log.path("none/town")).exists());
        assert!(std::fs::read_dir(log.path("none")).unwrap().next().is_none(), "{size}");
        std::fs::remove_dir_all(log.path("videos")).unwrap();
    }
}
