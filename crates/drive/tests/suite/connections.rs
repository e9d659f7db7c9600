//! Who may connect, and how much a client may ask for.

use std::time::{Duration, Instant};

use serde_json::json;
use tungstenite::Message;

use crate::client::Server;

#[test]
fn other_sites_and_guesses_are_refused() {
    let server = Server::start();
    let live = format!("/live?token={}", server.token);
    assert!(server.ask("/live", &[]).is_err(), "no token");
    assert!(server.ask("/live?token=0", &[]).is_err(), "wrong token");
    assert!(server.ask(&live, &[("origin", "http://evil.example")]).is_err(), "other origin");
    assert!(server.ask(&live, &[("host", "evil.example")]).is_err(), "other host");
    assert!(server.ask(&live, &[("origin", &format!("http://{}", server.address))]).is_ok());
    let status = |path: &str, headers: &str| server.get(path, headers).0;
    assert_eq!(status("/", ""), 403);
    assert_eq!(status(&format!("/?token={}", server.token), ""), 200);
    assert_eq!(status("/", &format!("Cookie: pskel={}\r\n", server.token)), 200);
    assert_eq!(status(&format!("/?token={}", server.token), "Host: evil.example\r\n"), 403);
    for path in ["/picture?camera=CAM_FRONT&map=color", "/rollouts/first/index.html", "/rollouts/../x"] {
        assert!([403, 404].contains(&status(path, "")), "{path}");
    }
    for name in ["base.css", "plots.js", "main.js", "drive.css"] {
        assert_eq!(status(&format!("/page/{name}"), ""), 200, "{name}");
    }
    assert_eq!(status("/page/secret", ""), 404);
    let token = format!("?token={}", server.token);
    assert_eq!(status(&format!("/rollouts/%2e%2e%2fskeleton%2fskeleton.json{token}"), ""), 404);
    assert_eq!(status(&format!("/rollouts/../skeleton/skeleton.json{token}"), ""), 404);
}

#[test]
fn wrong_messages_are_answered_and_too_many_end_the_connection() {
    let server = Server::start();
    let mut client = server.connect();
    for text in ["", "[]", "{\"type\": \"fly\"}", "{\"type\": \"look\", \"frame\": -1}", "\u{0}"] {
        client.socket.send(Message::text(text)).unwrap();
        assert!(client.text("notice")["text"].as_str().unwrap().contains("expected a message of the page"));
    }
    client.send(&json!({"type": "look", "frame": 2})); // still served
    client.frame_with(|header| header["t_s"] == 0.4);
    for _ in 0..10 {
        let _ = client.socket.send(Message::text("x"));
    }
    let is_closed =
        (0..1000).any(|_| !matches!(client.socket.read(), Ok(Message::Text(_) | Message::Binary(_))));
    assert!(is_closed);

    let mut large = server.connect();
    let _ = large.socket.send(Message::text("x".repeat(17 << 10)));
    assert!((0..1000).any(|_| large.socket.read().is_err()), "a message of 17 KiB");
    let mut many = server.connect();
    for _ in 0..2000 {
        if many.socket.send(Message::text("{\"type\": \"ack\", \"frame\": 1}")).is_err() {
            break;
        }
    }
    assert!((0..1000).any(|_| !matches!(many.socket.read(), Ok(Message::Text(_) | Message::Binary(_)))));
    server.connect(); // others are served
}

#[test]
fn one_client_drives_and_others_watch() {
    let server = Server::start();
    let mut first = server.connect();
    assert_eq!(first.text("who")["you_drive"], true);
    let mut second = server.connect();
    assert_eq!(second.text("who")["you_drive"], false);
    second.send(&json!({"type": "look", "frame": 3}));
    assert!(second.text("notice")["text"].as_str().unwrap().contains("another window drives"));
    first.send(&json!({"type": "look", "frame": 4}));
    let shown = |header: &serde_json::Value| header["t_s"] == 0.8;
    assert!(shown(&second.frame_with(shown).header) && shown(&first.frame_with(shown).header));
    second.send(&json!({"type": "drive", "take": true}));
    second.send(&json!({"type": "look", "frame": 1}));
    first.frame_with(|header| header["t_s"] == 0.2);
    drop(second);
    while first.text("who")["you_drive"] != true || first.texts.iter().any(|text| text["type"] == "who") {}
    first.send(&json!({"type": "look", "frame": 5}));
    first.frame_with(|header| header["t_s"] == 1.0);
    // Fifty more are served or refused.
    let more: Vec<_> = (0..50).map(|_| server.ask(&format!("/live?token={}", server.token), &[])).collect();
    assert!(more.iter().all(Result::is_ok));
    first.send(&json!({"type": "look", "frame": 0}));
    first.frame_with(|header| header["t_s"] == 0.0);
}

/// A client that acknowledges nothing gets two frames, and neither the simulation nor another client waits
/// for it.
#[test]
fn a_slow_client_slows_nothing() {
    let server = Server::start();
    let mut fast = server.connect();
    let mut slow = server.connect();
    fast.send(&json!({"type": "view", "size": [45, 80], "birdseye": null}));
    fast.send(&json!({"type": "simulate", "hz": 20.0, "actors": "replay"}));
    fast.send(&json!({"type": "keys", "throttle": 0.1}));
    fast.send(&json!({"type": "play", "playing": true}));
    let start = Instant::now();
    fast.frame_with(|header| header["step"].as_u64() >= Some(40));
    assert!(start.elapsed() >= Duration::from_millis(1900), "faster than real time: {:?}", start.elapsed());
    let mut frames = 0;
    slow.socket.get_ref().set_read_timeout(Some(Duration::from_millis(200))).unwrap();
    let mut dropped = 0;
    while let Ok(message) = slow.socket.read() {
        match message {
            Message::Binary(_) => frames += 1,
            Message::Text(text) => {
                let text: serde_json::Value = serde_json::from_str(&text).unwrap();
                dropped = text["dropped"].as_u64().unwrap_or(dropped);
            }
            _ => {}
        }
    }
    assert_eq!(frames, 2);
    // What it missed is counted when it takes part again.
    slow.socket.get_ref().set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    slow.send(&json!({"type": "ack", "frame": 1}));
    let counts = (0..1000).find_map(|_| {
        let counts = slow.text("counts");
        (counts["dropped"].as_u64() > Some(5)).then_some(counts)
    });
    assert!(counts.is_some() && dropped == 0, "{dropped}");
}
