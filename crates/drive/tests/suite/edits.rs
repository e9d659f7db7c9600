//! Actors that are held or replaced.

use std::collections::BTreeMap;
use std::path::Path;

use point_skeleton::conditions::write::png;
use point_skeleton::conditions::{ConditionOptions, DepthBins, ImageSize, MapKind, MapSet};
use point_skeleton::dataset::ActorEdits;
use point_skeleton::{RenderOptions, Renderer};
use pskel_testing::six_cameras::{FIRST_US, STEP_US};
use serde_json::json;

use crate::client::{Server, inputs};

const MAPS: [MapKind; 4] = [MapKind::Color, MapKind::Depth, MapKind::Instance, MapKind::Boxes];

#[test]
fn edited_actors_have_the_bytes_of_rendered_files() {
    let server = Server::start();
    let mut client = server.connect();
    let t_us = FIRST_US + 3 * STEP_US;
    client.send(&json!({"type": "view", "codec": "png", "maps": ["color", "depth", "instance", "boxes"],
        "size": [45, 80]}));
    client.send(&json!({"type": "look", "frame": 1}));
    let as_recorded = client.frame_with(|header| header["t_us"] == FIRST_US + STEP_US);
    client.send(&json!({"type": "view", "hold": {"ahead": t_us}, "replace": {"left": "ahead"}}));
    let held = format!("--hold ahead@{t_us} --replace left=ahead ");
    let frame = client.frame_with(|header| header["command"].as_str().unwrap().contains(&held));
    assert_eq!((&frame.header["t_us"], &frame.header["mode"]), (&as_recorded.header["t_us"], &json!("look")));

    let scratch = tempfile::tempdir().unwrap();
    let inputs = inputs(scratch.path(), None);
    let edits = ActorEdits {
        hold: BTreeMap::from([("ahead".to_owned(), t_us)]),
        replace: BTreeMap::from([("left".to_owned(), "ahead".into())]),
        ..ActorEdits::default()
    };
    let log = inputs.log.edited(&edits).unwrap();
    let conditions = ConditionOptions {
        maps: MapSet::of(&MAPS),
        size: Some(ImageSize { height: 45, width: 80 }),
        ..ConditionOptions::default()
    };
    let mut renderer =
        Renderer::new(&inputs.skeleton, RenderOptions { conditions, ..RenderOptions::default() }).unwrap();
    let maps = renderer.render(&log.frame(1).unwrap()).unwrap();
    let mut changed = 0;
    for camera in &maps.set.cameras {
        for kind in MAPS {
            let bins = DepthBins::default();
            let expected = png::encode_map(Path::new("x"), camera, kind, &bins).unwrap().unwrap();
            assert!(frame.image(&camera.name, kind.name()) == Some(&expected[..]), "{} {kind}", camera.name);
            let before = as_recorded.image(&camera.name, kind.name());
            changed += usize::from(before != Some(&expected[..]));
        }
    }
    assert!(changed >= 2, "{changed} maps changed");

    // Undone, all is as before.
    client.send(&json!({"type": "view", "hold": {}, "replace": {}}));
    let frame = client.frame_with(|header| !header["command"].as_str().unwrap().contains("--hold"));
    for kind in MAPS {
        assert!(
            frame.image("CAM_FRONT", kind.name()) == as_recorded.image("CAM_FRONT", kind.name()),
            "{kind}"
        );
    }
    for (wrong, expected) in [
        (json!({"hold": {"nobody": t_us}}), "expected tracks of log town-3, found \"nobody\""),
        (json!({"hold": {"ahead": 5}}), "expected a time at which track ahead of log town-3 has a box"),
        (json!({"replace": {"ahead": "nobody"}}), "expected tracks of log town-3, found \"nobody\""),
    ] {
        let mut message = wrong;
        message["type"] = "view".into();
        client.send(&message);
        let notice = client.text("notice");
        assert!(notice["text"].as_str().unwrap().starts_with(expected), "{notice}");
    }
    server.end().unwrap();
}

#[test]
fn a_simulation_begins_anew_with_edited_actors() {
    let server = Server::start();
    let mut client = server.connect();
    client.send(&json!({"type": "view", "codec": "png", "maps": ["color", "instance"], "size": [45, 80]}));
    client.send(&json!({"type": "simulate", "hz": 10.0, "actors": "replay"}));
    client.send(&json!({"type": "step", "count": 3}));
    client.frame_with(|header| header["step"] == 3);
    client.send(&json!({"type": "view", "hold": {"ahead": FIRST_US}}));
    let notice = client.text("notice");
    assert_eq!(notice["text"], "the actors have changed: the simulation begins anew");
    client.frame_with(|header| header["step"] == 0);
    // The ego drives into the car that has stopped.
    client.send(&json!({"type": "keys", "throttle": 1.0}));
    let mut events = Vec::new();
    for step in 1..=25 {
        client.send(&json!({"type": "step"}));
        let header = client.frame_with(|header| header["step"] == step).header;
        events.extend(header["events"].as_array().unwrap().iter().map(|event| event["text"].to_string()));
    }
    assert!(events.iter().any(|text| text.contains("collision")), "{events:?}");
    client.send(&json!({"type": "save", "name": "held"}));
    let saved = client.text("saved");
    assert!(saved["command"].as_str().unwrap().contains(&format!("--hold ahead@{FIRST_US}")), "{saved}");
    let record = server.out().join("held/rollout.json");
    let record: serde_json::Value = point_skeleton::files::json::read(&record, "a rollout").unwrap();
    assert_eq!(record["hold"], json!({"ahead": FIRST_US}));
    server.end().unwrap();
}
