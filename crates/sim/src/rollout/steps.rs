//! The loop: simulates and renders step by step, while another thread writes.

use std::sync::mpsc::{Receiver, SyncSender, channel};
use std::time::Instant as Clock;

use glam::DVec2;
use point_skeleton::conditions::birdseye::Trace;
use point_skeleton::conditions::{CameraConditions, ConditionError, ConditionSet};
use point_skeleton::dataset::EgoTrack;
use point_skeleton::files::OutputFolder;
use point_skeleton::lidar::{LidarSweep, Motion};
use point_skeleton::pipeline::{Pipeline, write_beside};
use point_skeleton::scene::{EgoOffset, SceneState, state_beside};
use point_skeleton::{Error, MapOptions, Maps, Renderer};

use super::error::RolloutError;
use super::finish::TRACES;
use super::generation::Generation;
use super::output::files::{shown_files, step_folder};
use super::output::{Job, Output};
use super::profile::{StepTimes, WriteTimes, lap};
use super::report::RolloutReport;
use crate::report::visibility::{self, VisibleActor};
use crate::report::{Phase, StateFile, StepObservations, StepRow, view};
use crate::{
    Instant, Metrics, SavedState, Scenario, SimActor, Simulation, StepOutcome, Waypoint, scene_state,
};

/// State shared by all steps.
pub(super) struct Steps<'a> {
    pub(super) scenario: &'a Scenario<'a>,
    pub(super) maps: MapOptions,
    pub(super) output: &'a Output<'a>,
    /// Folder of the steps; `None` writes nothing.
    pub(super) files: Option<&'a OutputFolder>,
    /// `true` if a planner receives the files of each step after they are written.
    pub(super) shown_to_planner: bool,
}

/// The loop: the simulation, the device, and what is known of the steps so far.
struct Loop<'l, 'a, 'r, 'g> {
    steps: &'l Steps<'l>,
    simulation: Simulation<'a>,
    renderer: &'l mut Renderer<'r>,
    generation: Option<&'l mut Generation<'g>>,
    writer: Option<Writer>,
    run: RolloutReport,
    /// Recorded path of the ego.
    recorded: Vec<DVec2>,
    /// The latest plan.
    plan: Vec<Waypoint>,
    /// State of the step before, if LiDAR sweeps are rendered: sweeps take the time since then.
    before: Option<SceneState>,
    /// Whether a step has begun.
    has_begun: bool,
    /// Error that ends the rollout after the steps in flight.
    failure: Option<RolloutError>,
}

/// A committed step whose maps are in flight. The simulation may be one step ahead.
struct PendingStep {
    /// Whether the step is new, rather than one of an earlier run whose maps are needed for the layout of the
    /// page.
    is_new: bool,
    state: SceneState,
    sweep: Option<LidarSweep>,
    instant: Instant,
    plan: Option<Vec<Waypoint>>,
    metrics: Metrics,
    driving_command: &'static str,
    saved: SavedState,
    times: StepTimes,
}

/// Channels to the writer thread.
struct Writer {
    sender: SyncSender<Job>,
    /// Receives a message for each written step.
    written: Receiver<()>,
}

impl Steps<'_> {
    /// Simulates and renders step by step, while another thread writes. `retained` has the steps of an
    /// earlier run; the last one is the current state of the simulation. Without `states` nothing is written.
    ///
    /// Fails if a step cannot be written; other failures are in [`RolloutReport::failure`].
    pub(super) fn run(
        &self,
        simulation: Simulation<'_>,
        renderer: &mut Renderer<'_>,
        generation: Option<&mut Generation<'_>>,
        retained: Vec<StepRow>,
        states: Option<StateFile>,
        on_step: &mut dyn FnMut(&str),
    ) -> Result<RolloutReport, RolloutError> {
        let start = Clock::now();
        let (report, written) = channel();
        let writes = states.is_some();
        let write = |jobs: Receiver<Job>| -> Result<Vec<WriteTimes>, ConditionError> {
            let (Some(files), Some(mut states)) = (self.files, states) else { return Ok(Vec::new()) };
            let write = |job: Job| {
                let times = self.output.write(&job, files, &mut states)?;
                let _ = report.send(()); // the receiver may be unused
                Ok(times)
            };
            jobs.into_iter().map(write).collect()
        };
        let simulate = |sender| {
            let writer = writes.then_some(Writer { sender, written });
            let track = EgoTrack::new(self.scenario.log);
            let recorded = track.poses().iter().map(|(_, pose)| pose.translation.truncate()).collect();
            let plan = retained.iter().rev().find_map(|row| row.plan.clone()).unwrap_or_default();
            let run = RolloutReport::new(retained, simulation.metrics());
            let all = Loop {
                steps: self,
                simulation,
                renderer,
                generation,
                writer,
                run,
                recorded,
                plan,
                before: None,
                has_begun: false,
                failure: None,
            };
            all.run(on_step)
        };
        let (run, times) = write_beside("the thread that writes steps", write, simulate)?;
        let times = times?;
        let mut run = run?;
        run.profile.written = times;
        run.profile.loop_s = start.elapsed().as_secs_f64();
        Ok(run)
    }

    fn state(&self, instant: &Instant) -> SceneState {
        let state = scene_state(self.scenario.log, instant, self.scenario.map.clone());
        state.hiding(&self.output.record.hide)
    }
}

impl Loop<'_, '_, '_, '_> {
    /// Simulates and renders all steps. If the images of a step are needed for the next one, each is finished
    /// before the next begins; otherwise the next step is simulated and begun meanwhile.
    fn run(mut self, on_step: &mut dyn FnMut(&str)) -> Result<RolloutReport, RolloutError> {
        let steps = self.steps;
        let alone =
            self.generation.is_some() || steps.shown_to_planner || steps.output.record.forecast_steps > 0;
        let mut pipeline = if alone { Pipeline::with_depth(1) } else { Pipeline::default() };
        loop {
            let step = pipeline.next(&mut self, Self::begin, Self::finish).and_then(|step| match step {
                Some((pending, (set, finish_s))) => self.complete(pending, set, finish_s, on_step),
                None => Ok(false),
            });
            match step {
                Ok(true) => {}
                Ok(false) => break,
                Err(error) => {
                    self.failure = Some(error);
                    break;
                }
            }
        }
        self.run.failure = match self.failure {
            // Without a first step there is nothing to report.
            Some(error) if self.run.rows.is_empty() => return Err(error),
            failure => failure,
        };
        (self.run.notes, self.run.ended) = (self.simulation.notes(), self.simulation.ended());
        Ok(self.run)
    }

    /// Begins the next step; `None` once the rollout is over. After an error, the steps in flight can be
    /// finished.
    fn begin(&mut self) -> Result<Option<PendingStep>, RolloutError> {
        if self.failure.is_some() {
            return Ok(None);
        }
        Ok(self.begin_next().unwrap_or_else(|error| {
            self.failure = Some(error);
            None
        }))
    }

    /// Commits the next step and begins its maps. The first step is the current state of the simulation.
    fn begin_next(&mut self) -> Result<Option<PendingStep>, RolloutError> {
        let mut clock = Clock::now();
        let is_first = !std::mem::replace(&mut self.has_begun, true);
        let plan = match is_first {
            true => None,
            false => match self.simulation.step()? {
                Some(StepOutcome { plan }) => plan,
                None => return Ok(None),
            },
        };
        let mut times = StepTimes { policies_s: lap(&mut clock), ..StepTimes::default() };
        let simulation = &self.simulation;
        let instant = (*simulation.committed().get()).clone();
        let state = self.steps.state(&instant);
        self.renderer.begin_with(&state, &self.steps.maps).map_err(RolloutError::step(&state.name))?;
        times.begin_s = lap(&mut clock);
        let is_new = !is_first || self.run.rows.is_empty();
        let sweep = self.sweep(&state, is_new).map_err(RolloutError::step(&state.name))?;
        times.lidar_s = lap(&mut clock);
        let simulation = &self.simulation;
        Ok(Some(PendingStep {
            is_new,
            state,
            sweep,
            instant,
            plan: plan.map(|plan| plan.get().waypoints().to_vec()),
            metrics: simulation.metrics(),
            driving_command: simulation.driving_command(),
            saved: simulation.save(),
            times,
        }))
    }

    /// Renders the LiDAR sweep of a new step, if the rollout has them. Ego and actors move from the step
    /// before; at step 0 they move as in the log.
    fn sweep(&mut self, state: &SceneState, is_new: bool) -> Result<Option<LidarSweep>, Error> {
        let Some(lidar) = &self.steps.output.record.lidar else { return Ok(None) };
        let log = self.steps.scenario.log;
        let recorded = || {
            let (track, seconds) = (EgoTrack::new(log), lidar.spec.duration_s());
            let beside = state_beside(log, &track, state.t_us, seconds, EgoOffset::default());
            beside.map(|beside| beside.hiding(&self.steps.output.record.hide))
        };
        let before = self.before.replace(state.clone()).or_else(recorded);
        if !is_new {
            return Ok(None);
        }
        self.renderer.lidar(&lidar.spec, &Motion::new(state, before.as_ref())).map(Some)
    }

    /// Waits for the maps of a step. Returns the time that this took, seconds.
    fn finish(&mut self, pending: &PendingStep) -> Result<(ConditionSet, f64), RolloutError> {
        let mut clock = Clock::now();
        let Maps { set, .. } = self.renderer.finish().map_err(RolloutError::step(&pending.state.name))?;
        Ok((set, lap(&mut clock)))
    }

    /// Completes a step with its maps and passes it to the writer thread; `false` if the thread has stopped,
    /// whose result has the error.
    fn complete(
        &mut self,
        pending: PendingStep,
        set: ConditionSet,
        finish_s: f64,
        on_step: &mut dyn FnMut(&str),
    ) -> Result<bool, RolloutError> {
        let PendingStep { is_new, state, sweep, instant, plan, metrics, driving_command, saved, mut times } =
            pending;
        times.finish_s = finish_s;
        let mut clock = Clock::now();
        if self.run.cameras.is_empty() {
            self.lay_out(&set);
        }
        if is_new {
            self.plan = plan.clone().unwrap_or(std::mem::take(&mut self.plan));
            let observed = StepObservations {
                lateral: metrics.lateral_deviation_m,
                heading: metrics.heading_deviation_rad,
                driving_command,
                seen: self.seen(&set, &state, &instant),
            };
            let by_log = instant.step <= self.steps.output.record.takeover_step;
            let phase = if by_log { Phase::WarmUp } else { Phase::Policy };
            let row = StepRow::new(self.steps.scenario.log, &instant, phase, &observed, plan);
            times.observe_s = lap(&mut clock);
            let forecast = self.forecast()?;
            times.forecast_s = lap(&mut clock);
            let name = state.name.clone();
            let images = match &mut self.generation {
                Some(generation) => {
                    generation.step(&self.simulation, self.steps.scenario, self.renderer, &name)?
                }
                None => None,
            };
            times.generated = images.as_ref().and_then(|images| Some(images.fresh.as_ref()?.times));

            // Only now the step is certain to be complete.
            self.run.rows.push(row.clone());
            self.run.metrics = metrics;
            let traces = self.traces(instant.t_us);
            on_step(&name);
            let (job, clock) =
                (Job { state, set, sweep, row, saved, traces, forecast, images }, &mut Clock::now());
            let is_up = self.send_to_writer(job);
            times.wait_s = lap(clock);
            if !is_up {
                return Ok(false);
            }
            self.run.profile.steps.push(times);
        }
        if self.steps.shown_to_planner {
            let folder = step_folder(self.steps.output.folder, &format!("{:06}", instant.step));
            self.simulation.show(shown_files(&folder)?);
        }
        Ok(true)
    }

    /// Returns the cameras that show each actor of an instant; hidden actors have none.
    fn seen(
        &self,
        set: &ConditionSet,
        state: &SceneState,
        instant: &Instant,
    ) -> Option<Vec<Vec<VisibleActor>>> {
        let hidden = &self.steps.output.record.hide;
        let mut drawn = visibility::visible_actors(set, state.actors.len())?.into_iter();
        let tracks = &self.steps.scenario.log.tracks;
        let of = |actor: &SimActor| match hidden.contains(&tracks[actor.track].id) {
            true => Vec::new(),
            false => drawn.next().unwrap_or_default(),
        };
        Some(instant.actors.iter().map(of).collect())
    }

    /// Places the cameras in the page's images.
    fn lay_out(&mut self, set: &ConditionSet) {
        self.run.layout = view::Layout::of(set);
        let generated = self.generation.as_ref().map(|generation| generation.maps()).unwrap_or_default();
        // Generated images come first; ground truth follows the first map.
        for (name, place) in generated.into_iter().zip([0, 2]) {
            let maps = &mut self.run.layout.maps;
            maps.insert(place.min(maps.len()), name.to_owned());
        }
        let camera = |c: &CameraConditions| (c.name.clone(), [c.width, c.height]);
        self.run.cameras = set.cameras.iter().map(camera).collect();
    }

    /// Renders the forecasts, if requested and at planning steps only.
    fn forecast(&mut self) -> Result<Vec<(SceneState, ConditionSet)>, RolloutError> {
        let simulation = &self.simulation;
        let is_due = simulation.committed().get().step.is_multiple_of(simulation.steps_per_plan());
        let wanted = if is_due { self.steps.output.record.forecast_steps } else { 0 };
        let expected = simulation.forecast(wanted).into_iter().map(|instant| {
            let state = self.steps.state(instant.get());
            let maps = self.renderer.render_with(&state, &self.steps.maps);
            let set = maps.map_err(RolloutError::step(&state.name))?.set;
            Ok((state, set))
        });
        expected.collect()
    }

    /// Sends a step to the writer thread, and waits until it is written if a planner receives its files.
    fn send_to_writer(&self, job: Job) -> bool {
        let Some(writer) = &self.writer else { return true };
        writer.sender.send(job).is_ok() && (!self.steps.shown_to_planner || writer.written.recv().is_ok())
    }

    /// Returns the lines of the bird's-eye view, in the order of [`TRACES`].
    fn traces(&self, now_us: i64) -> Vec<Trace> {
        let driven = self.run.rows.iter().map(StepRow::place_m).collect();
        let ahead = self.plan.iter().filter(|waypoint| waypoint.t_us >= now_us);
        let here = self.run.rows.last().map(StepRow::place_m);
        let plan = here.into_iter().chain(ahead.map(Waypoint::position_m)).collect();
        let lines = [self.recorded.clone(), driven, plan];
        let trace =
            |(points, (_, rgba)): (Vec<DVec2>, (&str, [u8; 4]))| Trace { points, rgba, width_px: 2.5 };
        lines.into_iter().zip(TRACES).map(trace).collect()
    }
}
