use point_skeleton::conditions::{ConditionSet, MapKind};
use point_skeleton::raster::{FrameJob, FrameMaps, Rasterizer};
use point_skeleton::scene::SceneState;
use point_skeleton::{Error, Renderer};

/// Frames to render in turn.
pub(super) trait Frames {
    /// Returns the number of frames; at least one.
    fn count(&self) -> usize;

    /// Returns whether the frames have depth maps.
    fn have_depth(&self) -> bool;

    /// Begins a frame.
    fn begin(&mut self, frame: usize) -> Result<(), Error>;

    /// Finishes the oldest begun frame.
    fn finish(&mut self) -> Result<FrameOutput<'_>, Error>;

    /// Returns the rasterizer, for stage times and device information.
    fn rasterizer(&mut self) -> &mut dyn Rasterizer;
}

/// Output of a finished frame.
pub(super) enum FrameOutput<'r> {
    /// Maps of the rasterizer.
    Maps(FrameMaps<'r>),
    /// Maps of a whole step.
    Step(ConditionSet),
}

impl FrameOutput<'_> {
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
pub(super) struct Jobs<'a> {
    pub(super) rasterizer: &'a mut dyn Rasterizer,
    pub(super) jobs: Vec<FrameJob<'a>>,
}

impl Frames for Jobs<'_> {
    fn count(&self) -> usize {
        self.jobs.len()
    }

    fn have_depth(&self) -> bool {
        self.jobs.iter().all(|job| job.maps.contains(MapKind::Depth))
    }

    fn begin(&mut self, frame: usize) -> Result<(), Error> {
        Ok(self.rasterizer.begin(&self.jobs[frame])?)
    }

    fn finish(&mut self) -> Result<FrameOutput<'_>, Error> {
        Ok(FrameOutput::Maps(self.rasterizer.finish()?))
    }

    fn rasterizer(&mut self) -> &mut dyn Rasterizer {
        self.rasterizer
    }
}

/// Whole steps of a recording: instance selection, rendering, layouts, and the final maps.
pub(super) struct Steps<'a, 'r> {
    pub(super) renderer: &'a mut Renderer<'r>,
    pub(super) states: Vec<&'a SceneState>,
    pub(super) have_depth: bool,
}

impl Frames for Steps<'_, '_> {
    fn count(&self) -> usize {
        self.states.len()
    }

    fn have_depth(&self) -> bool {
        self.have_depth
    }

    fn begin(&mut self, frame: usize) -> Result<(), Error> {
        self.renderer.begin(self.states[frame])
    }

    fn finish(&mut self) -> Result<FrameOutput<'_>, Error> {
        Ok(FrameOutput::Step(self.renderer.finish()?.set))
    }

    fn rasterizer(&mut self) -> &mut dyn Rasterizer {
        self.renderer.rasterizer()
    }
}
