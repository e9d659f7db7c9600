//! Drives by the messages of the live page and measures it:
//! `cargo run --release -p pskel-drive --example client -- URL [SECONDS] [SPEED]`, with the address that
//! `pskel drive` prints. Prints frames per second, the time from a key to the first picture that follows it,
//! and the server's own times. SPEED (times the real time, default 1) above 1 shows how many frames are
//! possible.
#![allow(clippy::print_stdout, clippy::unwrap_used)] // a program for measurements

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tungstenite::{Message, connect};

/// Time between keys.
const KEYS: Duration = Duration::from_millis(130);

fn main() {
    let mut arguments = std::env::args().skip(1);
    let url = arguments.next().expect("expected URL [SECONDS] [SPEED]");
    let seconds: u64 = arguments.next().map_or(10, |text| text.parse().unwrap());
    let speed: f64 = arguments.next().map_or(1.0, |text| text.parse().unwrap());
    let (mut socket, _) = connect(url.replacen("http", "ws", 1).replace("/?", "/live?")).unwrap();
    let send = |socket: &mut tungstenite::WebSocket<_>, message: Value| {
        socket.send(Message::text(message.to_string())).unwrap();
    };
    let begin = Instant::now();
    send(&mut socket, json!({"type": "simulate"}));
    send(&mut socket, json!({"type": "keys", "throttle": 0.3, "number": 1}));
    send(&mut socket, json!({"type": "play", "playing": true, "speed": speed}));
    let (mut number, mut pressed) = (1_u64, BTreeMap::from([(1, begin)]));
    let (mut frames, mut first, mut bytes, mut steps) = (0_u64, None, 0, [None, None]);
    let (mut latencies, mut draw, mut encode, mut counts) = (Vec::new(), Vec::new(), Vec::new(), Value::Null);
    let mut next = begin + KEYS;
    while begin.elapsed() < Duration::from_secs(seconds) {
        match socket.read().unwrap() {
            Message::Binary(frame) => {
                let length = u32::from_le_bytes(frame[..4].try_into().unwrap()) as usize;
                let header: Value = serde_json::from_slice(&frame[4..4 + length]).unwrap();
                send(&mut socket, json!({"type": "ack", "frame": header["frame"]}));
                first.get_or_insert_with(|| begin.elapsed());
                frames += 1;
                bytes += frame.len();
                steps = [steps[0].or(header["step"].as_u64()), header["step"].as_u64()];
                draw.push(header["times_ms"]["draw"].as_f64().unwrap());
                encode.push(header["times_ms"]["encode"].as_f64().unwrap());
                let seen = header["keys_number"].as_u64().unwrap();
                while let Some(entry) = pressed.first_entry().filter(|entry| *entry.key() <= seen) {
                    latencies.push(entry.remove().elapsed().as_secs_f64() * 1e3);
                }
            }
            Message::Text(text) => {
                let text: Value = serde_json::from_str(&text).unwrap();
                match text["type"].as_str() {
                    Some("counts") => counts = text,
                    Some("notice") => println!("{text}"),
                    _ => {}
                }
            }
            _ => {}
        }
        if Instant::now() >= next {
            next = Instant::now() + KEYS;
            number += 1;
            let steer = if number.is_multiple_of(2) { 0.2 } else { -0.2 };
            send(&mut socket, json!({"type": "keys", "throttle": 0.05, "steer": steer, "number": number}));
            pressed.insert(number, Instant::now());
        }
    }
    let quantile = |values: &mut Vec<f64>, q: f64| {
        values.sort_by(f64::total_cmp);
        values
            .get(((values.len() as f64 * q) as usize).min(values.len().saturating_sub(1)))
            .copied()
            .unwrap_or(0.0)
    };
    let elapsed = begin.elapsed().as_secs_f64();
    println!(
        "{frames} frames in {elapsed:.1} s: {:.1} a second, {:.0} kB each, first after {:.0} ms; \
         steps {:?} to {:?}",
        frames as f64 / elapsed,
        bytes as f64 / 1e3 / frames.max(1) as f64,
        first.unwrap_or_default().as_secs_f64() * 1e3,
        steps[0],
        steps[1],
    );
    println!(
        "key to picture: median {:.0} ms, p99 {:.0} ms of {}; drawing {:.1} ms, encoding {:.1} ms (medians); \
         {counts}",
        quantile(&mut latencies.clone(), 0.5),
        quantile(&mut latencies.clone(), 0.99),
        latencies.len(),
        quantile(&mut draw, 0.5),
        quantile(&mut encode, 0.5),
    );
}
