//! Rollouts: a closed-loop simulation whose steps are rendered and written to a folder.
//!
//! # How it works
//! [`Rollout::open`] reads the steps of an earlier run, if the rollout is resumed, and starts the
//! [`Simulation`]. [`Rollout::run`] simulates and renders step by step (`steps`), calls an [`ImageGenerator`]
//! at planning steps (`generation`), and writes each step on another thread (`output`). At the end it writes
//! the summary files from the folders of all steps (`finish`, `mcap`), so that a resumed rollout gives the
//! same bytes as an uninterrupted one. `sources` identifies the inputs and `profile` records durations.

mod earlier;
mod error;
#[cfg(feature = "mcap")]
mod events;
mod finish;
mod generation;
mod generator;
mod options;
mod output;
mod profile;
mod report;
mod sources;
mod steps;
#[cfg(test)]
mod tests;

pub use error::{AnyError, RolloutError};
pub use finish::{check_finished, is_finished};
pub use generator::{GenerationTimes, ImageGenerator};
pub use options::{InputPaths, ResumeAfter, RolloutInputs, RolloutOptions, rollout_extra};
pub use output::files::METRICS;
#[cfg(feature = "mcap")]
pub use output::mcap::MCAP;
pub use profile::{Profile, lap};
pub use report::RolloutReport;

use std::path::Path;
use std::time::Instant;

use glam::DAffine3;
use point_skeleton::conditions::{ConditionError, check_memory};
use point_skeleton::dataset::Recording;
use point_skeleton::error::FileError;
#[cfg(feature = "mcap")]
use point_skeleton::files::OutputFile;
use point_skeleton::files::{Inputs, OutputFolder};
use point_skeleton::geometry::View;
use point_skeleton::{MapOptions, Renderer};

use self::earlier::{Earlier, EarlierRollout};
use self::generation::{EarlierSteps, Generation};
use self::options::RolloutRecord;
use self::output::Output;
use self::sources::Sources;
use self::steps::Steps;
use crate::report::StepRow;
use crate::{EgoPolicy, Simulation};

/// Kind of the output folder.
const KIND: &str = "rollout";

/// A rollout that is ready to run.
pub struct Rollout<'a> {
    inputs: RolloutInputs<'a>,
    facts: Vec<String>,
    record: RolloutRecord,
    simulation: Simulation<'a>,
    /// Steps of an earlier run.
    rows: Vec<StepRow>,
    /// Output folder and its lock; `None` writes nothing.
    out: Option<(&'a Path, OutputFolder)>,
    /// MCAP file to write.
    #[cfg(feature = "mcap")]
    mcap: Option<OutputFile>,
}

impl<'a> Rollout<'a> {
    /// Starts the simulation, or resumes it from the steps of an earlier rollout in the folder `out`, which
    /// is given with everything that the command reads. Without a folder nothing is written. Files of an
    /// earlier rollout are replaced by [`Rollout::run`], not before.
    ///
    /// # Errors
    /// Fails if the options do not fit the log, if `out` is neither empty nor a rollout or lies within an
    /// input, if the earlier rollout is damaged or of other inputs, or if a planner does not answer.
    pub fn open(
        inputs: RolloutInputs<'a>,
        options: RolloutOptions,
        out: Option<(&'a Path, &Inputs)>,
        resume: Option<ResumeAfter>,
    ) -> Result<Self, RolloutError> {
        let RolloutInputs { scenario, skeleton, prompt, paths } = inputs;
        let sources = Sources::new(scenario, skeleton, prompt)?;
        let open = |(folder, read): (&'a Path, &Inputs)| {
            let files = OutputFolder::open(folder, KIND, read)?;
            // A resumed rollout is read from these.
            files.check([output::files::ROLLOUT, output::files::STATES, output::files::STEPS])?;
            Ok::<_, FileError>((folder, files))
        };
        let out = out.map(open).transpose()?;
        let steps = options.simulation.steps;
        let read = |((folder, _), after): (&(&'a Path, OutputFolder), ResumeAfter)| {
            EarlierRollout { folder, steps, sources: &sources, paths }.read(after)
        };
        let earlier = out.as_ref().zip(resume).map(read).transpose()?.flatten();
        let has_planner = matches!(options.simulation.ego, EgoPolicy::External(_));
        let mut simulation = match &earlier {
            Some(Earlier { saved, .. }) => Simulation::resume(scenario, options.simulation.clone(), saved)?,
            None => Simulation::new(scenario, options.simulation.clone())?,
        };
        if let (Some(earlier), Some((folder, _)), true) = (&earlier, &out, has_planner) {
            simulation.restore_history(earlier.history(folder)?)?;
        }
        let rates = simulation.rates();
        let record = RolloutRecord {
            conditions: options.conditions,
            selection: options.selection,
            hide: options.hide,
            edits: scenario.log.edits.clone(),
            format: options.format,
            forecast_steps: options.forecast_steps,
            sheets: options.sheets,
            lidar: options.lidar,
            log: scenario.log.name.clone(),
            sources,
            simulation: options.simulation,
            sim_hz: rates.sim_hz,
            plan_hz: rates.plan_hz,
            takeover_step: simulation.takeover_step(),
            map_name: scenario.log.map_files.as_ref().map(|files| files.name.clone()),
            roadblocks: simulation.route().map(|route| route.roadblocks.clone()).unwrap_or_default(),
            extra: options.extra,
        };
        let rows = earlier.map(|earlier| earlier.rows).unwrap_or_default();
        Ok(Self {
            inputs,
            facts: options.facts,
            record,
            simulation,
            rows,
            out,
            #[cfg(feature = "mcap")]
            mcap: options.mcap,
        })
    }

    /// Returns the number of steps that an earlier run has written.
    pub fn steps_done(&self) -> usize {
        self.rows.len()
    }

    /// Returns the step from which on the policies decide.
    pub fn takeover_step(&self) -> usize {
        self.record.takeover_step
    }

    /// Returns the maximum number of steps to simulate and write, with step 0.
    pub fn steps_left(&self) -> usize {
        self.record.simulation.steps.saturating_add(1).saturating_sub(self.rows.len())
    }

    /// Simulates, renders and writes all steps, then the summary files. `on_step` is called with the name of
    /// each step after it was rendered. `renderer` is of the rollout's skeleton; its own map options are not
    /// used.
    ///
    /// If a step fails, the summary files describe the steps before it, and [`RolloutReport::failure`] has
    /// its error.
    ///
    /// # Errors
    /// Fails if the first step fails, if a step cannot be written, or if the generator cannot be resumed.
    pub fn run(
        self,
        renderer: &mut Renderer<'_>,
        generator: Option<&mut dyn ImageGenerator>,
        on_step: &mut dyn FnMut(&str),
    ) -> Result<RolloutReport, RolloutError> {
        #[cfg(feature = "mcap")]
        let mcap = self.mcap;
        let Self { inputs, facts, record, simulation, rows, out, .. } = self;
        // Before files of an earlier rollout are replaced.
        let views = recorded_views(inputs.scenario.log);
        let fits = check_memory(&views, &record.conditions, inputs.scenario.map.is_some());
        fits.map_err(ConditionError::from)?;
        let folder = out.as_ref().map_or(Path::new(""), |(folder, _)| folder);
        let output = Output { folder, record: &record, prompt: inputs.prompt };
        let states = out.as_ref().map(|(_, files)| output.begin(files, &rows)).transpose()?;
        let earlier = EarlierSteps {
            folder,
            rows: &rows,
            steps_per_plan: simulation.steps_per_plan(),
            scenario: inputs.scenario,
            options: &record.simulation,
        };
        let begin = |generator| match rows.is_empty() {
            true => Ok(Generation::new(generator, record.hide.clone())),
            false => Generation::resume(generator, record.hide.clone(), &earlier, renderer),
        };
        let mut generation = generator.map(begin).transpose()?;
        let steps = Steps {
            scenario: inputs.scenario,
            maps: MapOptions::new(record.conditions.clone(), record.selection),
            output: &output,
            files: out.as_ref().map(|(_, files)| files),
            shown_to_planner: matches!(record.simulation.ego, EgoPolicy::External(_)) && out.is_some(),
        };
        let mut report = steps.run(simulation, renderer, generation.as_mut(), rows, states, on_step)?;
        report.close(facts, &record, inputs.scenario);
        let clock = Instant::now();
        let finish = || -> Result<(), RolloutError> {
            if let Some((_, files)) = &out {
                finish::finish(&output, files, &report)?;
            }
            #[cfg(feature = "mcap")]
            if let Some(file) = &mcap {
                let folder = out.as_ref().map(|(folder, _)| *folder);
                let input = output::mcap::Input {
                    scenario: inputs.scenario,
                    record: &record,
                    report: &report,
                    folder,
                };
                input.write(file)?;
            }
            Ok(())
        };
        let finished = finish().and_then(|()| out.map_or(Ok(()), |(_, files)| Ok(files.close()?)));
        report.summary_failure = finished.err();
        let rasterizer = renderer.rasterizer();
        report.profile.close(clock.elapsed(), rasterizer.info(), &rasterizer.take_stages());
        Ok(report)
    }
}

/// Returns views with the sizes of the log's cameras.
fn recorded_views(log: &Recording) -> Vec<View> {
    let cameras = log.rig.iter().map(|rig| rig.camera.clone());
    cameras.map(|camera| View { camera, camera_from_world: DAffine3::IDENTITY }).collect()
}
