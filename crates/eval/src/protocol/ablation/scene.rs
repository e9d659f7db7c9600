//! Rendering of a scene: conditions, forecasts and ground truth of each frame.

use std::path::Path;
use std::sync::Arc;

use image::RgbImage;
use point_skeleton::conditions::{CameraConditions, ConditionSet, MapKind};
use point_skeleton::dataset::Recording;
use point_skeleton::raster::RasterizerDesc;
use point_skeleton::scene::{GroundTruthImages, SceneMap, SubstituteOptions};
use point_skeleton::skeleton;
use point_skeleton::{Log, RenderOptions, Renderer};
use pskel_generate::{Conditioner, FrameConditions, Recipe, RenderedConditions};
use pskel_sim::{
    ActorPolicy, Committed, EgoPolicy, Forecast, Instant, Rates, Scenario, SimOptions, Simulation,
    scene_state,
};

use super::error::AblationError;
use super::options::AblationOptions;
use crate::{MOVING_MPS, moving_mask};

/// Inputs shared by all variants in a log. In a synthetic log, the ego changes lanes; in a recorded one it
/// follows the log, since images exist only where cameras have been.
pub(super) struct Scene {
    /// Name of the recording.
    pub(super) name: String,
    /// References, then the frames to generate.
    pub(super) frames: Vec<SceneFrame>,
}

/// Inputs and ground truth of a planning step.
pub(super) struct SceneFrame {
    /// Time since the first frame, seconds.
    pub(super) t_s: f64,
    pub(super) conditions: Committed<FrameConditions>,
    pub(super) forecasts: Vec<Forecast<FrameConditions>>,
    pub(super) truth: Vec<RgbImage>,
    /// Pixels of moving actors, by camera.
    pub(super) moving: Vec<Vec<bool>>,
}

/// Options for rendering a scene.
pub(super) struct SceneOptions<'a> {
    pub(super) recipe: &'a Recipe,
    /// Number of frames before the first generated one, and of forecasts.
    pub(super) references: usize,
    pub(super) study: &'a AblationOptions,
    pub(super) rasterizer: &'a RasterizerDesc,
    /// Path of the skeleton, which is built if it does not exist.
    pub(super) skeleton: &'a Path,
}

impl Scene {
    /// Builds the skeleton if it does not exist, and simulates the ego.
    pub(super) fn render(
        name: &str,
        source: &Log,
        options: &SceneOptions<'_>,
    ) -> Result<Self, AblationError> {
        check_length(source.recording(), options.count())?;
        let skeleton = skeleton::open_or_build(options.skeleton, source.reader())?;
        let log = source.recording();
        let (substitutes, _) = SubstituteOptions::default().make(&skeleton, &log.name)?;
        let render = RenderOptions {
            rasterizer: options.rasterizer.clone(),
            substitutes: &substitutes,
            log: Some(&log.name),
            ..RenderOptions::default()
        };
        let mut renderer = Renderer::new(&skeleton, render)?;
        let map = source.require_map()?;
        let scenario = Scenario { log, map: map.clone(), rates: Rates::default() };
        let conditioner = Conditioner::new(options.recipe, map.is_some(), "").with_maps(&[MapKind::Instance]);
        let simulation = Simulation::new(&scenario, sim_options(options, ego_of(source)))?;
        let drive = Drive { log: source, map, conditioner: &conditioner, options };
        let frames = drive.frames(simulation, &mut renderer)?;
        Ok(Self { name: name.to_owned(), frames })
    }
}

impl SceneOptions<'_> {
    /// Returns the number of references and generated frames.
    fn count(&self) -> usize {
        self.references + self.study.steps
    }
}

/// Rejects logs that are too short, because replayed actors are removed after the log ends.
fn check_length(log: &Recording, count: usize) -> Result<(), AblationError> {
    let ends = log.frames.first().zip(log.frames.last());
    let seconds = ends.map_or(0.0, |(first, last)| (last.t_us - first.t_us) as f64 / 1e6);
    let found = 1 + (seconds * Rates::default().plan_hz + 1e-6) as usize;
    if found < count {
        return Err(AblationError::Length { expected: count, found });
    }
    Ok(())
}

/// Returns the policy of an ego whose ground-truth images are known.
fn ego_of(log: &Log) -> EgoPolicy {
    match GroundTruthImages::new(log.reader()).are_known(false, true) {
        true => EgoPolicy::LaneChange,
        false => EgoPolicy::Replay,
    }
}

fn sim_options(options: &SceneOptions<'_>, ego: EgoPolicy) -> SimOptions {
    SimOptions {
        steps: usize::MAX,
        warmup_frames: options.references + 1,
        ego,
        actors: ActorPolicy::Replay,
        ..SimOptions::default()
    }
}

struct Drive<'a> {
    log: &'a Log,
    map: Option<Arc<SceneMap>>,
    conditioner: &'a Conditioner,
    options: &'a SceneOptions<'a>,
}

impl Drive<'_> {
    fn frames(
        &self,
        mut simulation: Simulation<'_>,
        renderer: &mut Renderer<'_>,
    ) -> Result<Vec<SceneFrame>, AblationError> {
        let count = self.options.count();
        let (mut frames, mut before, mut first_us) = (Vec::new(), None, None);
        while frames.len() < count {
            let instant = (*simulation.committed().get()).clone();
            if instant.step.is_multiple_of(simulation.steps_per_plan()) {
                let state = |instant: &Instant| scene_state(self.log.recording(), instant, self.map.clone());
                let now = simulation.committed().map(state);
                let expected = simulation.forecast(self.options.references).into_iter();
                let expected: Vec<_> = expected.map(|next| next.map(|next| state(&next))).collect();
                let drawn = self.conditioner.committed(now.as_ref(), before, renderer)?;
                let forecasts = self.conditioner.forecasts(now.as_ref(), &expected, renderer)?;
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
        drawn: Committed<RenderedConditions>,
        forecasts: Vec<Forecast<FrameConditions>>,
        instant: &Instant,
        t_s: f64,
    ) -> Result<SceneFrame, AblationError> {
        let view = |view: &point_skeleton::geometry::View| self.conditioner.options().drawn_view(view);
        let size = self.options.recipe.size;
        let truth = GroundTruthImages::new(self.log.reader()).of(&drawn.get().state, view, size, true)?;
        let moves = instant.actors.iter().map(|actor| actor.speed_mps.abs() > MOVING_MPS);
        let moving: Vec<u32> =
            (1..).zip(moves).filter(|(_, moves)| *moves).map(|(number, _)| number).collect();
        let instance = instance(&drawn.get().set)?;
        Ok(SceneFrame {
            t_s,
            conditions: drawn.map(|drawn| drawn.conditions),
            forecasts,
            truth,
            moving: instance.iter().map(|map| moving_mask(map, &moving)).collect(),
        })
    }
}

/// Returns the instance map of each camera.
fn instance(set: &ConditionSet) -> Result<Vec<Vec<u32>>, AblationError> {
    let of = |camera: &CameraConditions| camera.instance.clone();
    set.cameras.iter().map(of).collect::<Option<_>>().ok_or(AblationError::NoMasks)
}
