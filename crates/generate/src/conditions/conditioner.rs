use std::sync::Arc;

use point_skeleton::conditions::{ConditionOptions, ConditionSet, FrameCaptions, MapKind, Prompts};
use point_skeleton::geometry::Pose;
use point_skeleton::scene::SceneState;
use point_skeleton::{MapOptions, Renderer};
use pskel_sim::{Committed, Forecast};

use crate::{Condition, DenoiserError, DroppedConditions, FrameConditions, Recipe};

/// Renders the network input of a simulation, from committed and forecast states.
pub struct Conditioner {
    maps: MapOptions,
    prompt: Prompts,
    /// Captions by time, in place of the prompt.
    captions: Option<FrameCaptions>,
    /// Conditions that the network does not get.
    dropped: DroppedConditions,
}

/// Rendered conditions of one state.
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

impl Conditioner {
    /// Creates a conditioner for states with or without an HD map.
    pub fn new(recipe: &Recipe, has_map: bool, prompt: &str) -> Self {
        let maps = MapOptions::new(recipe.options(has_map), recipe.selection());
        let (prompt, dropped) = (Prompts::Frame(prompt.to_owned()), DroppedConditions::default());
        Self { maps, prompt, captions: None, dropped }
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

    /// Renders a committed state; `before` is the ego pose one frame earlier.
    ///
    /// # Errors
    /// Returns an error if the device fails, or if the cameras differ in size.
    pub fn committed(
        &self,
        state: Committed<&SceneState>,
        before: Option<Pose>,
        renderer: &mut Renderer<'_>,
    ) -> Result<Committed<RenderedConditions>, ConditionerError> {
        state.try_map(|state| self.draw(state, before, renderer))
    }

    /// Renders the forecasts of the next planning steps after a committed state.
    ///
    /// # Errors
    /// Returns the errors of [`Conditioner::committed`].
    pub fn forecasts(
        &self,
        now: Committed<&SceneState>,
        expected: &[Forecast<SceneState>],
        renderer: &mut Renderer<'_>,
    ) -> Result<Vec<Forecast<FrameConditions>>, ConditionerError> {
        let mut before = now.get().global_from_ego;
        let mut drawn = Vec::new();
        for state in expected.iter().map(Forecast::get) {
            drawn.push(Forecast::new(self.draw(state, Some(before), renderer)?.conditions));
            before = state.global_from_ego;
        }
        Ok(drawn)
    }

    fn draw(
        &self,
        state: &SceneState,
        before: Option<Pose>,
        renderer: &mut Renderer<'_>,
    ) -> Result<RenderedConditions, ConditionerError> {
        let set = renderer.render_with(state, &self.maps)?.set;
        let prompts = self.captions.as_ref().map_or(&self.prompt, |captions| captions.at(state.t_us));
        let conditions = FrameConditions::new(&set, state, before, prompts, self.maps.conditions.depth_bins)?;
        Ok(RenderedConditions { state: state.clone(), set, conditions: conditions.without(self.dropped) })
    }
}
