//! First message to a client: the log, and what can be chosen.

use std::collections::BTreeMap;

use serde::Serialize;

use super::Engine;
use super::live::{LOG, PERSON, POLICIES};
use crate::generated::Mode;
use crate::message::{PROTOCOL, to_json};
use crate::view::{GENERATED, KINDS, RECORDED, View};
use point_skeleton::MapKind;

#[derive(Serialize)]
#[serde(tag = "type", rename = "hello")]
struct Hello<'a> {
    protocol: u32,
    log: &'a str,
    description: &'a str,
    log_path: &'a str,
    skeleton: String,
    frames_us: Vec<i64>,
    cameras: Vec<Camera<'a>>,
    maps: Vec<&'static str>,
    has_map: bool,
    rates: [f64; 2],
    generator: Option<GeneratorInfo<'a>>,
    drivers: Vec<&'static str>,
    splat_default: String,
    view: &'a View,
    tracks: Vec<Track<'a>>,
}

#[derive(Serialize)]
struct GeneratorInfo<'a> {
    name: &'a str,
    hz: f64,
    references: usize,
    mode: Mode,
}

#[derive(Serialize)]
struct Camera<'a> {
    name: &'a str,
    width: u32,
    height: u32,
}

#[derive(Serialize)]
struct Track<'a> {
    track: &'a str,
    category: &'a str,
    first_us: i64,
    last_us: i64,
    boxes: usize,
    points: usize,
}

#[derive(Serialize)]
#[serde(tag = "type", rename = "view")]
struct ViewMessage<'a> {
    view: &'a View,
}

/// Returns the message after a change of the view.
pub(super) fn view(view: &View) -> String {
    to_json(&ViewMessage { view })
}

/// Returns the first message.
pub(super) fn hello(engine: &Engine<'_>) -> String {
    let (inputs, log) = (engine.inputs, engine.inputs.log.recording());
    let has_map = engine.map.is_some();
    let kinds = KINDS.into_iter().filter(|kind| *kind != MapKind::Map || has_map);
    let rig = log.rig.iter().map(|rig| Camera {
        name: rig.camera.name.as_str(),
        width: rig.camera.width,
        height: rig.camera.height,
    });
    let generated = inputs.generator.as_ref().map(|_| GENERATED);
    to_json(&Hello {
        protocol: PROTOCOL,
        log: &log.name,
        description: &log.description,
        log_path: &inputs.log_name,
        skeleton: inputs.skeleton_path.display().to_string(),
        frames_us: log.frames.iter().map(|frame| frame.t_us).collect(),
        cameras: rig.collect(),
        maps: kinds.map(MapKind::name).chain([RECORDED]).chain(generated).collect(),
        has_map,
        generator: inputs.generator.as_ref().map(|generator| GeneratorInfo {
            name: &generator.name,
            hz: generator.hz,
            references: generator.window - 1,
            mode: engine.generation.mode,
        }),
        rates: [inputs.rates.sim_hz, inputs.rates.plan_hz],
        drivers: [LOG, PERSON].into_iter().chain(POLICIES.iter().map(|kind| kind.name())).collect(),
        splat_default: View::default().splat,
        view: &engine.view,
        tracks: tracks(engine),
    })
}

fn tracks<'a>(engine: &Engine<'a>) -> Vec<Track<'a>> {
    let (log, skeleton) = (engine.inputs.log.recording(), &engine.inputs.skeleton);
    let assets = skeleton.manifest.actors.iter().filter(|asset| asset.log == log.name);
    let points: BTreeMap<&str, usize> = assets.map(|asset| (asset.track.as_str(), asset.points)).collect();
    let mut tracks: Vec<Track<'_>> = log
        .tracks
        .iter()
        .map(|track| Track {
            track: &track.id,
            category: &track.category,
            first_us: i64::MAX,
            last_us: i64::MIN,
            boxes: 0,
            points: points.get(track.id.as_str()).copied().unwrap_or(0),
        })
        .collect();
    for frame in &log.frames {
        for item in &frame.boxes {
            if let Some(track) = tracks.get_mut(item.track) {
                track.first_us = track.first_us.min(frame.t_us);
                track.last_us = track.last_us.max(frame.t_us);
                track.boxes += 1;
            }
        }
    }
    tracks.retain(|track| track.boxes > 0);
    tracks
}
