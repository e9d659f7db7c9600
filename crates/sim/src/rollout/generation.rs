//! The generator in the rollout: generated images, their files in a step, and resuming.

use std::collections::BTreeSet;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use point_skeleton::Renderer;
use point_skeleton::error::FileError;
use point_skeleton::files::input::{is_there, read_table};
use point_skeleton::files::write_whole;
use point_skeleton::scene::SceneState;

use super::error::RolloutError;
use super::generator::{GenerationTimes, ImageGenerator};
use super::output::files::{GENERATOR_STATE, STATE, step_folder};
use crate::report::images::{self, GENERATED, StepImages, TRUTH};
use crate::report::{StepRow, view};
use crate::{Instant, SavedState, Scenario, SimOptions, Simulation, scene_state};

/// The generator and its latest images.
pub(super) struct Generation<'a> {
    generator: &'a mut dyn ImageGenerator,
    /// Tracks of actors that are not shown.
    hide: BTreeSet<String>,
    latest: Option<Arc<StepImages>>,
}

/// Images of a step.
pub(super) struct Images {
    /// Images of this planning step or of the previous one.
    pub(super) latest: Arc<StepImages>,
    /// `Some` if they were generated at this step.
    pub(super) fresh: Option<NewImages>,
}

/// New data of a planning step.
pub(super) struct NewImages {
    /// Bytes of [`GENERATOR_STATE`], once frames are generated.
    pub(super) state: Option<Vec<u8>>,
    pub(super) times: GenerationTimes,
}

/// Steps of an earlier run.
pub(super) struct EarlierSteps<'a> {
    pub(super) folder: &'a Path,
    pub(super) rows: &'a [StepRow],
    pub(super) steps_per_plan: usize,
    pub(super) scenario: &'a Scenario<'a>,
    pub(super) options: &'a SimOptions,
}

impl<'a> Generation<'a> {
    /// Starts the generator.
    pub(super) fn new(generator: &'a mut dyn ImageGenerator, hide: BTreeSet<String>) -> Self {
        Self { generator, hide, latest: None }
    }

    /// Resumes the generator after the last step of an earlier run.
    pub(super) fn resume(
        generator: &'a mut dyn ImageGenerator,
        hide: BTreeSet<String>,
        earlier: &EarlierSteps<'_>,
        renderer: &mut Renderer<'_>,
    ) -> Result<Self, RolloutError> {
        let EarlierSteps { folder, rows, steps_per_plan, scenario, options } = earlier;
        let plan_rows: Vec<&StepRow> = rows.iter().step_by(*steps_per_plan).collect();
        let Some(last) = plan_rows.last() else { return Ok(Self::new(generator, hide)) };
        let first = plan_rows.len().saturating_sub(generator.window());
        let instant = |row: &&StepRow| {
            let path = step_folder(folder, &row.name()).join(STATE);
            let saved = SavedState::read(&path)?;
            let instant = saved.committed(scenario, options).map_err(RolloutError::file(&path))?;
            Ok::<_, RolloutError>(instant.map(|instant| shown(scenario, &hide, &instant)))
        };
        let states = plan_rows[first..].iter().map(instant).collect::<Result<Vec<_>, _>>()?;
        let last = step_folder(folder, &last.name());
        let path = last.join(GENERATOR_STATE);
        let state = is_there(&path)?.then(|| read_table(&path)).transpose()?;
        let resumed = generator.resume(plan_rows.len(), &states, state.as_deref(), renderer);
        resumed.map_err(RolloutError::file(&path))?;
        let cameras: Vec<_> = scenario.log.rig.iter().map(|rig| rig.camera.name.clone()).collect();
        let latest = images::read(&last, &cameras)?.map(Arc::new);
        Ok(Self { generator, hide, latest })
    }

    /// Generates the images of the latest committed state if a planning step is due, and returns the latest
    /// images.
    pub(super) fn step(
        &mut self,
        simulation: &Simulation<'_>,
        scenario: &Scenario<'_>,
        renderer: &mut Renderer<'_>,
        name: &str,
    ) -> Result<Option<Images>, RolloutError> {
        let at = || RolloutError::step(name);
        let (step, per_plan) = (simulation.committed().get().step, simulation.steps_per_plan());
        let generated = if step.is_multiple_of(per_plan) {
            let now = simulation.committed().map(|instant| shown(scenario, &self.hide, instant));
            let expected = simulation.forecast(self.generator.forecasts()).into_iter();
            let expected: Vec<_> =
                expected.map(|next| next.map(|next| shown(scenario, &self.hide, &next))).collect();
            self.generator.generate(step / per_plan, now.as_ref(), &expected, renderer).map_err(at())?
        } else {
            None
        };
        let is_fresh = generated.is_some();
        self.latest = generated.map(Arc::new).or(self.latest.take());
        let Some(latest) = self.latest.clone() else { return Ok(None) };
        let fresh = is_fresh.then(|| {
            let state = self.generator.save().map_err(at())?;
            Ok::<_, RolloutError>(NewImages { state, times: self.generator.times() })
        });
        Ok(Some(Images { latest, fresh: fresh.transpose()? }))
    }

    /// Returns the names of its images in the page.
    pub(super) fn maps(&self) -> Vec<&'static str> {
        [GENERATED].into_iter().chain(self.generator.has_truth().then_some(TRUTH)).collect()
    }
}

/// Returns the state of an instant without hidden actors.
fn shown(scenario: &Scenario<'_>, hide: &BTreeSet<String>, instant: &Instant) -> SceneState {
    scene_state(scenario.log, instant, scenario.map.clone()).hiding(hide)
}

impl Images {
    /// Writes the images of the page into the folder of a step, and new images and state.
    pub(super) fn write(&self, folder: &Path, layout: &view::Layout) -> Result<(), FileError> {
        let StepImages { images, truth, .. } = &*self.latest;
        let view = folder.join(view::VIEW);
        view::write_images(&view, GENERATED, layout, images)?;
        if let Some(truth) = truth {
            view::write_images(&view, TRUTH, layout, truth)?;
        }
        let Some(NewImages { state, .. }) = &self.fresh else { return Ok(()) };
        if let Some(state) = state {
            let path = folder.join(GENERATOR_STATE);
            write_whole(&path, |out| out.write_all(state).map_err(FileError::io("write", &path)))?;
        }
        let cameras: Vec<_> = layout.cameras.iter().map(|place| place.name.clone()).collect();
        images::write(folder, &cameras, &self.latest)
    }
}
