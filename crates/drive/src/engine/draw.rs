//! Rendering of what the page shows, and the header that describes it.

use std::time::Instant;

use glam::DVec2;
use point_skeleton::conditions::birdseye::Trace;
use point_skeleton::conditions::{ConditionSet, MapKind};
use point_skeleton::error::with_causes;
use point_skeleton::raster::MapSet;
use point_skeleton::scene::{EgoOffset, SceneState};

use super::{Desk, Engine, Stage, command, live, look};
use crate::encode::{Drawn, image_png, map_png};
use crate::error::DriveError;
use crate::frame::{Actor, Event, Header, Offset, Times};
use crate::message::ServerMessage;
use crate::view::{Codec, GENERATED, KINDS};

/// Colors of the recorded and the driven path in the bird's-eye view.
const PATHS: [[u8; 4]; 2] = [[150, 160, 182, 150], [64, 196, 255, 230]];

impl Engine<'_> {
    /// Renders what is shown and passes it to the encoder.
    pub(super) fn draw(&mut self, desk: &mut Desk<'_, '_>) -> Result<(), DriveError> {
        self.is_stale = false;
        let state = match self.state() {
            Ok(state) => state,
            Err(text) => {
                self.hub.tell(None, ServerMessage::Notice { level: "error", text: &text }.json());
                return Ok(());
            }
        };
        let start = Instant::now();
        let mut kinds = self.view.kinds(&self.cameras);
        // Classes and actors are shown over the depth.
        let is_over_depth = kinds.contains(MapKind::Class) || kinds.contains(MapKind::Instance);
        if is_over_depth && self.view.codec == Codec::Jpeg {
            kinds = kinds | MapSet::of(&[MapKind::Depth]);
        }
        let options = self.view.options(kinds);
        let set = match kinds == MapSet::NONE {
            true => ConditionSet::default(),
            false => desk.renderer.render_with(&state, &options).map_err(DriveError::Render)?.set,
        };
        let draw_s = start.elapsed().as_secs_f64();
        self.frame += 1;
        let (ego_follows_log, actors_follow_log) = match &self.stage {
            Stage::Look(look) => (look.offset == EgoOffset::default(), !self.is_edited()),
            Stage::Live(live) => {
                let is_warm_up = live.takeover.is_none();
                let is_recorded = is_warm_up && !self.is_edited();
                (is_warm_up, is_recorded || self.actors_follow_log(live))
            }
        };
        let actors_follow_log = actors_follow_log && self.view.hide.is_empty();
        let header = self.header(&state, draw_s);
        let (traces, view) = (self.traces(), self.view.clone());
        let generated = match &self.stage {
            Stage::Live(_) => self.generation.latest(),
            Stage::Look(_) => None,
        };
        let drawn = Drawn {
            header,
            state,
            set,
            view,
            options,
            traces,
            ego_follows_log,
            actors_follow_log,
            generated,
        };
        desk.sender.send(drawn).map_err(|_| DriveError::Encoder)
    }

    /// Returns a map of the present state at the size of the recorded camera, as PNG.
    pub(super) fn picture(
        &self,
        camera: &str,
        map: &str,
        desk: &mut Desk<'_, '_>,
    ) -> Result<Vec<u8>, String> {
        if map == GENERATED {
            let at = self.cameras.iter().position(|name| *name == camera);
            let latest = self.generation.latest();
            let image = at.and_then(|at| latest.as_ref()?.images.images.get(at));
            return image_png(image.ok_or_else(|| format!("no image of camera {camera:?} is generated"))?);
        }
        let kind = KINDS.into_iter().find(|kind| kind.name() == map);
        let kind = kind.ok_or_else(|| format!("expected a map, found {map:?}"))?;
        let mut state = self.state()?;
        state.cameras.retain(|other| *other.view.camera.name == *camera);
        if state.cameras.is_empty() {
            return Err(format!("expected a camera of {}, found {camera:?}", self.cameras.join(", ")));
        }
        let options = self.view.full_size(MapSet::of(&[kind]));
        let maps = desk.renderer.render_with(&state, &options).map_err(|error| with_causes(&error))?;
        let maps = maps.set.cameras.first().ok_or("no camera was rendered")?;
        map_png(maps, kind, &options)?.ok_or_else(|| format!("the state has no map {map:?}"))
    }

    fn header(&mut self, state: &SceneState, draw_s: f64) -> Header {
        let log = self.inputs.log.recording();
        let first_us = log.frames.first().map_or(0, |frame| frame.t_us);
        let command = self.command();
        let generated = match &self.stage {
            Stage::Live(_) => self.generation.header(state.t_us, first_us),
            Stage::Look(_) => None,
        };
        let actors = match self.view.birdseye {
            Some(birdseye) => actors_around(state, birdseye.reach_m),
            None => Vec::new(),
        };
        let (mut events, mut offset): (Vec<Event>, _) = (Vec::new(), Offset::default());
        let (mode, ego, by, step, takeover, ended, keys_number) = match &mut self.stage {
            Stage::Look(look) => {
                let moved = look.offset;
                offset = Offset {
                    forward_m: moved.forward_m,
                    left_m: moved.left_m,
                    up_m: moved.up_m,
                    yaw_deg: moved.yaw_deg,
                    pitch_deg: moved.pitch_deg,
                };
                ("look", look::ego_of(state, &self.ego), live::LOG, None, None, None, 0)
            }
            Stage::Live(live) => {
                events = live.take_events();
                let step = Some(live.instant().step);
                ("simulate", live.ego(), live.by.name(), step, live.takeover, live.ended, live.keys_number)
            }
        };
        Header {
            frame: self.frame,
            mode,
            t_us: state.t_us,
            t_s: (state.t_us - first_us) as f64 / 1e6,
            step,
            takeover,
            by,
            playing: self.pace.is_playing(),
            speed: self.pace.speed(),
            ended,
            keys_number,
            ego,
            offset,
            events,
            psnr_db: Vec::new(),
            images: Vec::new(),
            actors,
            reach_m: self.view.birdseye.map(|birdseye| birdseye.reach_m),
            times_ms: Times { step: 1e3 * self.step_s, draw: 1e3 * draw_s, encode: 0.0 },
            generated,
            command,
        }
    }

    /// Returns the recorded and the driven path.
    fn traces(&self) -> Vec<Trace> {
        let recorded = self.ego.poses().iter().map(|(_, pose)| pose.translation.truncate()).collect();
        let mut lines: Vec<Vec<DVec2>> = vec![recorded];
        if let Stage::Live(live) = &self.stage {
            lines.push(live.driven().iter().map(pskel_sim::Waypoint::position_m).collect());
        }
        let trace = |(points, rgba): (Vec<DVec2>, [u8; 4])| Trace { points, rgba, width_px: 2.0 };
        lines.into_iter().zip(PATHS).map(trace).collect()
    }

    /// Returns the command that writes the maps on the page.
    fn command(&self) -> String {
        let mut kinds = self.view.kinds(&self.cameras);
        if kinds == MapSet::NONE {
            kinds = MapSet::of(&[MapKind::Color]); // recorded images alone
        }
        let (name, mut own) = match &self.stage {
            Stage::Look(look) => ("render", look.arguments()),
            Stage::Live(live) => {
                ("simulate", self.drive_arguments(live, &self.trajectory_path().display().to_string()))
            }
        };
        own.extend(self.view.arguments(kinds));
        if let Some(templates) = &self.options.templates {
            own.extend(["--templates".to_owned(), templates.display().to_string()]);
        }
        let skeleton = self.inputs.skeleton_path.display().to_string();
        let first = ["pskel", name, &self.inputs.log_name, "--skeleton", &skeleton].map(str::to_owned);
        let log = self.inputs.log_arguments.iter().cloned();
        let out = ["--out", if name == "render" { "out/maps" } else { "out/rollout" }].map(str::to_owned);
        command::line(first.into_iter().chain(log).chain(own).chain(out))
    }
}

/// Returns the actors within the bird's-eye view.
fn actors_around(state: &SceneState, reach_m: f64) -> Vec<Actor> {
    let center = state.global_from_ego.translation.truncate();
    let reach_m = reach_m * std::f64::consts::SQRT_2; // the corners
    let around = state.actors.iter().filter(|actor| {
        actor.cuboid.pose.translation.truncate().distance(center) <= reach_m + actor.cuboid.size.max_element()
    });
    let actor = |actor: &point_skeleton::scene::ActorState| Actor {
        track: actor.track.clone(),
        x: actor.cuboid.pose.translation.x,
        y: actor.cuboid.pose.translation.y,
        yaw_rad: actor.cuboid.pose.yaw_rad(),
        length: actor.cuboid.size.x,
        width: actor.cuboid.size.y,
    };
    around.map(actor).collect()
}
