//! The engine: one thread that owns renderer and simulation, takes commands, and renders what the page shows.

mod command;
mod draw;
mod edit;
mod generate;
mod hello;
mod kept;
mod live;
mod look;
mod pace;
mod pick;
mod save;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel};
use std::time::{Duration, Instant};

use point_skeleton::dataset::EgoTrack;
use point_skeleton::error::with_causes;
use point_skeleton::scene::{SceneMap, SceneState};
use point_skeleton::{Log, RenderOptions, Renderer};
use pskel_sim::{Scenario, scene_state};

use self::generate::{Generation, Job};
use self::kept::Kept;
use self::live::{Beginning, By, Live};
use self::look::{At, Look};
use self::pace::{Pace, SPEEDS};
use crate::encode::{Drawn, Encoder};
use crate::error::DriveError;
use crate::generated::Mode;
use crate::hub::{ClientId, Hub, Input, Picture};
use crate::inputs::Inputs;
use crate::message::{Command, ServerMessage, to_json};
use crate::options::DriveOptions;
use crate::view::{Offered, View};

/// Rate at which the log plays when it is looked at, per second.
const LOOK_HZ: f64 = 20.0;
/// Maximum number of single steps at once.
const MAX_STEPS: u32 = 1000;
/// Time without a command after which the engine looks whether it is to stop.
const IDLE: Duration = Duration::from_millis(100);

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
    generation: Generation<'a>,
    pace: Pace,
    /// Single steps that wait for the generator.
    owed: u32,
    /// Number of the last frame.
    frame: u64,
    /// Whether the page shows another state or view.
    is_stale: bool,
    step_s: f64,
    /// Number of saved drives.
    saved: usize,
    /// The log with other edits, if it has just changed.
    edited: Option<Log>,
}

/// Why the engine stops serving a renderer.
enum Pause {
    /// Templates or assets have changed.
    Substitutes,
    /// Actors of the log have changed.
    Edited(Log),
    Stopped,
}

/// Runs until `stop` is set or all inputs are gone.
///
/// # Errors
/// Fails if no device supports the rasterizer, or if it fails.
pub(crate) fn run(
    mut inputs: Inputs,
    options: &DriveOptions,
    hub: &Hub,
    commands: &Receiver<Input>,
    stop: &AtomicBool,
) -> Result<(), DriveError> {
    let mut kept = None;
    while let Some((log, next)) = run_log(&inputs, options, hub, commands, stop, kept)? {
        inputs.log = log;
        kept = Some(next);
    }
    Ok(())
}

/// Runs until the log is edited, and returns it with what is kept then; `None` at the end.
fn run_log(
    inputs: &Inputs,
    options: &DriveOptions,
    hub: &Hub,
    commands: &Receiver<Input>,
    stop: &AtomicBool,
    kept: Option<Kept>,
) -> Result<Option<(Log, Kept)>, DriveError> {
    let (jobs, asked) = channel();
    let mut engine = Engine::new(inputs, options, hub, jobs)?;
    if let Some(kept) = kept {
        engine.restore(kept);
    }
    hub.set_hello(hello::hello(&engine));
    let encoder = Encoder::new(inputs.log.reader());
    std::thread::scope(|scope| {
        let (sender, drawn) = sync_channel(1);
        let encoder = &encoder;
        scope.spawn(move || drawn.into_iter().for_each(|drawn| encoder.publish(drawn, hub)));
        scope.spawn(move || generate::work(inputs, options, &asked, hub));
        let mut engine = engine; // ends before the scope, and with it the thread of the generator
        loop {
            let substitutes = engine.view.substitutes(options.templates.as_deref());
            let substitutes = substitutes.for_log(inputs.log.recording());
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
                Pause::Edited(log) => return Ok(Some((log, engine.keep()))),
                Pause::Stopped => return Ok(None),
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
    fn new(
        inputs: &'a Inputs,
        options: &'a DriveOptions,
        hub: &'a Hub,
        jobs: Sender<Job>,
    ) -> Result<Self, DriveError> {
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
            generation: Generation::new(inputs.generator.as_ref(), jobs),
            owed: 0,
            pace: Pace::new(LOOK_HZ, false, Instant::now()),
            frame: 0,
            is_stale: true,
            step_s: 0.0,
            saved: 0,
            edited: None,
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
                    Input::Generated(made) => self.is_stale |= self.generation.take(made),
                }
                next = commands.try_recv().ok();
            }
            if let Some(log) = self.edited.take() {
                return Ok(Pause::Edited(log));
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

    /// Returns the message with which a client begins.
    fn greet(&self) {
        self.hub.set_hello(hello::hello(self));
    }

    /// Applies a command.
    ///
    /// # Errors
    /// Returns one line for the client; nothing has changed.
    fn apply(&mut self, client: ClientId, command: Command, desk: &mut Desk<'_, '_>) -> Result<(), String> {
        let log = self.inputs.log.recording();
        let now = Instant::now();
        if !matches!(command, Command::View(_) | Command::Pick(_) | Command::Keys(_)) && self.owed > 0 {
            if let Command::Save { .. } | Command::Trajectory {} = command {
                return Err(format!("{} steps are still to be simulated: wait, or pause", self.owed));
            }
            self.owed = 0;
        }
        match command {
            Command::View(change) => {
                let offered = Offered { map: self.map.is_some(), generator: self.inputs.generator.is_some() };
                let view = self.view.changed(*change, &self.cameras, offered)?;
                if view.edits != self.view.edits {
                    let edits = self.inputs.scenario.clone().and(&view.edits);
                    let edited = self.inputs.log.edited(&edits);
                    self.edited = Some(edited.map_err(|error| error.to_string())?);
                }
                self.view = view;
                self.hub.tell(None, hello::view(&self.view));
                self.greet();
            }
            Command::Generate { mode } => {
                self.generate(mode, now)?;
                self.greet();
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
                let beginning = Beginning::of(&start, self.t_us(), self.inputs.log.recording())?;
                self.begin(beginning, now)?;
            }
            Command::Control { by } => {
                let (by, is_allowed) = (By::from_name(&by)?, self.allows_takeover());
                self.live()?.hand_over(by, is_allowed).map_err(|error| with_causes(&error))?;
                self.tell_who_waits();
            }
            Command::Keys(keys) => {
                if let Stage::Look(_) = self.stage {
                    if keys.is_idle() {
                        return Ok(());
                    }
                    let beginning =
                        Beginning::of(&Default::default(), self.t_us(), self.inputs.log.recording())?;
                    self.begin(beginning, now)?;
                    self.pace.play(true, now);
                }
                let is_allowed = self.allows_takeover();
                let live = self.live()?;
                let (by, has_ended, was_wanted) = (live.by, live.ended.is_some(), live.is_wanted());
                live.press(keys, is_allowed).map_err(|error| with_causes(&error))?;
                if live.by == by {
                    if !was_wanted {
                        self.tell_who_waits();
                    }
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
                self.owed = count.min(MAX_STEPS);
                self.work_off()?;
            }
            Command::Reset {} => {
                let beginning = self.live()?.beginning;
                self.begin(beginning, now)?;
            }
            Command::Pick(pixel) => {
                let (state, options) = (self.state()?, self.view.options(pick::maps()));
                let maps =
                    desk.renderer.render_with(&state, &options).map_err(|error| with_causes(&error))?;
                let skeleton = &self.inputs.skeleton;
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
        self.generation.restart(beginning.hz);
        self.ask();
        Ok(())
    }

    /// Begins to generate images, or ends it. A simulation in which the log still drives begins anew at its
    /// present state, since the generator begins with recorded images.
    fn generate(&mut self, mode: Mode, now: Instant) -> Result<(), String> {
        if mode != Mode::Off && self.inputs.generator.is_none() {
            return Err("there is no generator: start with --generator".to_owned());
        }
        let was_off = std::mem::replace(&mut self.generation.mode, mode) == Mode::Off;
        let Stage::Live(live) = &self.stage else { return Ok(()) };
        if mode == Mode::Off || !was_off {
            return Ok(());
        }
        if live.takeover.is_some() {
            self.generation.mode = Mode::Off;
            return Err("the generator begins with recorded images, and the log has given the wheel \
                away: reset the simulation first"
                .to_owned());
        }
        let (pace, beginning) = (self.pace, Beginning { start_us: live.instant().t_us, ..live.beginning });
        self.begin(beginning, now)?;
        self.pace = pace;
        Ok(())
    }

    /// Asks for the generated images of the present step, if they are due.
    fn ask(&mut self) {
        let (log, hide) = (self.inputs.log.recording(), &self.view.hide);
        let Stage::Live(live) = &self.stage else { return };
        let substitutes = || self.view.substitutes(self.options.templates.as_deref()).for_log(log);
        let shown = |instant: &pskel_sim::Instant| scene_state(log, instant, self.map.clone()).hiding(hide);
        let follow_log = self.actors_follow_log(live);
        self.generation.ask(live.simulation(), substitutes, shown, follow_log);
    }

    /// Returns whether the log may give the wheel away now.
    fn allows_takeover(&self) -> bool {
        match &self.stage {
            Stage::Live(live) => self.generation.allows_takeover(live.instant().step),
            Stage::Look(_) => true,
        }
    }

    /// Tells why somebody does not get the wheel yet.
    fn tell_who_waits(&self) {
        let missing = self.generation.missing_references();
        if matches!(&self.stage, Stage::Live(live) if live.is_wanted()) && missing > 0 {
            let images = if missing == 1 { "image" } else { "images" };
            let text = format!("the log drives until {missing} more reference {images} are there");
            self.hub.tell(None, ServerMessage::Notice { level: "info", text: &text }.json());
        }
    }

    fn live(&mut self) -> Result<&mut Live<'a>, String> {
        match &mut self.stage {
            Stage::Live(live) => Ok(live),
            Stage::Look(_) => Err("no simulation runs: begin one first".to_owned()),
        }
    }

    /// Moves on by the steps that are due.
    fn advance(&mut self) {
        let due = self.pace.due(Instant::now());
        let stepped = (0..due).try_for_each(|_| match self.generation.waits() {
            true => Ok(()),
            false => self.step_once(),
        });
        if let Err(text) = stepped.and_then(|()| self.work_off()) {
            self.owed = 0;
            self.pace.play(false, Instant::now());
            self.hub.tell(None, ServerMessage::Notice { level: "error", text: &text }.json());
        }
    }

    /// Takes the single steps that are owed, as far as the generator lets it.
    fn work_off(&mut self) -> Result<(), String> {
        while self.owed > 0 && !self.generation.waits() {
            self.owed -= 1;
            self.step_once()?;
        }
        Ok(())
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
                live.step(self.generation.horizon()).map_err(|error| with_causes(&error))?;
                let is_allowed = self.generation.allows_takeover(live.instant().step);
                live.settle(is_allowed).map_err(|error| with_causes(&error))?;
                if live.ended.is_some() && live.takeover.is_none() && !is_allowed {
                    live.ended =
                        Some("the log has ended before the generator could begin: reset, or turn it off");
                }
                live.ended.is_none()
            }
        };
        if goes_on {
            self.ask();
        }
        if !goes_on {
            self.owed = 0;
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
