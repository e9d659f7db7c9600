//! Point files that changed on disk without changing length: no command uses them, and `pskel info --verify`
//! lists them.

use serde_json::{Value, json};

use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{TinyLog, assert_failed};

const RENDER: &str = "render nuscenes:log --skeleton sk --rasterizer cpu --out out";

/// Returns a log with a skeleton in `sk` that has background, actors and a template.
fn built() -> TinyLog {
    let log = TinyLog::new();
    log.succeed("build nuscenes:log --out first");
    log.succeed("convert first --out npy");
    log.succeed("build nuscenes:log --out sk --template sedan=npy/actors/car.npy");
    log
}

/// Flips one bit of a file and returns its previous content.
fn flip_bit(log: &TinyLog, file: &str, at: usize) -> Vec<u8> {
    let before = std::fs::read(log.path(file)).unwrap();
    let mut bytes = before.clone();
    bytes[at] ^= 1;
    std::fs::write(log.path(file), bytes).unwrap();
    before
}

fn verified(log: &TinyLog, target: &str, code: i32) -> Value {
    let output = log.run(&format!("info --verify --json {target}"));
    assert_eq!(output.status.code(), Some(code), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice::<Value>(&output.stdout).unwrap()["verified"].clone()
}

#[test]
fn changed_bytes_are_detected_before_points_are_used() {
    let log = built();
    let manifest = log.json("sk/skeleton.json");
    let checksum = |list: &str| manifest[list][0]["xxh3"].as_str().unwrap().to_owned();
    for (file, list, name) in [
        ("background.points", "background", "chunk 0"),
        ("actors.points", "actors", "track \"car\" of log \"tiny\""),
        ("templates.points", "templates", "template sedan"),
    ] {
        let path = format!("sk/{file}");
        let whole = flip_bit(&log, &path, 5);
        let expected = format!("expected page 0 of {name} with checksum ");
        let whole_cloud = format!("expected {name} with checksum {}, found ", checksum(list));
        log.fail("convert sk --out out/npy", 1, &[&whole_cloud, &path]);
        for command in [
            RENDER,
            "bench nuscenes:log --skeleton sk --rasterizer cpu --repeat 1",
            "simulate nuscenes:log --skeleton sk --rasterizer cpu --steps 1 --out rollout",
        ] {
            log.fail(command, 1, &[&expected, &path]);
        }
        let reported = verified(&log, "sk", 1);
        let [damaged] = reported["damaged"].as_array().unwrap().as_slice() else { panic!("{reported}") };
        assert!(damaged.as_str().unwrap().starts_with(&expected), "{damaged}");
        // Without `--verify`, `info` reads no points.
        assert!(log.run("info sk").status.success());
        std::fs::write(log.path(&path), whole).unwrap();
    }
    log.succeed(RENDER);
}

#[test]
fn every_damaged_cloud_is_listed() {
    let log = built();
    let manifest = log.json("sk/skeleton.json");
    let clouds = ["background", "actors", "templates"].map(|list| manifest[list].as_array().unwrap().len());
    assert!(clouds.iter().all(|count| *count > 0) && clouds[0] > 1, "{clouds:?}");
    let points: usize = ["background", "actors", "templates"]
        .iter()
        .map(|file| std::fs::metadata(log.path(&format!("sk/{file}.points"))).unwrap().len() as usize / 16)
        .sum();
    let count: usize = clouds.iter().sum();
    let whole = json!({"clouds": count, "points": points, "damaged": []});
    assert_eq!(verified(&log, "sk", 0), whole);
    let text = String::from_utf8(log.run("info --verify sk").stdout).unwrap();
    let line = format!("verified   {points} points in {count} clouds, all checksums match");
    assert!(text.contains(&line), "{text}");

    let end = std::fs::metadata(log.path("sk/background.points")).unwrap().len() as usize - 1;
    flip_bit(&log, "sk/background.points", end);
    flip_bit(&log, "sk/templates.points", 0);
    let output = log.run("info --verify sk");
    let found = format!("2 of {count} clouds are damaged: sk");
    assert_failed(&output, 1, &[&found]);
    let text = String::from_utf8(output.stdout).unwrap();
    for part in
        ["2 damaged", &format!(" of chunk {} with", clouds[0] - 1), "expected page 0 of template sedan with"]
    {
        assert!(text.contains(part), "{text}\nexpected {part}");
    }
}

#[test]
fn changed_bytes_of_a_library_are_detected_on_opening() {
    let log = built();
    log.succeed("templates sk --out t --min-points 1");
    assert_eq!(verified(&log, "t", 0)["damaged"], json!([]));
    let whole = flip_bit(&log, "t/templates.points", 3);
    for command in [&format!("{RENDER} --templates t"), "info t", "info --verify t"] {
        log.fail(command, 1, &["expected template sedan with checksum ", "t/templates.points"]);
    }
    log.fail("build nuscenes:log --out out/sk --templates-from t", 1, &["template sedan with checksum"]);
    std::fs::write(log.path("t/templates.points"), whole).unwrap();
    log.succeed(&format!("{RENDER} --templates t"));
}

#[test]
fn only_points_with_checksums_can_be_verified() {
    let log = TinyLog::new();
    for target in ["nuscenes:log", "log/samples/0.pcd.bin", "nowhere"] {
        log.fail(&format!("info --verify {target}"), 2, &["a skeleton or of templates for --verify", target]);
    }
}
