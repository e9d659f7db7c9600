use std::path::Path;
use std::sync::Arc;

use image::RgbImage;

use super::run::Settings;
use crate::cli::rasterizer::RasterizerArgs;
use crate::cli::stand_ins::StandInArgs;
use crate::conditions::{CameraConditions, ConditionSet, MapKind};
use crate::dataset::{Dataset, LogFormat};
use crate::error::FileError;
use crate::generate::{Conditioner, Drawn, FrameConditions, Recipe, TrueImages};
use crate::metrics::{MOVING_MPS, moving_mask};
use crate::raster::Rasterizer;
use crate::scene::{SceneMap, Stage};
use crate::sim::{ActorPolicy, Committed, EgoPolicy, Forecast, Instant, Scenario, SimOptions, Simulation};
use crate::skeleton::{self, BuildInput, BuildOptions, BuildRun, Skeleton};
use crate::town::Town;

/// What all variants are given of a town: the ego changes lanes.
pub(super) struct Scene {
    /// Of the log.
    pub(super) name: String,
    /// References, then those that are generated.
    pub(super) frames: Vec<SceneFrame>,
}

/// A plan step.
pub(super) struct SceneFrame {
    /// Since the first.
    pub(super) t_s: f64,
    pub(super) conditions: Committed<FrameConditions>,
    pub(super) forecasts: Vec<Forecast<FrameConditions>>,
    pub(super) truth: Vec<RgbImage>,
    /// Class map of each camera.
    pub(super) class: Vec<Vec<u8>>,
    /// Pixels of actors that move, of each camera.
    pub(super) moving: Vec<Vec<bool>>,
}

/// How a scene is drawn.
pub(super) struct SceneOptions<'a> {
    pub(super) recipe: &'a Recipe,
    /// Frames before the first that is generated: as many forecasts are drawn, too.
    pub(super) references: usize,
    pub(super) settings: &'a Settings,
    pub(super) rasterizer: &'a RasterizerArgs,
    /// Has room for a skeleton.
    pub(super) folder: &'a Path,
}

impl Scene {
    /// Builds the skeleton and drives through the town.
    pub(super) fn draw(town: &Town, options: &SceneOptions<'_>) -> anyhow::Result<Self> {
        let scratch = tempfile::Builder::new().prefix(".pskel-").tempdir_in(options.folder);
        let scratch = scratch.map_err(FileError::io("create a folder in", options.folder))?;
        let path = scratch.path().join("skeleton");
        let input = [BuildInput::all(town)];
        skeleton::build(&path, &input, &BuildOptions::default(), &|_| Ok(Vec::new()), &BuildRun::default())?;
        let skeleton = Skeleton::open(&path)?;
        let log = town.log();
        let (stand_ins, _) = StandInArgs::augmented(None).make(&skeleton, &log.name)?;
        let stage = Stage::with(&skeleton, &log.name, &stand_ins);
        let mut rasterizer = options.rasterizer.create(stage.cloud_set())?;
        let map = town.read_map()?.map(|map| Arc::new(SceneMap::new(map, log)));
        let scenario = Scenario::new(log, map.clone(), LogFormat::Town);
        let conditioner = Conditioner::new(log, map, &stage, options.recipe, "")
            .with_maps(&[MapKind::Class, MapKind::Instance]);
        let simulation = Simulation::new(&scenario, sim_options(options))?;
        let drive = Drive { town, conditioner: &conditioner, options };
        let frames = drive.frames(simulation, rasterizer.as_mut())?;
        Ok(Self { name: log.name.clone(), frames })
    }
}

fn sim_options(options: &SceneOptions<'_>) -> SimOptions {
    SimOptions {
        steps: usize::MAX,
        warmup_frames: options.references + 1,
        ego: EgoPolicy::LaneChange,
        actors: ActorPolicy::Replay,
        ..SimOptions::default()
    }
}

struct Drive<'a> {
    town: &'a Town,
    conditioner: &'a Conditioner<'a>,
    options: &'a SceneOptions<'a>,
}

impl Drive<'_> {
    fn frames(
        &self,
        mut simulation: Simulation<'_>,
        rasterizer: &mut dyn Rasterizer,
    ) -> anyhow::Result<Vec<SceneFrame>> {
        let count = self.options.references + self.options.settings.steps;
        let end_us = self.town.log().frames.last().map_or(i64::MIN, |frame| frame.t_us);
        let (mut frames, mut before, mut first_us) = (Vec::new(), None, None);
        while frames.len() < count {
            let instant = (*simulation.committed().get()).clone();
            anyhow::ensure!(
                instant.t_us <= end_us,
                "expected a log of {count} plan steps, found {}",
                frames.len()
            );
            if instant.step.is_multiple_of(simulation.steps_per_plan()) {
                let drawn = self.conditioner.committed(simulation.committed(), before, rasterizer)?;
                let forecasts =
                    self.conditioner.forecasts(&simulation, self.options.references, rasterizer)?;
                let t_s = (instant.t_us - *first_us.get_or_insert(instant.t_us)) as f64 / 1e6;
                frames.push(self.frame(drawn, forecasts, &instant, t_s)?);
                before = Some(instant.ego.pose);
            }
            simulation.step()?;
        }
        Ok(frames)
    }

    fn frame(
        &self,
        drawn: Committed<Drawn>,
        forecasts: Vec<Forecast<FrameConditions>>,
        instant: &Instant,
        t_s: f64,
    ) -> anyhow::Result<SceneFrame> {
        let view = |view: &crate::geometry::View| self.conditioner.options().drawn_view(view);
        let size = self.options.recipe.size;
        let truth = TrueImages::Town(self.town).of(&drawn.get().state, view, size, true)?;
        let moves = instant.actors.iter().map(|actor| actor.speed_mps.abs() > MOVING_MPS);
        let moving: Vec<u32> =
            (1..).zip(moves).filter(|(_, moves)| *moves).map(|(number, _)| number).collect();
        let (class, instance) = masks(&drawn.get().set)?;
        Ok(SceneFrame {
            t_s,
            conditions: drawn.map(|drawn| drawn.conditions),
            forecasts,
            truth,
            class,
            moving: instance.iter().map(|map| moving_mask(map, &moving)).collect(),
        })
    }
}

/// Class and instance maps of all cameras.
type Masks = (Vec<Vec<u8>>, Vec<Vec<u32>>);

fn masks(set: &ConditionSet) -> anyhow::Result<Masks> {
    let of = |camera: &CameraConditions| Some((camera.class.clone()?, camera.instance.clone()?));
    let all: Option<Vec<_>> = set.cameras.iter().map(of).collect();
    Ok(all
        .ok_or_else(|| anyhow::anyhow!("expected class and instance maps, found none"))?
        .into_iter()
        .unzip())
}
