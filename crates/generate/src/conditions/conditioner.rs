use std::sync::Arc;

use point_skeleton::conditions::{ConditionOptions, ConditionSet, FrameCaptions, MapKind, Prompts};
use point_skeleton::dataset::Recording;
use point_skeleton::geometry::Pose;
use point_skeleton::scene::{SceneMap, SceneState};
use point_skeleton::{MapOptions, Renderer};
use pskel_sim::{Committed, Forecast, Instant, scene_state};

use crate::{Condition, DenoiserError, DroppedConditions, FrameConditions, Recipe};

/// Renders the network input of a simulation, from committed and forecast instants.
pub struct Conditioner<'a> {
    log: &'a Recording,
    map: Option<Arc<SceneMap>>,
    maps: MapOptions,
    prompt: Prompts,
    /// Captions by time, in place of the prompt.
    captions: Option<FrameCaptions>,
    /// Conditions that the network does not get.
    dropped: DroppedConditions,
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
    Rendering(#[from] point_skeleton::Error),
    /// The maps do not fit a network.
    #[error(transparent)]
    Maps(#[from] DenoiserError),
}

impl<'a> Conditioner<'a> {
    /// Creates a conditioner for a log and its HD map.
    pub fn new(log: &'a Recording, map: Option<Arc<SceneMap>>, recipe: &Recipe, prompt: &str) -> Self {
        let maps = MapOptions::new(recipe.options(map.is_some()), recipe.selection());
        let (prompt, dropped) = (Prompts::Frame(prompt.to_owned()), DroppedConditions::default());
        Self { log, map, maps, prompt, captions: None, dropped }
    }

    /// Sets captions by time, in place of the prompt.
    #[must_use]
    pub fn with_captions(mut self, captions: Option<FrameCaptions>) -> Self {
        self.captions = captions;
        self
    }

    /// Drops conditions of all frames.
    #[must_use]
    pub fn without(mut self, dropped: DroppedConditions) -> Self {
        self.dropped = dropped;
        self
    }

    /// Adds map kinds to those that are rendered.
    #[must_use]
    pub fn with_maps(mut self, maps: &[MapKind]) -> Self {
        let options = Arc::make_mut(&mut self.maps.conditions);
        options.maps = maps.iter().fold(options.maps, |all, map| all.with(*map));
        self
    }

    /// Rendering options.
    pub fn options(&self) -> &ConditionOptions {
        &self.maps.conditions
    }

    /// Renders a committed instant; `before` is the ego pose one frame earlier.
    ///
    /// # Errors
    /// Returns an error if the device fails, or if the cameras differ in size.
    pub fn committed(
        &self,
        instant: Committed<&Instant>,
        before: Option<Pose>,
        renderer: &mut Renderer<'_>,
    ) -> Result<Committed<RenderedConditions>, ConditionerError> {
        instant.try_map(|instant| self.draw(instant, before, renderer))
    }

    /// Renders the forecasts of the next planning steps after a committed instant.
    ///
    /// # Errors
    /// Returns the errors of [`Conditioner::committed`].
    pub fn forecasts(
        &self,
        now: Committed<&Instant>,
        expected: &[Forecast<Instant>],
        renderer: &mut Renderer<'_>,
    ) -> Result<Vec<Forecast<FrameConditions>>, ConditionerError> {
        let mut before = now.get().ego.pose;
        let mut drawn = Vec::new();
        for instant in expected.iter().map(Forecast::get) {
            drawn.push(Forecast::new(self.draw(instant, Some(before), renderer)?.conditions));
            before = instant.ego.pose;
        }
        Ok(drawn)
    }

    fn draw(
        &self,
        instant: &Instant,
        before: Option<Pose>,
        renderer: &mut Renderer<'_>,
    ) -> Result<RenderedConditions, ConditionerError> {
        let state = scene_state(self.log, instant, self.map.clone());
        let set = renderer.render_with(&state, &self.maps)?.set;
        let prompts = self.captions.as_ref().map_or(&self.prompt, |captions| captions.at(instant.t_us));
        let conditions =
            FrameConditions::new(&set, &state, before, prompts, self.maps.conditions.depth_bins)?;
        Ok(RenderedConditions { state, set, conditions: conditions.without(self.dropped) })
    }
}
