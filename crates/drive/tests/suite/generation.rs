//! Generated images of a drive.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use image::{Rgb, RgbImage};
use point_skeleton::Renderer;
use point_skeleton::scene::SceneState;
use pskel_drive::LiveGenerator;
use pskel_sim::report::images::StepImages;
use pskel_sim::rollout::{AnyError, GenerationTimes, ImageGenerator};
use pskel_sim::{Committed, Forecast};
use serde_json::{Value, json};

use crate::client::{Client, Server};

const WINDOW: usize = 3;

/// Steps and forecast steps of all frames.
type Seen = Arc<Mutex<Vec<(usize, Vec<usize>)>>>;

/// Images whose red is the step, green the number of forecasts, and blue that of actors.
struct Painter {
    cost: Duration,
    fails_at: Option<usize>,
    seen: Seen,
}

impl ImageGenerator for Painter {
    fn forecasts(&self) -> usize {
        WINDOW
    }

    fn generate(
        &mut self,
        frame: usize,
        now: Committed<&SceneState>,
        expected: &[Forecast<SceneState>],
        _: &mut Renderer<'_>,
    ) -> Result<Option<StepImages>, AnyError> {
        std::thread::sleep(self.cost);
        let SceneState { name, actors, .. } = now.get();
        let step: usize = name.parse()?;
        if self.fails_at.is_some_and(|at| step >= at) {
            return Err("the brush is lost".into());
        }
        let ahead = expected.iter().map(|next| next.get().name.parse().unwrap()).collect();
        self.seen.lock().unwrap().push((step, ahead));
        let color = Rgb([step as u8, expected.len() as u8, actors.len() as u8]);
        let images = vec![RgbImage::from_pixel(8, 4, color); 6];
        Ok(Some(StepImages { is_reference: frame < WINDOW - 1, images, truth: None, rows: None }))
    }

    fn add_reference(
        &mut self,
        _: Committed<&SceneState>,
        _: Vec<RgbImage>,
        _: &mut Renderer<'_>,
    ) -> Result<(), AnyError> {
        Ok(())
    }

    fn times(&self) -> GenerationTimes {
        GenerationTimes::default()
    }

    fn save(&self) -> Result<Option<Vec<u8>>, AnyError> {
        Ok(None)
    }

    fn resume(
        &mut self,
        _: usize,
        _: &[Committed<SceneState>],
        _: Option<&[u8]>,
        _: &mut Renderer<'_>,
    ) -> Result<(), AnyError> {
        Ok(())
    }

    fn window(&self) -> usize {
        WINDOW
    }

    fn has_truth(&self) -> bool {
        false
    }
}

/// Returns a generator of 5 images per second, and the frames that it has seen.
fn painter(cost: Duration, fails_at: Option<usize>) -> (LiveGenerator, Seen) {
    let seen = Seen::default();
    let shared = Arc::clone(&seen);
    let generator = LiveGenerator {
        name: "painter".to_owned(),
        hz: 5.0,
        window: WINDOW,
        forecasts: WINDOW,
        arguments: vec!["--generator".to_owned(), "painter".to_owned()],
        record: json!({"network": "painter"}),
        fact: "painted".to_owned(),
        open: Box::new(move |_, _| Ok(Box::new(Painter { cost, fails_at, seen: Arc::clone(&shared) }))),
    };
    (generator, seen)
}

fn shown(client: &mut Client, step: u64) -> (Value, Option<[u8; 3]>) {
    let is_there = |header: &Value| {
        let generated = &header["generated"];
        header["step"] == step && (!generated["failure"].is_null() || generated["is_waiting"] == false)
    };
    let frame = client.frame_with(is_there);
    let image = frame.image("CAM_BACK", "generated");
    let pixel = |bytes| image::load_from_memory(bytes).unwrap().to_rgb8().get_pixel(7, 3).0;
    (frame.header.clone(), image.map(pixel))
}

#[test]
fn the_simulation_waits_for_each_image_in_lockstep() {
    let (generator, seen) = painter(Duration::from_millis(5), None);
    let server = Server::with_generator(Some(generator));
    let mut client = server.connect();
    let told = json!({"name": "painter", "hz": 5.0, "references": 2, "mode": "off"});
    assert_eq!(client.hello["generator"], told);
    assert!(client.hello["maps"].as_array().unwrap().contains(&json!("generated")));
    let view = json!({"type": "view", "codec": "png", "maps": ["color", "generated"], "size": [45, 80]});
    client.send(&view);
    client.send(&json!({"type": "simulate", "hz": 10.0}));
    client.send(&json!({"type": "generate", "mode": "lockstep"}));
    let (header, pixel) = shown(&mut client, 0);
    let [0, 3, actors @ 2..=u8::MAX] = pixel.unwrap() else { panic!("{pixel:?}") };
    assert_eq!(header["generated"]["is_reference"], true);
    // A hidden actor is hidden from the generator too.
    client.send(&json!({"type": "view", "hide": [header["actors"][0]["track"]]}));
    // The log drives until all references are there.
    client.send(&json!({"type": "keys", "throttle": 1.0, "number": 1}));
    assert!(client.text("notice")["text"].as_str().unwrap().contains("1 more reference image"));
    client.send(&json!({"type": "step", "count": 9}));
    let (header, pixel) = shown(&mut client, 9);
    assert_eq!((&header["by"], &header["takeover"]), (&json!("person"), &json!(4)));
    let generated = &header["generated"];
    let counts = ["step", "references", "count", "skipped"].map(|name| generated[name].as_u64().unwrap());
    assert_eq!((counts, pixel), ([8, 2, 3, 0], Some([8, 3, actors - 1])));
    let behind_s = generated["behind_s"].as_f64().unwrap();
    assert!((behind_s - 0.1).abs() < 1e-9 && generated["is_reference"] == false, "{generated}");
    let frames: Vec<_> = [0, 2, 4, 6, 8].map(|step| (step, vec![step + 2, step + 4, step + 6])).into();
    assert_eq!(*seen.lock().unwrap(), frames);

    // A rollout of it is generated again, and begins with the same references.
    let command = header["command"].as_str().unwrap();
    assert!(
        command.contains("--plan-hz 5 --warmup 3") && command.contains("--generator painter"),
        "{command}"
    );
    client.send(&json!({"type": "save", "name": "painted"}));
    assert_eq!(client.text("saved")["name"], "painted");
    let rollout = server.out().join("painted");
    let image = |step: usize| image::open(rollout.join(format!("steps/{step:06}/generated/CAM_BACK.png")));
    assert_eq!(image(8).unwrap().to_rgb8().get_pixel(0, 0).0[0], 8);
    assert!(image(7).is_err());
    let states = std::fs::read_to_string(rollout.join("states.jsonl")).unwrap();
    let last: Value = serde_json::from_str(states.lines().last().unwrap()).unwrap();
    for name in ["speed_mps", "acceleration_mps2", "yaw_rate_radps", "steering_rad"] {
        assert_eq!(header["ego"][name], last["ego"][name], "{name}");
    }

    // The log has given the wheel away: the generator cannot begin here.
    client.send(&json!({"type": "generate", "mode": "off"}));
    client.send(&json!({"type": "generate", "mode": "beside"}));
    assert!(client.text("notice")["text"].as_str().unwrap().contains("reset the simulation first"));
    client.send(&json!({"type": "reset"}));
    let off = client.frame_with(|header| header["step"] == 0);
    assert_eq!((&off.header["generated"], off.image("CAM_BACK", "generated")), (&Value::Null, None));
    server.end().unwrap();
}

#[test]
fn a_slow_generator_beside_the_simulation_skips_frames() {
    let (generator, seen) = painter(Duration::from_millis(150), None);
    let server = Server::with_generator(Some(generator));
    let mut client = server.connect();
    client.send(&json!({"type": "view", "maps": ["generated"], "size": [45, 80], "birdseye": null}));
    client.send(&json!({"type": "generate", "mode": "beside"}));
    client.send(&json!({"type": "simulate", "hz": 10.0}));
    client.send(&json!({"type": "play", "playing": true, "speed": 4.0}));
    let is_end =
        |header: &Value| !header["ended"].is_null() && header["generated"]["count"].as_u64() > Some(0);
    let end = client.frame_with(is_end).header;
    let skipped = end["generated"]["skipped"].as_u64().unwrap();
    assert!(end["step"] == 10 && skipped > 0 && end["generated"]["references"] == 2, "{end}");
    let steps: Vec<usize> = seen.lock().unwrap().iter().map(|(step, _)| *step).collect();
    assert!(steps.starts_with(&[0, 2]), "references are waited for: {steps:?}");
    server.end().unwrap();
}

#[test]
fn a_failure_is_shown_and_the_simulation_goes_on() {
    let (generator, _) = painter(Duration::ZERO, Some(4));
    let server = Server::with_generator(Some(generator));
    let mut client = server.connect();
    client.send(&json!({"type": "generate", "mode": "lockstep"}));
    client.send(&json!({"type": "simulate", "hz": 10.0}));
    client.send(&json!({"type": "step", "count": 8}));
    let (header, _) = shown(&mut client, 8);
    assert_eq!(header["generated"]["failure"], "the brush is lost");
    // A new beginning is a new session.
    client.send(&json!({"type": "reset"}));
    assert_eq!(shown(&mut client, 0).0["generated"]["failure"], Value::Null);
    server.end().unwrap();
}

#[test]
fn without_a_generator_nothing_is_generated() {
    let server = Server::start();
    let mut client = server.connect();
    assert_eq!(client.hello["generator"], Value::Null);
    for wrong in
        [json!({"type": "generate", "mode": "beside"}), json!({"type": "view", "maps": ["generated"]})]
    {
        client.send(&wrong);
        assert!(
            client.text("notice")["text"].as_str().unwrap().contains("start with --generator"),
            "{wrong}"
        );
    }
    server.end().unwrap();
}
