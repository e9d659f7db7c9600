//! Drives, and rollouts along them.

use point_skeleton::files::json;
use serde_json::{Value, json};

use crate::client::{Client, Server};

/// Begins a drive and steps through it by hand: two steps by the log, five with the pedal down and the wheel
/// turned, and some by a policy. Returns the headers of the frames.
fn drive(client: &mut Client) -> Vec<Value> {
    client.send(&json!({"type": "view", "codec": "png", "maps": ["color", "instance"], "size": [45, 80]}));
    client.send(&json!({"type": "simulate", "hz": 10.0, "actors": "idm"}));
    let mut headers = Vec::new();
    let mut step = |client: &mut Client, wanted: u64| {
        client.send(&json!({"type": "step"}));
        headers.push(client.frame_with(|header| header["step"] == wanted).header);
    };
    (1..=2).for_each(|wanted| step(client, wanted));
    client.send(&json!({"type": "keys", "throttle": 1.0, "steer": 0.6, "number": 7}));
    (3..=7).for_each(|wanted| step(client, wanted));
    client.send(&json!({"type": "control", "by": "straight"}));
    (8..=12).for_each(|wanted| step(client, wanted));
    headers
}

#[test]
fn a_saved_drive_has_the_states_and_the_maps_of_the_page() {
    let server = Server::start();
    let mut client = server.connect();
    let headers = drive(&mut client);
    assert_eq!((&headers[1]["by"], &headers[1]["takeover"]), (&json!("log"), &Value::Null));
    assert_eq!((&headers[2]["by"], &headers[2]["takeover"]), (&json!("person"), &json!(2)));
    assert_eq!((&headers[6]["keys_number"], &headers[7]["by"]), (&json!(7), &json!("straight")));
    let speed = |header: &Value| header["ego"]["speed_mps"].as_f64().unwrap();
    assert!(speed(&headers[6]) > speed(&headers[1]) + 1.0, "the pedal has no effect");
    let yaw = |header: &Value| header["ego"]["yaw_rad"].as_f64().unwrap();
    assert!(yaw(&headers[6]) > yaw(&headers[1]) + 0.01, "the wheel has no effect");

    client.send(&json!({"type": "save", "name": "first"}));
    let saved = client.text("saved");
    let folder = server.out().join("first");
    assert_eq!(saved["folder"], folder.to_str().unwrap());
    // All states are those that the page has shown.
    let states = std::fs::read_to_string(folder.join("states.jsonl")).unwrap();
    let states: Vec<Value> = states.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(states.len(), 13);
    for (header, state) in headers.iter().zip(&states[1..]) {
        assert_eq!(header["t_us"], state["t_us"]);
        for name in ["speed_mps", "acceleration_mps2", "yaw_rate_radps", "steering_rad"] {
            assert_eq!(header["ego"][name], state["ego"][name], "{name} of step {}", state["step"]);
        }
    }
    // So are the maps.
    client.send(&json!({"type": "step"}));
    client.send(&json!({"type": "reset"}));
    client.frame_with(|header| header["step"] == 0);
    for wanted in 1..=2 {
        client.send(&json!({"type": "step"}));
        let frame = client.frame_with(|header| header["step"] == wanted);
        for map in ["color", "instance"] {
            let file = folder.join(format!("steps/{wanted:06}/CAM_FRONT/{map}.png"));
            let expected = std::fs::read(&file).unwrap();
            assert!(frame.image("CAM_FRONT", map) == Some(&expected[..]), "{}", file.display());
        }
    }
    let trajectory: Value = json::read(&server.out().join("first.json"), "a trajectory").unwrap();
    assert_eq!(trajectory["waypoints"].as_array().unwrap().len(), 11);
    let (status, page) = server.get(&format!("/rollouts/first/index.html?token={}", server.token), "");
    assert!(status == 200 && String::from_utf8(page).unwrap().contains("rollout"));
    let command = saved["command"].as_str().unwrap();
    assert!(command.contains("--ego file --trajectory") && command.contains("--warmup 3"), "{command}");
    // A name is taken once.
    client.send(&json!({"type": "step"}));
    client.send(&json!({"type": "save", "name": "first"}));
    assert!(client.text("notice")["text"].as_str().unwrap().contains("found one that exists"));
    server.end().unwrap();
}

#[test]
fn the_log_ends_and_a_person_drives_on() {
    let server = Server::start();
    let mut client = server.connect();
    client.send(&json!({"type": "view", "size": [45, 80], "birdseye": null}));
    client.send(&json!({"type": "simulate", "hz": 20.0}));
    client.send(&json!({"type": "step", "count": 1000}));
    let end = client.frame_with(|header| !header["ended"].is_null()).header;
    assert_eq!((&end["step"], &end["playing"]), (&json!(20), &json!(false)));
    client.send(&json!({"type": "keys", "throttle": 0.5}));
    let on = client.frame_with(|header| header["step"].as_u64() > Some(25)).header;
    assert_eq!((&on["by"], &on["ended"], &on["takeover"]), (&json!("person"), &Value::Null, &json!(20)));
    // Back on the recorded path there is none.
    client.send(&json!({"type": "control", "by": "log"}));
    client.frame_with(|header| !header["ended"].is_null());
    // A new simulation begins at the end of the log, not after it.
    client.send(&json!({"type": "simulate", "hz": 20.0}));
    let anew = client.frame_with(|header| header["step"] == 0).header;
    assert_eq!(anew["t_us"], client.hello["frames_us"].as_array().unwrap().last().unwrap().clone());
}
