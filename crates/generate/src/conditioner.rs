use std::sync::Arc;

use point_skeleton::conditions::{
    ConditionError, ConditionOptions, ConditionSet, FrameCaptions, MapKind, render,
};
use point_skeleton::dataset::Recording;
use point_skeleton::geometry::Pose;
use point_skeleton::raster::Rasterizer;
use point_skeleton::scene::{SceneClouds, SceneMap, SceneState, SelectionOptions};
use pskel_sim::{Committed, Forecast, Instant, Simulation, scene_state};

use super::{DenoiserError, FrameConditions, Recipe};

/// Renders the network input of a simulation, from committed and forecast instants.
pub struct Conditioner<'a> {
    log: &'a Recording,
    map: Option<Arc<SceneMap>>,
    scene_clouds: &'a SceneClouds<'a>,
    options: ConditionOptions,
    selection: SelectionOptions,
    prompt: String,
    /// Captions by time, in place of the prompt.
    captions: Option<FrameCaptions>,
}

/// Rendered conditions of one instant.
#[derive(Clone, Debug)]
pub struct RenderedConditions {
    /// Scene state: poses of the ego, the cameras and the actors.
    pub state: SceneState,
    /// Condition maps.
    pub set: ConditionSet,
    /// The maps as network input.
    pub conditions: FrameConditions,
}

/// Error of rendering conditions.
#[derive(Debug, thiserror::Error)]
pub enum ConditionerError {
    /// Error of rendering.
    #[error(transparent)]
    Drawing(#[from] ConditionError),
    /// The maps do not fit a network.
    #[error(transparent)]
    Maps(#[from] DenoiserError),
}

impl<'a> Conditioner<'a> {
    /// Creates a conditioner for a log, its HD map and its scene clouds.
    pub fn new(
        log: &'a Recording,
        map: Option<Arc<SceneMap>>,
        scene_clouds: &'a SceneClouds<'a>,
        recipe: &Recipe,
        prompt: &str,
    ) -> Self {
        let options = recipe.options(map.is_some());
        let (selection, prompt) = (recipe.selection(), prompt.to_owned());
        Self { log, map, scene_clouds, options, selection, prompt, captions: None }
    }

    /// Sets captions by time, in place of the prompt.
    #[must_use]
    pub fn with_captions(mut self, captions: Option<FrameCaptions>) -> Self {
        self.captions = captions;
        self
    }

    /// Adds map kinds to those that are rendered.
    #[must_use]
    pub fn with_maps(mut self, maps: &[MapKind]) -> Self {
        self.options.maps = maps.iter().fold(self.options.maps, |all, map| all.with(*map));
        self
    }

    /// Rendering options.
    pub fn options(&self) -> &ConditionOptions {
        &self.options
    }

    /// Renders a committed instant; `before` is the ego pose one frame earlier.
    ///
    /// # Errors
    /// Returns an error if the device fails, or if the cameras differ in size.
    pub fn committed(
        &self,
        instant: Committed<&Instant>,
        before: Option<Pose>,
        rasterizer: &mut dyn Rasterizer,
    ) -> Result<Committed<RenderedConditions>, ConditionerError> {
        instant.try_map(|instant| self.draw(instant, before, rasterizer))
    }

    /// Renders the forecasts of at most `count` planning steps. They end with the log if the ego replays it.
    ///
    /// # Errors
    /// Returns the errors of [`Conditioner::committed`].
    pub fn forecasts(
        &self,
        simulation: &Simulation<'_>,
        count: usize,
        rasterizer: &mut dyn Rasterizer,
    ) -> Result<Vec<Forecast<FrameConditions>>, ConditionerError> {
        let expected = simulation.forecast(count);
        let mut before = simulation.committed().get().ego.pose;
        let mut drawn = Vec::new();
        for instant in expected.iter().map(Forecast::get) {
            drawn.push(Forecast::new(self.draw(instant, Some(before), rasterizer)?.conditions));
            before = instant.ego.pose;
        }
        Ok(drawn)
    }

    fn draw(
        &self,
        instant: &Instant,
        before: Option<Pose>,
        rasterizer: &mut dyn Rasterizer,
    ) -> Result<RenderedConditions, ConditionerError> {
        let state = scene_state(self.log, instant, self.map.clone());
        let instances = self.scene_clouds.instances(&state, &self.selection);
        let set = render(rasterizer, &instances, &state, &self.options)?;
        let prompt =
            self.captions.as_ref().map_or(self.prompt.as_str(), |captions| captions.at(instant.t_us));
        let conditions = FrameConditions::new(&set, &state, before, prompt)?;
        Ok(RenderedConditions { state, set, conditions })
    }
}
