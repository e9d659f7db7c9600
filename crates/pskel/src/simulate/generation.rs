//! The generator in the rollout: generated images, their files in a step, and resuming.

use std::path::Path;
use std::sync::Arc;

use anyhow::Context;
use point_skeleton::error::FileError;
use point_skeleton::files::input::{is_there, read_table};
use point_skeleton::files::write_whole;
use point_skeleton::raster::Rasterizer;
use pskel_generate::{Cache, Session, SessionTimes};
use pskel_sim::report::images::StepImages;
use pskel_sim::report::images::{self, GENERATED, TRUTH};
use pskel_sim::report::{StepRow, view};
use pskel_sim::{SavedState, Scenario, SimOptions, Simulation};

use super::files::{CACHE, STATE, step_folder};
use crate::generator::{GenerationScene, OpenedNetwork};

/// The generator and its latest images.
pub(super) struct Generation<'a> {
    session: Session<'a>,
    shown: Option<Arc<StepImages>>,
}

/// Images of a step.
pub(super) struct Images {
    /// Images of this planning step or of the previous one.
    pub(super) shown: Arc<StepImages>,
    /// `Some` if they were generated at this step.
    pub(super) fresh: Option<NewImages>,
}

/// New data of a planning step.
pub(super) struct NewImages {
    /// Bytes of [`CACHE`], once frames are generated.
    pub(super) cache: Option<Vec<u8>>,
    pub(super) times: SessionTimes,
}

impl<'a> Generation<'a> {
    /// Creates the generator, or resumes it after the last step of an earlier run.
    pub(super) fn begin(
        opened: OpenedNetwork,
        subject: &GenerationScene<'a>,
        rasterizer: &mut dyn Rasterizer,
        earlier: &EarlierSteps<'_>,
    ) -> anyhow::Result<Self> {
        let window = opened.window();
        let session = opened.session(subject)?;
        match earlier.rows {
            [] => Ok(Self { session, shown: None }),
            _ => Self::resume(session, window, rasterizer, earlier),
        }
    }

    fn resume(
        session: Session<'a>,
        window: usize,
        rasterizer: &mut dyn Rasterizer,
        earlier: &EarlierSteps<'_>,
    ) -> anyhow::Result<Self> {
        let EarlierSteps { folder, rows, steps_per_plan, scenario, options } = earlier;
        let plan_rows: Vec<&StepRow> = rows.iter().step_by(*steps_per_plan).collect();
        let first = plan_rows.len().saturating_sub(window);
        let instant = |row: &&StepRow| -> anyhow::Result<_> {
            let path = step_folder(folder, &row.name()).join(STATE);
            let text = read_table(&path)?;
            let saved: SavedState = serde_json::from_slice(&text)
                .map_err(|error| FileError::content("a saved state", error.to_string(), &path))?;
            saved.committed(scenario, options).with_context(|| path.display().to_string())
        };
        let instants = plan_rows[first..].iter().map(instant).collect::<anyhow::Result<Vec<_>>>()?;
        let Some(last) = plan_rows.last() else { return Ok(Self { session, shown: None }) };
        let last = step_folder(folder, &last.name());
        let cache = last.join(CACHE);
        let saved = is_there(&cache)?.then(|| read_cache(&cache)).transpose()?;
        let session = session.resume(plan_rows.len(), &instants, saved, rasterizer);
        let session = session.with_context(|| cache.display().to_string())?;
        let cameras: Vec<_> = scenario.log.rig.iter().map(|rig| rig.camera.name.clone()).collect();
        let shown = images::read(&last, &cameras)?.map(Arc::new);
        Ok(Self { session, shown })
    }

    /// Generates the images of the latest committed state if a planning step is due, and returns the latest images.
    pub(super) fn step(
        &mut self,
        simulation: &Simulation<'_>,
        rasterizer: &mut dyn Rasterizer,
    ) -> anyhow::Result<Option<Images>> {
        let made = self.session.step(simulation, rasterizer)?;
        let fresh = made.is_some();
        if let Some(made) = made {
            self.shown = Some(Arc::new(made));
        }
        let Some(shown) = self.shown.clone() else { return Ok(None) };
        let cache = if fresh { self.session.cache().map(Cache::to_bytes).transpose()? } else { None };
        let fresh = fresh.then(|| NewImages { cache, times: self.session.times() });
        Ok(Some(Images { shown, fresh }))
    }

    /// Returns the names of its images in the page.
    pub(super) fn pictures(&self) -> Vec<&'static str> {
        [GENERATED].into_iter().chain(self.session.has_truth().then_some(TRUTH)).collect()
    }
}

/// Steps of an earlier run.
pub(super) struct EarlierSteps<'a> {
    pub(super) folder: &'a Path,
    pub(super) rows: &'a [StepRow],
    pub(super) steps_per_plan: usize,
    pub(super) scenario: &'a Scenario<'a>,
    pub(super) options: &'a SimOptions,
}

impl Images {
    /// Writes the images of the page into the folder of a step, and new images and state.
    pub(super) fn write(&self, folder: &Path, layout: &view::Layout) -> Result<(), FileError> {
        let StepImages { images, truth, .. } = &*self.shown;
        let view = folder.join(view::VIEW);
        view::write_images(&view, GENERATED, layout, images)?;
        if let Some(truth) = truth {
            view::write_images(&view, TRUTH, layout, truth)?;
        }
        let Some(NewImages { cache, .. }) = &self.fresh else { return Ok(()) };
        if let Some(cache) = cache {
            let path = folder.join(CACHE);
            write_whole(&path, |out| {
                std::io::Write::write_all(out, cache).map_err(FileError::io("write", &path))
            })?;
        }
        let cameras: Vec<_> = layout.cameras.iter().map(|place| place.name.clone()).collect();
        images::write(folder, &cameras, &self.shown)
    }
}

fn read_cache(path: &Path) -> anyhow::Result<Cache> {
    let bytes = read_table(path)?;
    Cache::from_bytes(&bytes).with_context(|| path.display().to_string())
}
