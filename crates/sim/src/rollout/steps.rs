//! The loop: simulates and renders step by step, while another thread writes.

use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, SyncSender, channel};
use std::time::Instant as Clock;

use glam::DVec2;
use point_skeleton::conditions::birdseye::Trace;
use point_skeleton::conditions::{CameraConditions, ConditionError, ConditionSet};
use point_skeleton::dataset::EgoTrack;
use point_skeleton::files::OutputFolder;
use point_skeleton::pipeline::write_beside;
use point_skeleton::scene::SceneState;
use point_skeleton::{MapOptions, Maps, Renderer};

use super::error::RolloutError;
use super::files::{shown_files, step_folder};
use super::finish::TRACES;
use super::generation::Generation;
use super::output::{Job, Output};
use super::profile::{Profile, StepTimes, WriteTimes, lap};
use super::report::RolloutReport;
use crate::report::{Phase, StateFile, StepObservations, StepRow, sight, view};
use crate::{Instant, Scenario, Simulation, StepOutcome, Waypoint, scene_state};

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

/// State of the loop besides the simulation.
struct Loop {
    run: RolloutReport,
    /// Recorded path of the ego.
    recorded: Vec<DVec2>,
    /// The latest plan.
    plan: Vec<Waypoint>,
    times: StepTimes,
}

/// Channels to the writer thread.
struct Writer {
    sender: SyncSender<Job>,
    /// Receives a message for each written step.
    written: Receiver<()>,
}

impl Steps<'_> {
    /// Simulates and renders step by step, while another thread writes. `kept` has the steps of an earlier run, the
    /// last of which is the current state of the simulation. Without `states` nothing is written.
    ///
    /// Fails if a step cannot be written; other failures are in [`RolloutReport::failure`].
    pub(super) fn run(
        &self,
        simulation: Simulation<'_>,
        renderer: &mut Renderer<'_>,
        generation: Option<&mut Generation<'_>>,
        kept: Vec<StepRow>,
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
            self.steps(simulation, renderer, generation, kept, writer, on_step)
        };
        let (run, times) = write_beside("the thread that writes steps", write, simulate)?;
        let times = times?;
        let mut run = run?;
        run.profile.written = times;
        run.profile.loop_s = start.elapsed().as_secs_f64();
        Ok(run)
    }

    fn steps(
        &self,
        mut simulation: Simulation<'_>,
        renderer: &mut Renderer<'_>,
        mut generation: Option<&mut Generation<'_>>,
        kept: Vec<StepRow>,
        writer: Option<Writer>,
        on_step: &mut dyn FnMut(&str),
    ) -> Result<RolloutReport, RolloutError> {
        let mut going = self.begin(&simulation, kept);
        // The last step of an earlier run exists, but its maps are needed for the layout of the page.
        let mut is_new = going.run.rows.is_empty();
        let mut outcome = None;
        loop {
            let maker = generation.as_deref_mut();
            let step = self.step(&simulation, renderer, maker, &mut going, outcome.take(), is_new);
            match step {
                Ok(Some(job)) => {
                    on_step(&job.state.name);
                    if !hand_over(writer.as_ref(), job, &mut going, self.shown_to_planner) {
                        break;
                    }
                }
                Ok(None) => {}
                // Without a first step there is nothing to report.
                Err(error) if going.run.rows.is_empty() => return Err(error),
                Err(error) => {
                    going.run.failure = Some(error);
                    break;
                }
            }
            if self.shown_to_planner {
                let name = format!("{:06}", simulation.committed().get().step);
                match shown_files(&step_folder(self.output.folder, &name)) {
                    Ok(files) => simulation.show(files),
                    Err(error) => {
                        going.run.failure = Some(error.into());
                        break;
                    }
                }
            }
            if is_new {
                going.run.profile.steps.push(going.times);
            }
            going.times = StepTimes::default();
            is_new = true;
            let mut clock = Clock::now();
            match simulation.step() {
                Ok(Some(next)) => outcome = Some(next),
                Ok(None) => break,
                Err(error) => {
                    going.run.failure = Some(error.into());
                    break;
                }
            }
            going.times.policies_s = lap(&mut clock);
        }
        let Loop { mut run, .. } = going;
        (run.notes, run.ended) = (simulation.notes(), simulation.ended());
        Ok(run)
    }

    fn begin(&self, simulation: &Simulation<'_>, kept: Vec<StepRow>) -> Loop {
        let track = EgoTrack::new(self.scenario.log);
        let plan = kept.iter().rev().find_map(|row| row.plan.clone()).unwrap_or_default();
        let run = RolloutReport {
            rows: kept,
            metrics: simulation.metrics(),
            notes: BTreeMap::new(),
            ended: None,
            steps_beyond_log: 0,
            failure: None,
            summary_failure: None,
            profile: Profile::default(),
            facts: Vec::new(),
            layout: view::Layout::default(),
            cameras: Vec::new(),
        };
        let recorded = track.poses().iter().map(|(_, pose)| pose.translation.truncate()).collect();
        Loop { run, recorded, plan, times: StepTimes::default() }
    }

    /// Renders the latest committed state. `None` for a step that was written by an earlier run.
    fn step(
        &self,
        simulation: &Simulation<'_>,
        renderer: &mut Renderer<'_>,
        generation: Option<&mut Generation<'_>>,
        going: &mut Loop,
        outcome: Option<StepOutcome>,
        is_new: bool,
    ) -> Result<Option<Job>, RolloutError> {
        let committed = simulation.committed();
        let instant = *committed.get();
        let state = self.state(instant);
        let set = self.draw(renderer, &state, &mut going.times)?;
        let mut clock = Clock::now();
        if going.run.cameras.is_empty() {
            going.run.layout = view::Layout::of(&set);
            let generated = generation.as_ref().map(|generation| generation.maps()).unwrap_or_default();
            // Generated images come first; ground truth follows the first map.
            for (name, place) in generated.into_iter().zip([0, 2]) {
                let maps = &mut going.run.layout.maps;
                maps.insert(place.min(maps.len()), name.to_owned());
            }
            let camera = |c: &CameraConditions| (c.name.clone(), [c.width, c.height]);
            going.run.cameras = set.cameras.iter().map(camera).collect();
        }
        if !is_new {
            return Ok(None);
        }
        let plan = outcome.as_ref().and_then(|outcome| outcome.plan.as_ref());
        let plan = plan.map(|plan| plan.get().waypoints().to_vec());
        going.plan = plan.clone().unwrap_or(std::mem::take(&mut going.plan));
        let metrics = simulation.metrics();
        let observed = StepObservations {
            lateral: metrics.lateral_deviation_m,
            heading: metrics.heading_deviation_rad,
            driving_command: simulation.driving_command(),
            seen: sight::seen(&set, instant.actors.len()),
        };
        let by_log = instant.step <= self.output.record.takeover_step;
        let phase = if by_log { Phase::WarmUp } else { Phase::Policy };
        let row = StepRow::new(self.scenario.log, instant, phase, &observed, plan);
        going.times.observe_s = lap(&mut clock);
        let forecast = self.forecast(simulation, renderer)?;
        going.times.forecast_s = lap(&mut clock);
        let images = generation.map(|generation| generation.step(simulation, renderer, &state.name));
        let images = images.transpose()?.flatten();
        going.times.generated = images.as_ref().and_then(|images| Some(images.fresh.as_ref()?.times));

        // Only now the step is certain to be complete.
        going.run.rows.push(row.clone());
        going.run.metrics = metrics;
        let traces = traces(going, instant.t_us);
        Ok(Some(Job { state, set, row, saved: simulation.save(), traces, forecast, images }))
    }

    /// Renders the forecasts, if requested and at planning steps only.
    fn forecast(
        &self,
        simulation: &Simulation<'_>,
        renderer: &mut Renderer<'_>,
    ) -> Result<Vec<(SceneState, ConditionSet)>, RolloutError> {
        let is_due = simulation.committed().get().step.is_multiple_of(simulation.steps_per_plan());
        let wanted = if is_due { self.output.record.forecast_steps } else { 0 };
        let expected = simulation.forecast(wanted).into_iter().map(|instant| {
            let state = self.state(instant.get());
            let set = self.draw(renderer, &state, &mut StepTimes::default())?;
            Ok((state, set))
        });
        expected.collect()
    }

    fn state(&self, instant: &Instant) -> SceneState {
        scene_state(self.scenario.log, instant, self.scenario.map.clone())
    }

    fn draw(
        &self,
        renderer: &mut Renderer<'_>,
        state: &SceneState,
        times: &mut StepTimes,
    ) -> Result<ConditionSet, RolloutError> {
        let mut clock = Clock::now();
        renderer.begin_with(state, &self.maps).map_err(RolloutError::step(&state.name))?;
        times.begin_s = lap(&mut clock);
        let Maps { set, .. } = renderer.finish().map_err(RolloutError::step(&state.name))?;
        times.finish_s = lap(&mut clock);
        Ok(set)
    }
}

/// Sends a step to the writer thread; `false` if the thread has stopped, whose result has the error.
fn hand_over(writer: Option<&Writer>, job: Job, going: &mut Loop, wait: bool) -> bool {
    let Some(writer) = writer else { return true };
    let mut clock = Clock::now();
    let is_up = writer.sender.send(job).is_ok() && (!wait || writer.written.recv().is_ok());
    going.times.wait_s = lap(&mut clock);
    is_up
}

/// Returns the lines of the bird's-eye view, in the order of [`TRACES`].
fn traces(going: &Loop, now_us: i64) -> Vec<Trace> {
    let driven = going.run.rows.iter().map(StepRow::place_m).collect();
    let ahead = going.plan.iter().filter(|waypoint| waypoint.t_us >= now_us);
    let here = going.run.rows.last().map(StepRow::place_m);
    let plan = here.into_iter().chain(ahead.map(Waypoint::position_m)).collect();
    let lines = [going.recorded.clone(), driven, plan];
    let trace = |(points, (_, rgba)): (Vec<DVec2>, (&str, [u8; 4]))| Trace { points, rgba, width_px: 2.5 };
    lines.into_iter().zip(TRACES).map(trace).collect()
}
