use std::sync::Arc;

use super::{DenoiserError, FrameConditions, Recipe};
use crate::conditions::{ConditionError, ConditionOptions, ConditionSet, MapKind, render};
use crate::dataset::Log;
use crate::geometry::Pose;
use crate::raster::Rasterizer;
use crate::scene::{SceneMap, SceneState, SelectionOptions, Stage};
use crate::sim::{Committed, Forecast, Instant, Simulation, scene_state};

/// Draws what a network is fed for a simulation: of what was committed, and of what is expected.
pub struct Conditioner<'a> {
    log: &'a Log,
    map: Option<Arc<SceneMap>>,
    stage: &'a Stage<'a>,
    options: ConditionOptions,
    prompt: String,
}

/// What was drawn of one instant.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// Where everybody is.
    pub state: SceneState,
    /// The maps.
    pub set: ConditionSet,
    /// The same for a network.
    pub conditions: FrameConditions,
}

/// Why there are no conditions.
#[derive(Debug, thiserror::Error)]
pub enum ConditionerError {
    /// Drawing.
    #[error(transparent)]
    Drawing(#[from] ConditionError),
    /// Maps that no network takes.
    #[error(transparent)]
    Maps(#[from] DenoiserError),
}

impl<'a> Conditioner<'a> {
    /// For a log, its HD map, and the clouds that stand for it.
    pub fn new(
        log: &'a Log,
        map: Option<Arc<SceneMap>>,
        stage: &'a Stage<'a>,
        recipe: &Recipe,
        prompt: &str,
    ) -> Self {
        let options = recipe.options(map.is_some());
        Self { log, map, stage, options, prompt: prompt.to_owned() }
    }

    /// The same with more maps in what is drawn.
    #[must_use]
    pub fn with_maps(mut self, maps: &[MapKind]) -> Self {
        self.options.maps = maps.iter().fold(self.options.maps, |all, map| all.with(*map));
        self
    }

    /// How maps are drawn.
    pub fn options(&self) -> &ConditionOptions {
        &self.options
    }

    /// Of what was committed; `before` is where the ego was a frame earlier.
    ///
    /// # Errors
    /// The device's; cameras of several sizes.
    pub fn committed(
        &self,
        instant: Committed<&Instant>,
        before: Option<Pose>,
        rasterizer: &mut dyn Rasterizer,
    ) -> Result<Committed<Drawn>, ConditionerError> {
        instant.try_map(|instant| self.draw(instant, before, rasterizer))
    }

    /// Of the next plan steps, at most `count` of them and none beyond the end of the log: there everybody who follows it
    /// is gone.
    ///
    /// # Errors
    /// As [`Conditioner::committed`].
    pub fn forecasts(
        &self,
        simulation: &Simulation<'_>,
        count: usize,
        rasterizer: &mut dyn Rasterizer,
    ) -> Result<Vec<Forecast<FrameConditions>>, ConditionerError> {
        let end_us = self.log.frames.last().map_or(i64::MIN, |frame| frame.t_us);
        let expected = simulation.forecast(count);
        let mut before = simulation.committed().get().ego.pose;
        let mut drawn = Vec::new();
        for instant in expected.iter().map(Forecast::get).take_while(|instant| instant.t_us <= end_us) {
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
    ) -> Result<Drawn, ConditionerError> {
        let state = scene_state(self.log, instant, self.map.clone());
        let instances = self.stage.instances(&state, &SelectionOptions::default());
        let set = render(rasterizer, &instances, &state, &self.options)?;
        let conditions = FrameConditions::new(&set, &state, before, &self.prompt)?;
        Ok(Drawn { state, set, conditions })
    }
}
