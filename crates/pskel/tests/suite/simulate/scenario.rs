//! Scenarios on the command line: maps, rollouts and their folders.

use serde_json::json;

use super::{SIMULATE, built, rows};
use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{TinyLog, assert_failed, tree};

/// Writes a scenario with a car 8 m ahead of the ego, and one that ends in the middle of the log.
fn write(log: &TinyLog) {
    let at = json!({"in": {"ego": {"after_s": 0.0}}, "x_m": 8.0, "y_m": 0.0});
    let insert = json!({"insert": {"category": "vehicle.car", "size_m": [4.0, 1.8, 1.5], "at": at}});
    let write = |name: &str, value: serde_json::Value| {
        std::fs::write(log.path(name), value.to_string()).unwrap();
    };
    write("new.json", json!({"changes": [{"track": "new", "action": insert}]}));
    write(
        "idm.json",
        json!({"changes": [{"track": "new", "action": insert}, {"track": "new", "action": "idm"}]}),
    );
    write("empty.json", json!({}));
    write("wrong.json", json!({"changes": [{"track": "nobody", "action": "remove"}]}));
}

#[test]
fn scenarios_change_rollouts_and_their_records() {
    let log = built();
    write(&log);
    let run = |out: &str, rest: &str| {
        let command = SIMULATE.replace("--out out", &format!("--out {out}"));
        format!("{command} --maps depth,instance --ego replay {rest}")
    };
    log.succeed(&run("plain", "--steps 8"));
    log.succeed(&run("empty", "--steps 8 --scenario empty.json"));
    let [plain, empty] = ["plain", "empty"].map(|folder| tree(&log.path(folder)));
    assert!(plain == empty, "an empty scenario gives the same files");
    log.succeed(&run("out", "--steps 6 --scenario new.json"));
    let tracks = |folder: &str| {
        let actors = rows(&log, folder)[3]["actors"].as_array().unwrap().clone();
        actors.iter().map(|actor| actor["track"].as_str().unwrap().to_owned()).collect::<Vec<_>>()
    };
    assert!(tracks("out").contains(&"new".to_owned()) && !tracks("plain").contains(&"new".to_owned()));
    assert_eq!(log.json("out/rollout.json")["changes"][0]["track"], "new");
    assert!(log.json("plain/rollout.json").get("changes").is_none());
    // The same scenario resumes, no other.
    let before = tree(&log.path("out"));
    for other in ["", "--scenario empty.json", "--scenario idm.json"] {
        let refused = log.run(&run("out", &format!("--steps 8 --resume {other}")));
        assert_failed(&refused, 1, &["expected the frames of out/rollout.json"]);
        assert!(tree(&log.path("out")) == before);
    }
    log.succeed(&run("out", "--steps 8 --resume --scenario new.json"));
    assert_eq!(rows(&log, "out").len(), 9);
}

#[test]
fn actors_that_boxes_alone_show_are_counted() {
    let log = built();
    let at = json!({"in": {"ego": {"after_s": 0.0}}, "x_m": 8.0, "y_m": 0.0});
    let insert =
        |category: &str| json!({"insert": {"category": category, "size_m": [1.0, 1.0, 1.0], "at": at}});
    let change = |track: &str, category: &str| json!({"track": track, "action": insert(category)});
    for (name, categories, expected) in [
        ("car", ["vehicle.car", "vehicle.car"], None),
        ("one", ["vehicle.car", "movable_object.debris"], Some("1 actor has neither points nor a template")),
        ("two", ["movable_object.debris", "animal"], Some("2 actors have neither points nor a template")),
    ] {
        let changes = json!({"changes": [change("a", categories[0]), change("b", categories[1])]});
        std::fs::write(log.path("scenario.json"), changes.to_string()).unwrap();
        let render = format!("render nuscenes:log --skeleton sk --rasterizer cpu --out {name}");
        let simulate = SIMULATE.replace("--out out", &format!("--out {name}-rollout"));
        for command in [render, format!("{simulate} --steps 2 --maps depth --ego replay")] {
            let output = log.run(&format!("{command} --scenario scenario.json"));
            assert!(output.status.success());
            let errors = String::from_utf8(output.stderr).unwrap();
            match expected {
                Some(expected) => assert!(errors.contains(expected), "{command}: {errors}"),
                None => assert!(!errors.contains("neither points"), "{command}: {errors}"),
            }
        }
    }
}

#[test]
fn scenarios_that_do_not_fit_are_refused() {
    let log = built();
    write(&log);
    let render = "render nuscenes:log --skeleton sk --out maps --rasterizer cpu";
    let parts = ["scenario wrong.json", "expected a track of log", "change 1, of track nobody"];
    assert_failed(&log.run(&format!("{render} --scenario wrong.json")), 1, &parts);
    let parts = ["found idm as change 2", "use pskel simulate"];
    assert_failed(&log.run(&format!("{render} --scenario idm.json")), 2, &parts);
    assert_failed(&log.run(&format!("{render} --scenario none.json")), 1, &["none.json"]);
    assert!(!log.path("maps").exists());
    let slow = "scenario nuscenes:log --family side --out made.json";
    assert_failed(&log.run(slow), 1, &["expected an ego with 3 m/s or more about 3 s"]);
    assert!(!log.path("made.json").exists());
}
