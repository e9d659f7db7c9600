//! The engine: one thread that owns renderer and simulation, takes commands, and renders what the page shows.

mod command;
mod draw;
mod hello;
mod live;
mod look;
mod pace;
mod pick;
mod save;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use point_skeleton::dataset::EgoTrack;
use point_skeleton::error::with_causes;
use point_skeleton::scene::{SceneMap, SceneState};
use point_skeleton::skeleton::Skeleton;
use point_skeleton::{Log, RenderOptions, Renderer};
use pskel_sim::{Rates, Scenario, scene_state};

use self::live::{Beginning, By, Live};
use self::look::{At, Look};
use self::pace::{Pace, SPEEDS};
use crate::encode::{Drawn, Encoder};
use crate::error::DriveError;
use crate::hub::{ClientId, Hub, Input, Picture};
use crate::message::{Command, ServerMessage, to_json};
use crate::options::DriveOptions;
use crate::view::View;

/// Rate at which the log plays when it is looked at, per second.
const LOOK_HZ: f64 = 20.0;
/// Maximum number of single steps at once.
const MAX_STEPS: u32 = 1000;
/// Time without a command after which the engine looks whether it is to stop.
const IDLE: Duration = Duration::from_millis(100);

/// What is shown and driven in.
pub struct Inputs {
    /// Log.
    pub log: Log,
    /// Name of the log as on the command line.
    pub log_name: String,
    /// Arguments of the command line with which the log was opened, such as `--sensor-root DIR`.
    pub log_arguments: Vec<String>,
    /// Skeleton that was built from the log.
    pub skeleton: Skeleton,
    /// Its folder.
    pub skeleton_path: PathBuf,
    /// Default rates of the log.
    pub rates: Rates,
}

/// What is shown.
enum Stage<'a> {
    Look(Look),
    Live(Box<Live<'a>>),
}

/// State of the engine between two frames.
pub(crate) struct Engine<'a> {
    inputs: &'a Inputs,
    options: &'a DriveOptions,
    hub: &'a Hub,
    map: Option<Arc<SceneMap>>,
    ego: EgoTrack,
    cameras: Vec<&'a str>,
    view: View,
    stage: Stage<'a>,
    pace: Pace,
    /// Number of the last frame.
    frame: u64,
    /// Whether the page shows another state or view.
    is_stale: bool,
    step_s: f64,
    /// Number of saved drives.
    saved: usize,
}

/// Why the engine stops serving a renderer.
enum Pause {
    /// Templates or assets have changed.
    Substitutes,
    Stopped,
}

/// Runs until `stop` is set or all inputs are gone.
///
/// # Errors
/// Fails if no device supports the rasterizer, or if it fails.
pub(crate) fn run(
    inputs: &Inputs,
    options: &DriveOptions,
    hub: &Hub,
    commands: &Receiver<Input>,
    stop: &AtomicBool,
) -> Result<(), DriveError> {
    let mut engine = Engine::new(inputs, options, hub)?;
    hub.set_hello(hello::hello(&engine));
    let encoder = Encoder::new(inputs.log.reader());
    std::thread::scope(|scope| {
        let (sender, drawn) = sync_channel(1);
        let encoder = &encoder;
        scope.spawn(move || drawn.into_iter().for_each(|drawn| encoder.publish(drawn, hub)));
        loop {
            let substitutes = engine.view.substitutes(options.templates.as_deref());
            let (substitutes, report) = substitutes.make(&inputs.skeleton, inputs.log.name())?;
            let render = RenderOptions {
                rasterizer: options.rasterizer.clone(),
                substitutes: &substitutes,
                log: Some(inputs.log.name()),
                ..RenderOptions::default()
            };
            let mut renderer = Renderer::new(&inputs.skeleton, render).map_err(DriveError::Render)?;
            engine.is_stale = true;
            let mut desk = Desk { renderer: &mut renderer, report: &report, sender: &sender };
            match engine.serve(&mut desk, commands, stop)? {
                Pause::Substitutes => {}
                Pause::Stopped => return Ok(()),
            }
        }
    })
}

/// What the engine works with until the substitutes change.
struct Desk<'d, 'r> {
    renderer: &'d mut Renderer<'r>,
    report: &'d point_skeleton::scene::SubstituteReport,
    sender: &'d SyncSender<Drawn>,
}

impl<'a> Engine<'a> {
    fn new(inputs: &'a Inputs, options: &'a DriveOptions, hub: &'a Hub) -> Result<Self, DriveError> {
        let log = inputs.log.recording();
        if log.frames.is_empty() || log.cameras.is_empty() {
            return Err(DriveError::Nothing { log: log.shown_name().into_owned() });
        }
        Ok(Self {
            inputs,
            options,
            hub,
            map: inputs.log.map(),
            ego: EgoTrack::new(log),
            cameras: log.cameras.iter().map(|name| name.as_str()).collect(),
            view: View::default(),
            stage: Stage::Look(Look::default()),
            pace: Pace::new(LOOK_HZ, false, Instant::now()),
            frame: 0,
            is_stale: true,
            step_s: 0.0,
            saved: 0,
        })
    }

    fn serve(
        &mut self,
        desk: &mut Desk<'_, '_>,
        commands: &Receiver<Input>,
        stop: &AtomicBool,
    ) -> Result<Pause, DriveError> {
        loop {
            if stop.load(Ordering::Relaxed) {
                return Ok(Pause::Stopped);
            }
            let wait = self.pace.wait(Instant::now()).unwrap_or(IDLE).min(IDLE);
            let mut next = match commands.recv_timeout(wait) {
                Ok(input) => Some(input),
                Err(RecvTimeoutError::Timeout) => None,
                Err(RecvTimeoutError::Disconnected) => return Ok(Pause::Stopped),
            };
            let before = (self.view.default_templates, self.view.augment.clone());
            while let Some(input) = next {
                match input {
                    Input::Command(client, command) => {
                        if let Err(text) = self.apply(client, command, desk) {
                            let notice = ServerMessage::Notice { level: "error", text: &text };
                            self.hub.tell(Some(client), notice.json());
                        }
                    }
                    Input::Picture(Picture { camera, map, reply }) => {
                        let _ = reply.send(self.picture(&camera, &map, desk)); // the client may have left
                    }
                    Input::Room => {}
                }
                next = commands.try_recv().ok();
            }
            self.advance();
            if before != (self.view.default_templates, self.view.augment.clone()) {
                return Ok(Pause::Substitutes);
            }
            if self.is_stale && self.hub.has_room() {
                self.draw(desk)?;
            }
        }
    }

    fn scenario(&self) -> Scenario<'a> {
        Scenario { log: self.inputs.log.recording(), map: self.map.clone(), rates: self.inputs.rates }
    }

    /// Applies a command.
    ///
    /// # Errors
    /// Returns one line for the client; nothing has changed.
    fn apply(&mut self, client: ClientId, command: Command, desk: &mut Desk<'_, '_>) -> Result<(), String> {
        let log = self.inputs.log.recording();
        let now = Instant::now();
        match command {
            Command::View(change) => {
                self.view = self.view.changed(*change, &self.cameras, self.map.is_some())?;
                self.hub.tell(None, hello::view(&self.view));
            }
            Command::Look(change) => {
                let look = match &self.stage {
                    Stage::Look(look) => *look,
                    Stage::Live(live) => Look { at: At::time(live.instant().t_us, log), ..Look::default() },
                };
                let look = look.changed(&change, log)?;
                if matches!(self.stage, Stage::Live(_)) || (change.t_us.is_some() || change.frame.is_some()) {
                    self.pace = Pace::new(LOOK_HZ, false, now);
                }
                self.stage = Stage::Look(look);
            }
            Command::Simulate(start) => {
                let beginning = Beginning::of(&start, self.t_us())?;
                self.begin(beginning, now)?;
            }
            Command::Control { by } => {
                let by = By::from_name(&by)?;
                self.live()?.hand_over(by).map_err(|error| with_causes(&error))?;
            }
            Command::Keys(keys) => {
                if let Stage::Look(_) = self.stage {
                    if keys.is_idle() {
                        return Ok(());
                    }
                    let beginning = Beginning::of(&Default::default(), self.t_us())?;
                    self.begin(beginning, now)?;
                    self.pace.play(true, now);
                }
                let live = self.live()?;
                let (by, has_ended) = (live.by, live.ended.is_some());
                live.press(keys).map_err(|error| with_causes(&error))?;
                if live.by == by {
                    return Ok(()); // the next step shows it
                }
                if has_ended {
                    self.pace.play(true, now); // it was the end of the log that paused
                }
            }
            Command::Play { playing, speed } => {
                if let Some(speed) = speed {
                    if !SPEEDS.contains(&speed) {
                        let (low, high) = (SPEEDS.start(), SPEEDS.end());
                        return Err(format!("expected a speed of {low} to {high}, found {speed}"));
                    }
                    self.pace.set_speed(speed);
                }
                if let Some(playing) = playing {
                    self.pace.play(playing, now);
                }
            }
            Command::Step { count } => {
                self.pace.play(false, now);
                for _ in 0..count.min(MAX_STEPS) {
                    self.step_once()?;
                }
            }
            Command::Reset {} => {
                let beginning = self.live()?.beginning;
                self.begin(beginning, now)?;
            }
            Command::Pick(pixel) => {
                let (state, options) = (self.state()?, self.view.options(pick::maps()));
                let maps =
                    desk.renderer.render_with(&state, &options).map_err(|error| with_causes(&error))?;
                let (skeleton, log) = (&self.inputs.skeleton, self.inputs.log.name());
                let picked = pick::picked(&pixel, &state, &maps.set, &options, skeleton, log)?;
                self.hub.tell(Some(client), to_json(&picked));
                return Ok(());
            }
            Command::Save { name } => return self.save(client, name.as_deref(), desk),
            Command::Trajectory {} => {
                let path = self.trajectory_path();
                return self.write_trajectory(&path);
            }
        }
        self.is_stale = true;
        Ok(())
    }

    fn begin(&mut self, beginning: Beginning, now: Instant) -> Result<(), String> {
        let live = Live::new(&self.scenario(), beginning).map_err(|error| with_causes(&error))?;
        self.pace = Pace::new(beginning.hz, false, now);
        self.stage = Stage::Live(Box::new(live));
        Ok(())
    }

    fn live(&mut self) -> Result<&mut Live<'a>, String> {
        match &mut self.stage {
            Stage::Live(live) => Ok(live),
            Stage::Look(_) => Err("no simulation runs: begin one first".to_owned()),
        }
    }

    /// Moves on by the steps that are due.
    fn advance(&mut self) {
        for _ in 0..self.pace.due(Instant::now()) {
            if let Err(text) = self.step_once() {
                self.pace.play(false, Instant::now());
                self.hub.tell(None, ServerMessage::Notice { level: "error", text: &text }.json());
            }
        }
    }

    /// Moves on by one step; pauses where it does not go on.
    fn step_once(&mut self) -> Result<(), String> {
        let (start, log) = (Instant::now(), self.inputs.log.recording());
        let goes_on = match &mut self.stage {
            Stage::Look(look) => {
                let step_us = (1e6 * self.pace.speed() / LOOK_HZ).round() as i64;
                let before = look.t_us(log);
                look.at = At::time(before + step_us, log);
                look.t_us(log) > before
            }
            Stage::Live(live) => {
                live.step().map_err(|error| with_causes(&error))?;
                live.ended.is_none()
            }
        };
        if !goes_on {
            self.pace.play(false, Instant::now());
        }
        self.is_stale = true;
        self.step_s = start.elapsed().as_secs_f64();
        Ok(())
    }

    /// Returns the time that is shown, absolute microseconds.
    fn t_us(&self) -> i64 {
        match &self.stage {
            Stage::Look(look) => look.t_us(self.inputs.log.recording()),
            Stage::Live(live) => live.instant().t_us,
        }
    }

    /// Returns the state that is shown, without hidden actors.
    fn state(&self) -> Result<SceneState, String> {
        let log = self.inputs.log.recording();
        let state = match &self.stage {
            Stage::Look(look) => look
                .state(log, &self.ego, self.map.clone())
                .ok_or_else(|| format!("log {} has no ego pose at this time", log.shown_name()))?,
            Stage::Live(live) => scene_state(log, live.instant(), self.map.clone()),
        };
        Ok(if self.view.hide.is_empty() { state } else { state.hiding(&self.view.hide) })
    }
}
