use std::collections::VecDeque;
use std::sync::Arc;

use crate::Error;
use crate::conditions::distort::{Distorter, PinholeStep};
use crate::conditions::{ConditionError, ConditionOptions, StepInFlight, check_memory};
use crate::geometry::View;
use crate::maps::Maps;
use crate::raster::{self, FRAMES_IN_FLIGHT, Rasterizer, RasterizerDesc};
use crate::scene::{SceneClouds, SceneState, SelectionOptions, Substitutes};
use crate::skeleton::Skeleton;

/// Options of a [`Renderer`].
#[derive(Clone, Debug)]
pub struct RenderOptions<'a> {
    /// Maps, sizes and splat radii.
    pub conditions: ConditionOptions,
    /// Choice between an actor's own points and a template.
    pub selection: SelectionOptions,
    /// Rasterizer and device.
    pub rasterizer: RasterizerDesc,
    /// Templates for actors with few points, and augmented assets.
    pub substitutes: &'a Substitutes,
    /// Log whose actors are rendered; by default the first source of the skeleton.
    pub log: Option<&'a str>,
    /// Whether the maps have the lens distortion of the recorded cameras.
    pub distort: bool,
}

impl Default for RenderOptions<'_> {
    fn default() -> Self {
        Self {
            conditions: ConditionOptions::default(),
            selection: SelectionOptions::default(),
            rasterizer: RasterizerDesc::default(),
            substitutes: Substitutes::built_in(),
            log: None,
            distort: false,
        }
    }
}

/// Renders the condition maps of scene states from a skeleton. Owns the device and the clouds on it.
pub struct Renderer<'a> {
    clouds: SceneClouds<'a>,
    rasterizer: Box<dyn Rasterizer + 'a>,
    conditions: Arc<ConditionOptions>,
    selection: SelectionOptions,
    distorter: Option<Distorter>,
    in_flight: VecDeque<InFlight>,
}

struct InFlight {
    state: SceneState,
    pinholes: Option<PinholeStep>,
    step: StepInFlight,
}

impl<'a> Renderer<'a> {
    /// Creates a renderer and uploads the clouds of the skeleton.
    ///
    /// # Errors
    /// Fails if points of the skeleton are damaged, or if no device supports the rasterizer.
    pub fn new(skeleton: &'a Skeleton, options: RenderOptions<'a>) -> Result<Self, Error> {
        let first = skeleton.manifest.sources.first().map_or("", |source| source.log.as_str());
        let clouds = SceneClouds::with(skeleton, options.log.unwrap_or(first), options.substitutes)?;
        let rasterizer = raster::create(&options.rasterizer, clouds.cloud_set())?;
        let distorter = options.distort.then(|| Distorter::new(&options.conditions)).transpose()?;
        Ok(Self {
            clouds,
            rasterizer,
            conditions: Arc::new(options.conditions),
            selection: options.selection,
            distorter,
            in_flight: VecDeque::new(),
        })
    }

    /// Checks that the maps of a state fit into the memory that is available. Rendering checks this too; calling it first
    /// refuses before other work.
    ///
    /// # Errors
    /// Fails if they do not fit.
    pub fn check_memory(&self, state: &SceneState) -> Result<(), Error> {
        let views: Vec<View> = state.cameras.iter().map(|camera| camera.view.clone()).collect();
        Ok(check_memory(&views, &self.conditions, state.map.is_some()).map_err(ConditionError::from)?)
    }

    /// Renders the maps of a state. Frames in flight are discarded.
    ///
    /// # Errors
    /// Fails if the rasterizer fails, or if map layouts are requested and the state has no HD map.
    pub fn render(&mut self, state: &SceneState) -> Result<Maps, Error> {
        self.discard()?;
        self.begin(state)?;
        self.finish()
    }

    /// Renders the maps of states in order. The device renders a state while the host works on the previous one, so
    /// this is faster than repeated calls of [`Renderer::render`]. Frames in flight are discarded.
    ///
    /// # Errors
    /// Items are errors of [`Renderer::render`]; the iterator ends with the first.
    pub fn render_iter(
        &mut self,
        states: impl IntoIterator<Item = SceneState>,
    ) -> impl Iterator<Item = Result<Maps, Error>> {
        let mut states = states.into_iter();
        let mut discarded = self.discard();
        let mut failed = false;
        std::iter::from_fn(move || {
            let mut next = || {
                std::mem::replace(&mut discarded, Ok(()))?;
                while self.in_flight.len() < FRAMES_IN_FLIGHT {
                    let Some(state) = states.next() else { break };
                    self.begin(&state)?;
                }
                if self.in_flight.is_empty() { Ok(None) } else { self.finish().map(Some) }
            };
            if failed {
                return None;
            }
            let result = next().transpose();
            failed = matches!(result, Some(Err(_)));
            result
        })
    }

    /// Begins rendering the maps of a state; [`Renderer::finish`] returns them. States finish in order, with at most
    /// [`FRAMES_IN_FLIGHT`] at a time.
    ///
    /// # Errors
    /// As [`Renderer::render`]; also fails if too many frames are in flight.
    pub fn begin(&mut self, state: &SceneState) -> Result<(), Error> {
        let instances = self.clouds.instances(state, &self.selection);
        let pinholes = self.distorter.as_mut().map(|d| d.pinholes(state)).transpose()?;
        let (drawn, options) =
            pinholes.as_ref().map_or((state, &*self.conditions), |p| (&p.state, &p.options));
        let step = StepInFlight::new(self.rasterizer.as_mut(), &instances, drawn, options)?;
        self.in_flight.push_back(InFlight { state: state.clone(), pinholes, step });
        Ok(())
    }

    /// Waits for the maps of the oldest state in flight.
    ///
    /// # Errors
    /// Fails if the rasterizer fails, or if no state is in flight.
    pub fn finish(&mut self) -> Result<Maps, Error> {
        let Some(InFlight { state, pinholes, step }) = self.in_flight.pop_front() else {
            return Err(raster::RasterError::NoFrame.into());
        };
        let set = step.finish(self.rasterizer.as_mut())?;
        let distorted = pinholes.is_some();
        let set = match pinholes {
            Some(pinholes) => pinholes.distort(set),
            None => set,
        };
        Ok(Maps { state, set, options: Arc::clone(&self.conditions), distorted })
    }

    /// Returns the number of states in flight.
    pub fn in_flight(&self) -> usize {
        self.in_flight.len()
    }

    /// Returns the rasterizer, for stage times and device information.
    pub fn rasterizer(&mut self) -> &mut (dyn Rasterizer + 'a) {
        self.rasterizer.as_mut()
    }

    fn discard(&mut self) -> Result<(), Error> {
        while !self.in_flight.is_empty() {
            self.finish()?;
        }
        Ok(())
    }
}
