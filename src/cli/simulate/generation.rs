//! The generator in the rollout: what it makes, how that is kept with the step, and how it is taken up again.

use std::path::Path;
use std::sync::Arc;

use anyhow::Context;
use image::RgbImage;
use serde::{Deserialize, Serialize};

use super::output::{STATE, step_folder};
use crate::cli::generator::{Opened, Subject};
use crate::dataset::read_picture;
use crate::error::{FileError, write_json, write_whole};
use crate::generate::{Cache, Made, Session, SessionTimes};
use crate::geometry::ImageSize;
use crate::raster::Rasterizer;
use crate::report::{StepRow, view};
use crate::sim::{SavedState, Scenario, SimOptions, Simulation};

/// Folder of the images that were made, and their name in the page.
pub(super) const GENERATED: &str = "generated";
/// Folder of the true images, and their name in the page.
pub(super) const TRUTH: &str = "truth";
/// What goes on to the next frame.
pub(super) const CACHE: &str = "generator.safetensors";
/// What kind of images they are.
pub(super) const KIND: &str = "generated.json";

/// The generator and what it made last.
pub(super) struct Generation<'a> {
    session: Session<'a>,
    shown: Option<Arc<Made>>,
}

/// Images of a step.
pub(super) struct Images {
    /// What was made at this plan step or at the last one before.
    pub(super) shown: Arc<Made>,
    /// Whether it was made at this step, with what goes on to the next one.
    pub(super) fresh: Option<Fresh>,
}

/// What is new at a plan step.
pub(super) struct Fresh {
    /// Bytes of [`CACHE`], once frames are made.
    pub(super) cache: Option<Vec<u8>>,
    pub(super) times: SessionTimes,
}

/// `generated.json`.
#[derive(Serialize, Deserialize)]
struct Kind {
    kind: KindName,
}

#[derive(Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum KindName {
    /// True images, which the generator begins with.
    Reference,
    Generated,
}

impl<'a> Generation<'a> {
    /// Begins, or goes on behind the last step of an earlier run.
    pub(super) fn begin(
        opened: Opened,
        subject: &Subject<'a>,
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
            let text = std::fs::read(&path).map_err(FileError::io("read", &path))?;
            let saved: SavedState = serde_json::from_slice(&text)
                .map_err(|error| FileError::content("a saved state", error.to_string(), &path))?;
            saved.committed(scenario, options).with_context(|| path.display().to_string())
        };
        let instants = plan_rows[first..].iter().map(instant).collect::<anyhow::Result<Vec<_>>>()?;
        let Some(last) = plan_rows.last() else { return Ok(Self { session, shown: None }) };
        let last = step_folder(folder, &last.name());
        let cache = last.join(CACHE);
        let saved = cache.is_file().then(|| read_cache(&cache)).transpose()?;
        let session = session.resume(plan_rows.len(), &instants, saved, rasterizer);
        let session = session.with_context(|| cache.display().to_string())?;
        let shown = read_made(&last, &scenario.log.cameras, &session)?;
        Ok(Self { session, shown: Some(Arc::new(shown)) })
    }

    /// Makes the images of what was committed last, if a plan is due.
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
        let fresh = fresh.then(|| Fresh { cache, times: self.session.times() });
        Ok(Some(Images { shown, fresh }))
    }

    /// Names of its pictures in the page.
    pub(super) fn pictures(&self) -> Vec<&'static str> {
        [GENERATED].into_iter().chain(self.session.has_truth().then_some(TRUTH)).collect()
    }
}

/// The steps of an earlier run.
pub(super) struct EarlierSteps<'a> {
    pub(super) folder: &'a Path,
    pub(super) rows: &'a [StepRow],
    pub(super) steps_per_plan: usize,
    pub(super) scenario: &'a Scenario<'a>,
    pub(super) options: &'a SimOptions,
}

impl Images {
    /// Writes what is new into the folder of a step; its pictures for the page always.
    pub(super) fn write(&self, folder: &Path, layout: &view::Layout) -> Result<(), FileError> {
        let Made { is_reference, images, truth } = &*self.shown;
        let kinds = [(GENERATED, Some(images)), (TRUTH, truth.as_ref())];
        for (name, images) in kinds.into_iter().filter_map(|(name, images)| Some((name, images?))) {
            view::write_images(&folder.join(view::VIEW), name, layout, images)?;
            if self.fresh.is_some() {
                write_images(&folder.join(name), layout, images)?;
            }
        }
        let Some(Fresh { cache, .. }) = &self.fresh else { return Ok(()) };
        if let Some(cache) = cache {
            let path = folder.join(CACHE);
            write_whole(&path, |out| {
                std::io::Write::write_all(out, cache).map_err(FileError::io("write", &path))
            })?;
        }
        let kind = if *is_reference { KindName::Reference } else { KindName::Generated };
        write_json(&folder.join(KIND), &Kind { kind })
    }
}

fn write_images(folder: &Path, layout: &view::Layout, images: &[RgbImage]) -> Result<(), FileError> {
    std::fs::create_dir_all(folder).map_err(FileError::io("create", folder))?;
    for (place, image) in layout.cameras.iter().zip(images) {
        let path = folder.join(format!("{}.png", place.name));
        image.save(&path).map_err(|error| FileError::io("write", &path)(std::io::Error::other(error)))?;
    }
    Ok(())
}

fn read_cache(path: &Path) -> anyhow::Result<Cache> {
    let bytes = std::fs::read(path).map_err(FileError::io("read", path))?;
    Cache::from_bytes(&bytes).with_context(|| path.display().to_string())
}

fn read_made(folder: &Path, cameras: &[String], session: &Session<'_>) -> Result<Made, FileError> {
    let ImageSize { height, width } = session.size();
    let path = folder.join(KIND);
    let text = std::fs::read(&path).map_err(FileError::io("read", &path))?;
    let Kind { kind } = serde_json::from_slice(&text)
        .map_err(|error| FileError::content("what kind of images there are", error.to_string(), &path))?;
    let read = |name: &str| {
        let path = |camera: &String| folder.join(name).join(format!("{camera}.png"));
        let image = |camera: &String| read_picture(&path(camera), height, width);
        cameras.iter().map(image).collect::<Result<Vec<_>, _>>()
    };
    let truth = session.has_truth().then(|| read(TRUTH)).transpose()?;
    Ok(Made { is_reference: kind == KindName::Reference, images: read(GENERATED)?, truth })
}
