use std::collections::VecDeque;
use std::time::Instant;

use point_skeleton::conditions::{ConditionError, ConditionOptions, ConditionSet, MapKind, StepInFlight};
use point_skeleton::raster::{FrameJob, FrameMaps, RasterError, Rasterizer};
use point_skeleton::scene::{SceneClouds, SceneState, SelectionOptions};

/// Frames to render in turn.
pub(super) trait Frames {
    /// Returns the number of frames; at least one.
    fn count(&self) -> usize;

    /// Returns whether the frames have depth maps.
    fn have_depth(&self) -> bool;

    /// Begins a frame.
    fn begin(&mut self, rasterizer: &mut dyn Rasterizer, frame: usize) -> Result<(), ConditionError>;

    /// Finishes the oldest begun frame.
    fn finish<'r>(&mut self, rasterizer: &'r mut dyn Rasterizer) -> Result<Drawn<'r>, ConditionError>;
}

/// Output of a finished frame.
pub(super) enum Drawn<'r> {
    /// Maps of the rasterizer.
    Maps(FrameMaps<'r>),
    /// Maps of a whole step.
    Step(ConditionSet),
}

impl Drawn<'_> {
    /// Returns the number of pixels with a finite depth.
    pub(super) fn filled(&self) -> u64 {
        let count = |depth_m: &[f32]| depth_m.iter().filter(|depth| depth.is_finite()).count() as u64;
        match self {
            Self::Maps(maps) => maps.iter().map(|view| count(&view.depth_m)).sum(),
            Self::Step(set) => {
                set.cameras.iter().filter_map(|camera| camera.depth_m.as_deref()).map(count).sum()
            }
        }
    }
}

/// Jobs that run only the rasterizer.
pub(super) struct Jobs<'a>(pub(super) Vec<FrameJob<'a>>);

impl Frames for Jobs<'_> {
    fn count(&self) -> usize {
        self.0.len()
    }

    fn have_depth(&self) -> bool {
        self.0.iter().all(|job| job.maps.contains(MapKind::Depth))
    }

    fn begin(&mut self, rasterizer: &mut dyn Rasterizer, frame: usize) -> Result<(), ConditionError> {
        Ok(rasterizer.begin(&self.0[frame])?)
    }

    fn finish<'r>(&mut self, rasterizer: &'r mut dyn Rasterizer) -> Result<Drawn<'r>, ConditionError> {
        Ok(Drawn::Maps(rasterizer.finish()?))
    }
}

/// Whole steps of a recording: instance selection, rendering, layouts, and the final maps.
pub(super) struct Steps<'a> {
    scene_clouds: SceneClouds<'a>,
    states: Vec<&'a SceneState>,
    options: ConditionOptions,
    begun: VecDeque<StepInFlight>,
}

impl<'a> Steps<'a> {
    pub(super) fn new(
        scene_clouds: SceneClouds<'a>,
        states: Vec<&'a SceneState>,
        options: ConditionOptions,
    ) -> Self {
        Self { scene_clouds, states, options, begun: VecDeque::new() }
    }
}

impl Frames for Steps<'_> {
    fn count(&self) -> usize {
        self.states.len()
    }

    fn have_depth(&self) -> bool {
        self.options.maps.contains(MapKind::Depth)
    }

    fn begin(&mut self, rasterizer: &mut dyn Rasterizer, frame: usize) -> Result<(), ConditionError> {
        let (state, start) = (self.states[frame], Instant::now());
        let clouds = self.scene_clouds.instances(state, &SelectionOptions::default());
        rasterizer.stages().add("instances", start.elapsed());
        self.begun.push_back(StepInFlight::new(rasterizer, &clouds, state, &self.options)?);
        Ok(())
    }

    fn finish<'r>(&mut self, rasterizer: &'r mut dyn Rasterizer) -> Result<Drawn<'r>, ConditionError> {
        let begun = self.begun.pop_front().ok_or(RasterError::NoFrame)?;
        Ok(Drawn::Step(begun.finish(rasterizer)?))
    }
}
