use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
use std::time::Instant as Clock;

use anyhow::Context;
use glam::DVec2;
use point_skeleton::conditions::birdseye::Trace;
use point_skeleton::conditions::{ConditionError, ConditionSet, StepInFlight};
use point_skeleton::dataset::{EgoTrack, Log};
use point_skeleton::error::FileError;
use point_skeleton::files::FileName;
use point_skeleton::files::OutputFolder;
use point_skeleton::raster::Rasterizer;
use point_skeleton::scene::{SceneClouds, SceneMap, SceneState};
use pskel_sim::report::images::TRUTH;
use pskel_sim::report::{Phase, StateFile, StepObservations, StepRow, sight, view};
use pskel_sim::{EndReason, Metrics, Simulation, StepOutcome, Waypoint, scene_state};

use super::files::{CACHE, FORECAST, STATE, step_folder};
use super::finish::TRACES;
use super::generation::Generation;
use super::output::{Job, Output, RolloutOptions};
use super::profile::{Profile, StepTimes, WriteTimes, lap};
use crate::progress::Progress;

/// State shared by all steps.
pub(super) struct Rollout<'a> {
    pub(super) log: &'a Log,
    pub(super) map: Option<Arc<SceneMap>>,
    pub(super) stage: &'a SceneClouds<'a>,
    pub(super) options: &'a RolloutOptions,
    pub(super) output: &'a Output<'a>,
    /// Folder of the steps; `None` writes nothing.
    pub(super) files: Option<&'a OutputFolder>,
    /// `true` if a planner receives the files of each step after they are written.
    pub(super) shown_to_planner: bool,
}

/// Result of the loop.
pub(super) struct Run {
    /// Rows of all written steps.
    pub(super) rows: Vec<StepRow>,
    /// Metrics of the same steps.
    pub(super) metrics: Metrics,
    pub(super) notes: BTreeMap<String, usize>,
    pub(super) ended: Option<EndReason>,
    /// Reason for stopping early; all steps until then were written.
    pub(super) failure: Option<anyhow::Error>,
    pub(super) profile: Profile,
    pub(super) layout: view::Layout,
    /// Names and sizes (width, height) of the maps.
    pub(super) cameras: Vec<(FileName, [u32; 2])>,
}

/// State of the loop besides the simulation.
struct Loop {
    run: Run,
    /// Recorded path of the ego.
    recorded: Vec<DVec2>,
    /// The latest plan.
    plan: Vec<Waypoint>,
    times: StepTimes,
    progress: Progress,
}

/// Channels to the writer thread.
struct Writer {
    sender: SyncSender<Job>,
    /// Receives a message for each written step.
    written: Receiver<()>,
}

impl Rollout<'_> {
    /// Simulates and renders step by step, while another thread writes. `kept` has the steps of an earlier run, the
    /// last of which is the current state of the simulation. Without `states` nothing is written.
    ///
    /// Fails if a step cannot be written; other failures are in [`Run::failure`].
    pub(super) fn run(
        &self,
        simulation: Simulation<'_>,
        rasterizer: &mut dyn Rasterizer,
        generation: Option<&mut Generation<'_>>,
        kept: Vec<StepRow>,
        states: Option<StateFile>,
    ) -> anyhow::Result<Run> {
        let start = Clock::now();
        let (sender, receiver) = sync_channel::<Job>(1);
        let (tell, written) = channel();
        let writes = states.is_some();
        let (run, times) = std::thread::scope(|scope| {
            let writer = scope.spawn(move || -> Result<Vec<WriteTimes>, ConditionError> {
                let (Some(files), Some(mut states)) = (self.files, states) else { return Ok(Vec::new()) };
                let write = |job: Job| {
                    let times = self.output.write(&job, files, &mut states)?;
                    let _ = tell.send(()); // the receiver may be unused
                    Ok(times)
                };
                receiver.into_iter().map(write).collect()
            });
            let writer_way = writes.then_some(Writer { sender, written });
            let run = self.steps(simulation, rasterizer, generation, kept, writer_way);
            match writer.join() {
                Ok(times) => times.map(|times| (run, times)),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        })?;
        let mut run = run?;
        run.profile.written = times;
        run.profile.loop_s = start.elapsed().as_secs_f64();
        Ok(run)
    }

    fn steps(
        &self,
        mut simulation: Simulation<'_>,
        rasterizer: &mut dyn Rasterizer,
        mut generation: Option<&mut Generation<'_>>,
        kept: Vec<StepRow>,
        writer: Option<Writer>,
    ) -> anyhow::Result<Run> {
        let mut going = self.begin(&simulation, kept);
        // The last step of an earlier run exists, but its maps are needed for the layout of the page.
        let mut is_new = going.run.rows.is_empty();
        let mut outcome = None;
        loop {
            let maker = generation.as_deref_mut();
            let step = self.step(&simulation, rasterizer, maker, &mut going, outcome.take(), is_new);
            match step {
                Ok(Some(job)) => {
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
                match files(&step_folder(self.output.folder, &name)) {
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
        let track = EgoTrack::new(self.log);
        let left = self.options.simulation.steps.saturating_add(1).saturating_sub(kept.len());
        let plan = kept.iter().rev().find_map(|row| row.plan.clone()).unwrap_or_default();
        let run = Run {
            rows: kept,
            metrics: simulation.metrics(),
            notes: BTreeMap::new(),
            ended: None,
            failure: None,
            profile: Profile::default(),
            layout: view::Layout::default(),
            cameras: Vec::new(),
        };
        let recorded = track.poses().iter().map(|(_, pose)| pose.translation.truncate()).collect();
        Loop { run, recorded, plan, times: StepTimes::default(), progress: Progress::new(left) }
    }

    /// Renders the latest committed state. `None` for a step that was written by an earlier run.
    fn step(
        &self,
        simulation: &Simulation<'_>,
        rasterizer: &mut dyn Rasterizer,
        generation: Option<&mut Generation<'_>>,
        going: &mut Loop,
        outcome: Option<StepOutcome>,
        is_new: bool,
    ) -> anyhow::Result<Option<Job>> {
        let committed = simulation.committed();
        let instant = *committed.get();
        let state = scene_state(self.log, instant, self.map.clone());
        let set = self.draw(rasterizer, &state, &mut going.times)?;
        let mut clock = Clock::now();
        if going.run.cameras.is_empty() {
            going.run.layout = view::Layout::of(&set);
            let made = generation.as_ref().map(|generation| generation.pictures()).unwrap_or_default();
            // Generated images come first; ground truth follows the first map.
            for (name, place) in made.into_iter().zip([0, 2]) {
                let maps = &mut going.run.layout.maps;
                maps.insert(place.min(maps.len()), name.to_owned());
            }
            let camera =
                |c: &point_skeleton::conditions::CameraConditions| (c.name.clone(), [c.width, c.height]);
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
            seen: sight::seen(&set, instant.actors.len()),
        };
        let by_log = instant.step <= self.options.takeover_step;
        let phase = if by_log { Phase::WarmUp } else { Phase::Policy };
        let row = StepRow::new(self.log, instant, phase, &observed, plan);
        going.times.observe_s = lap(&mut clock);
        let forecast = self.forecast(simulation, rasterizer)?;
        going.times.forecast_s = lap(&mut clock);
        let generate = |generation: &mut Generation<'_>| generation.step(simulation, rasterizer);
        let images = generation.map(generate).transpose();
        let images = images.with_context(|| format!("step {}", state.name))?.flatten();
        going.times.generated = images.as_ref().and_then(|images| Some(images.fresh.as_ref()?.times));

        // Only now the step is certain to be complete.
        going.run.rows.push(row.clone());
        going.run.metrics = metrics;
        let traces = traces(going, instant.t_us);
        going.progress.step(&state.name);
        Ok(Some(Job { state, set, row, saved: simulation.save(), traces, forecast, images }))
    }

    /// Renders the forecasts, if requested and at planning steps only.
    fn forecast(
        &self,
        simulation: &Simulation<'_>,
        rasterizer: &mut dyn Rasterizer,
    ) -> anyhow::Result<Vec<(SceneState, ConditionSet)>> {
        let is_due = simulation.committed().get().step.is_multiple_of(simulation.steps_per_plan());
        let wanted = if is_due { self.options.forecast_steps } else { 0 };
        let expected = simulation.forecast(wanted).into_iter().map(|instant| {
            let state = scene_state(self.log, instant.get(), self.map.clone());
            let set = self.draw(rasterizer, &state, &mut StepTimes::default())?;
            Ok((state, set))
        });
        expected.collect()
    }

    fn draw(
        &self,
        rasterizer: &mut dyn Rasterizer,
        state: &SceneState,
        times: &mut StepTimes,
    ) -> anyhow::Result<ConditionSet> {
        let mut clock = Clock::now();
        let instances = self.stage.instances(state, &self.options.selection);
        times.instances_s = lap(&mut clock);
        let begun = StepInFlight::new(rasterizer, &instances, state, &self.options.conditions);
        let begun = begun.with_context(|| format!("step {}", state.name))?;
        times.begin_s = lap(&mut clock);
        let set = begun.finish(rasterizer).with_context(|| format!("step {}", state.name))?;
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

/// Returns the files of a step that a planner may read, sorted: its maps and metadata.
fn files(folder: &Path) -> Result<Vec<PathBuf>, FileError> {
    let folder = std::path::absolute(folder).map_err(FileError::io("read", folder))?;
    let entries = |folder: &Path| -> std::io::Result<Vec<PathBuf>> {
        std::fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect()
    };
    let mut files = Vec::new();
    for path in entries(&folder).map_err(FileError::io("read", &folder))? {
        // Planners must not see ground truth.
        if [view::VIEW, FORECAST, STATE, TRUTH, CACHE].iter().any(|name| path.ends_with(name)) {
            continue;
        }
        match path.is_dir() {
            true => files.extend(entries(&path).map_err(FileError::io("read", &path))?),
            false => files.push(path),
        }
    }
    files.sort();
    Ok(files)
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

#[cfg(test)]
mod tests {
    use glam::{DMat3, DVec3};

    use super::*;
    use crate::simulate::sources::Sources;
    use crate::stand_ins::StandInReport;
    use point_skeleton::conditions::meta::PromptParts;
    use point_skeleton::conditions::{ConditionOptions, MapFormat};
    use point_skeleton::dataset::{Frame, LogFormat, RigCamera};
    use point_skeleton::geometry::{Camera, Pose};
    use point_skeleton::raster::{
        self, FrameJob, FrameMaps, RasterError, RasterizerDesc, RasterizerInfo, RasterizerKind, SplatJob,
        SplatMaps, StageTimes,
    };
    use point_skeleton::scene::SelectionOptions;
    use point_skeleton::skeleton::{BuildOptions, BuildReport, Skeleton, SkeletonWriter};
    use pskel_sim::{Scenario, SimOptions};

    /// Renders some frames, then fails.
    struct Failing<'a> {
        drawn: Box<dyn Rasterizer + 'a>,
        left: usize,
    }

    impl Rasterizer for Failing<'_> {
        fn info(&self) -> RasterizerInfo {
            self.drawn.info()
        }

        fn begin(&mut self, job: &FrameJob<'_>) -> Result<(), RasterError> {
            self.left = self.left.checked_sub(1).ok_or(RasterError::TooManyPoints { found: 2, max: 1 })?;
            self.drawn.begin(job)
        }

        fn finish(&mut self) -> Result<FrameMaps<'_>, RasterError> {
            self.drawn.finish()
        }

        fn splat(&mut self, job: &SplatJob<'_>) -> Result<SplatMaps, RasterError> {
            self.drawn.splat(job)
        }

        fn stages(&mut self) -> &mut StageTimes {
            self.drawn.stages()
        }
    }

    /// Returns a log of one second at 10 frames per second with one camera.
    fn log() -> Log {
        let intrinsics = DMat3::from_cols(DVec3::X * 8.0, DVec3::Y * 8.0, DVec3::new(8.0, 4.0, 1.0));
        let camera =
            Camera { name: "c".parse().unwrap(), width: 16, height: 8, intrinsics, distortion: None };
        let frame = |i: i64| Frame {
            t_us: i * 100_000,
            global_from_ego: Pose::from_yaw(0.0, DVec3::X * i as f64),
            sweeps: Vec::new(),
            images: Vec::new(),
            between_images: Vec::new(),
            boxes: Vec::new(),
        };
        Log {
            name: "made".into(),
            cameras: vec!["c".parse().unwrap()],
            rig: vec![RigCamera { channel: 0, ego_from_camera: Pose::IDENTITY, camera }],
            frames: (0..=10).map(frame).collect(),
            ..Log::default()
        }
    }

    #[test]
    fn metrics_are_of_the_steps_that_were_drawn() {
        let (log, folder) = (log(), tempfile::tempdir().unwrap());
        let place = folder.path().join("sk");
        let nothing = |writer: &mut SkeletonWriter| {
            writer.finish(Vec::new(), BuildOptions::default(), BuildReport::default())
        };
        SkeletonWriter::write::<FileError>(&place, nothing).unwrap();
        let skeleton = Skeleton::open(&place).unwrap();
        let prompt = PromptParts::default();
        let simulation = SimOptions { steps: 9, ..SimOptions::default() };
        let options = RolloutOptions {
            conditions: ConditionOptions::default(),
            selection: SelectionOptions::default(),
            stand_ins: StandInReport::default(),
            format: MapFormat::Png,
            forecast_steps: 0,
            sheets: false,
            log: log.name.clone(),
            sources: Sources::new(&log, &skeleton, &prompt).unwrap(),
            simulation: simulation.clone(),
            sim_hz: 10.0,
            plan_hz: 5.0,
            takeover_step: 0,
            generator: None,
        };
        let output = Output { folder: folder.path(), options: &options, prompt: &prompt };
        let stage = SceneClouds::new(&skeleton, &log.name).unwrap();
        let desc = RasterizerDesc { kind: RasterizerKind::Cpu, device: None, memory_bytes: None };
        let drawn = raster::create(&desc, stage.cloud_set()).unwrap();
        let rollout = Rollout {
            log: &log,
            map: None,
            stage: &stage,
            options: &options,
            output: &output,
            files: None,
            shown_to_planner: false,
        };
        let scenario = Scenario::new(&log, None, LogFormat::Town);
        let simulation = Simulation::new(&scenario, simulation).unwrap();
        // The first step and three more.
        let run = rollout.run(simulation, &mut Failing { drawn, left: 4 }, None, Vec::new(), None).unwrap();
        let failure = crate::with_causes(&run.failure.unwrap());
        assert!(failure.contains("step 000004") && failure.contains("found 2"), "{failure}");
        assert_eq!((run.rows.len(), run.metrics.steps, run.ended), (4, 3, None));
        assert!((run.metrics.progress_m - 3.0).abs() < 1e-9, "{}", run.metrics.progress_m);
    }
}
