use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Instant;

use crate::Error;
use crate::conditions::distort::{Distorter, PinholeStep};
use crate::conditions::{ConditionError, ConditionOptions, StepInFlight, check_memory};
use crate::dataset::Recording;
use crate::geometry::View;
use crate::lidar::{self, LidarHit, LidarRays, LidarSpec, LidarSweep, Motion, Solids};
use crate::maps::Maps;
use crate::pipeline::Pipeline;
use crate::raster::{self, MapKind, Rasterizer, RasterizerDesc};
use crate::scene::{SceneClouds, SceneInstances, SceneState, SelectionOptions, Substitutes};
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
    /// Whether depth, class, instance and point maps show the color cloud, so that they describe the color
    /// map.
    pub one_cloud: bool,
    /// Whether the map layout is left out for states without an HD map; otherwise they are an error.
    pub optional_map: bool,
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
            one_cloud: false,
            optional_map: false,
        }
    }
}

/// What to render of a state: the maps, and the choice of the clouds that represent its actors.
#[derive(Clone, Debug, Default)]
pub struct MapOptions {
    /// Maps, sizes and splat radii.
    pub conditions: Arc<ConditionOptions>,
    /// Choice between an actor's own points and a template.
    pub selection: SelectionOptions,
}

impl MapOptions {
    /// Creates options of these parts.
    pub fn new(conditions: ConditionOptions, selection: SelectionOptions) -> Self {
        Self { conditions: Arc::new(conditions), selection }
    }
}

/// Renders the condition maps of scene states from a skeleton. Owns the device and the clouds on it.
pub struct Renderer<'a> {
    clouds: SceneClouds<'a>,
    rasterizer: Box<dyn Rasterizer + 'a>,
    maps: MapOptions,
    /// Maps of states without an HD map, if they differ.
    without_map: Option<MapOptions>,
    distorter: Option<Distorter>,
    in_flight: VecDeque<InFlight>,
    /// Surfaces that LiDARs reached; created for the first sweep.
    solids: Option<Solids<'a>>,
}

struct InFlight {
    state: SceneState,
    conditions: Arc<ConditionOptions>,
    pinholes: Option<PinholeStep>,
    step: StepInFlight,
}

impl<'a> Renderer<'a> {
    /// Creates a renderer of a skeleton, whose points are read when they may be seen.
    ///
    /// # Errors
    /// Fails if no device supports the rasterizer.
    pub fn new(skeleton: &'a Skeleton, options: RenderOptions<'a>) -> Result<Self, Error> {
        let first = skeleton.manifest.sources.first().map_or("", |source| source.log.as_str());
        let clouds = SceneClouds::with(skeleton, options.log.unwrap_or(first), options.substitutes);
        let clouds = if options.one_cloud { clouds.of_color() } else { clouds };
        let rasterizer = raster::create(&options.rasterizer, clouds.cloud_set())?;
        let distorter = options.distort.then(|| Distorter::new(&options.conditions)).transpose()?;
        let without_map = options.optional_map.then(|| {
            let maps = options.conditions.maps.without(MapKind::Map);
            MapOptions::new(ConditionOptions { maps, ..options.conditions.clone() }, options.selection)
        });
        let maps = MapOptions::new(options.conditions, options.selection);
        Ok(Self { without_map, distorter, ..Self::with_rasterizer(clouds, rasterizer, maps) })
    }

    /// Creates a renderer with a rasterizer that holds [`SceneClouds::cloud_set`], for rasterizers outside
    /// this crate.
    pub fn with_rasterizer(
        clouds: SceneClouds<'a>,
        rasterizer: Box<dyn Rasterizer + 'a>,
        maps: MapOptions,
    ) -> Self {
        let (without_map, distorter, in_flight, solids) = Default::default();
        Self { clouds, rasterizer, maps, without_map, distorter, in_flight, solids }
    }

    /// Checks that the maps of a state fit into the memory that is available. Rendering checks this too;
    /// calling it first refuses before other work.
    ///
    /// # Errors
    /// Fails if they do not fit.
    pub fn check_memory(&self, state: &SceneState) -> Result<(), Error> {
        let views: Vec<View> = state.cameras.iter().map(|camera| camera.view.clone()).collect();
        Ok(check_memory(&views, &self.maps.conditions, state.map.is_some()).map_err(ConditionError::from)?)
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

    /// Renders other maps of a state than those that the renderer was created for, without lens distortion.
    /// Frames in flight are discarded.
    ///
    /// # Errors
    /// Fails as [`Renderer::render`].
    pub fn render_with(&mut self, state: &SceneState, options: &MapOptions) -> Result<Maps, Error> {
        self.discard()?;
        self.begin_with(state, options)?;
        self.finish()
    }

    /// Renders tagged states in order, and passes their maps to `take` until it returns `false`. The device
    /// renders a state while the host works on the previous one, so this is faster than repeated calls of
    /// [`Renderer::render`]. Frames in flight are discarded.
    ///
    /// # Errors
    /// Returns the first error of `states`, and any error of [`Renderer::render`] as [`Error::Step`].
    pub fn render_each<T, E: From<Error>>(
        &mut self,
        states: impl IntoIterator<Item = Result<(T, SceneState), E>>,
        mut take: impl FnMut(T, Maps) -> bool,
    ) -> Result<(), E> {
        self.discard()?;
        let (mut states, mut pipeline) = (states.into_iter(), Pipeline::default());
        let mut begin = |renderer: &mut Self| {
            let Some((tag, state)) = states.next().transpose()? else { return Ok(None) };
            renderer.begin(&state).map_err(Error::step(&state.name))?;
            Ok(Some((tag, state.name)))
        };
        loop {
            let finish = |renderer: &mut Self, (_, name): &(T, String)| {
                Ok::<_, E>(renderer.finish().map_err(Error::step(name))?)
            };
            let Some(((tag, _), maps)) = pipeline.next(self, &mut begin, finish)? else { return Ok(()) };
            if !take(tag, maps) {
                return Ok(());
            }
        }
    }

    /// Begins rendering the maps of a state; [`Renderer::finish`] returns them. States finish in order, with
    /// at most [`FRAMES_IN_FLIGHT`](raster::FRAMES_IN_FLIGHT) at a time.
    ///
    /// # Errors
    /// As [`Renderer::render`]; also fails if too many frames are in flight.
    pub fn begin(&mut self, state: &SceneState) -> Result<(), Error> {
        let options = self.without_map.as_ref().filter(|_| state.map.is_none()).unwrap_or(&self.maps).clone();
        let maps = options.conditions.maps;
        let pinholes = self.distorter.as_mut().map(|d| d.pinholes(state, maps)).transpose()?;
        self.begin_step(state, pinholes, &options)
    }

    /// Begins rendering other maps of a state than those that the renderer was created for, without lens
    /// distortion.
    ///
    /// # Errors
    /// Fails as [`Renderer::begin`].
    pub fn begin_with(&mut self, state: &SceneState, options: &MapOptions) -> Result<(), Error> {
        self.begin_step(state, None, options)
    }

    fn begin_step(
        &mut self,
        state: &SceneState,
        pinholes: Option<PinholeStep>,
        MapOptions { conditions, selection }: &MapOptions,
    ) -> Result<(), Error> {
        let start = Instant::now();
        let instances = self.clouds.instances(state, selection);
        self.rasterizer.stages().add("instances", start.elapsed());
        let (drawn, options) = pinholes.as_ref().map_or((state, &**conditions), |p| (&p.state, &p.options));
        let step = StepInFlight::new(self.rasterizer.as_mut(), &instances, drawn, options)?;
        let (state, conditions) = (state.clone(), Arc::clone(conditions));
        self.in_flight.push_back(InFlight { state, conditions, pinholes, step });
        Ok(())
    }

    /// Waits for the maps of the oldest state in flight.
    ///
    /// # Errors
    /// Fails if the rasterizer fails, or if no state is in flight.
    pub fn finish(&mut self) -> Result<Maps, Error> {
        let Some(InFlight { state, conditions, pinholes, step }) = self.in_flight.pop_front() else {
            return Err(raster::RasterError::NoFrame.into());
        };
        let set = step.finish(self.rasterizer.as_mut())?;
        let distorted = pinholes.as_ref().map(PinholeStep::uncovered);
        let set = match pinholes {
            Some(pinholes) => pinholes.distort(set),
            None => set,
        };
        Ok(Maps { state, set, options: conditions, distorted })
    }

    /// Renders a LiDAR sweep. Its time stamp is that of the motion's state, in whose ego frame the points
    /// are. Actors have the clouds of the geometry maps, with fewer templates. Frames in flight stay.
    ///
    /// # Errors
    /// Fails if the spec is invalid, if points cannot be read, or if there is too little memory.
    pub fn lidar(&mut self, spec: &LidarSpec, motion: &Motion<'_>) -> Result<LidarSweep, Error> {
        Ok(lidar::render(self.solid_scene(), spec, motion)?)
    }

    /// Returns what each ray of a moving scene meets up to a range in meters, in their order.
    ///
    /// # Errors
    /// Fails if points cannot be read, or if there is too little memory.
    pub fn cast(
        &mut self,
        rays: &[LidarRays],
        motion: &Motion<'_>,
        far_m: f64,
    ) -> Result<Vec<Vec<Option<LidarHit>>>, Error> {
        Ok(self.solid_scene().cast(rays, motion, far_m)?)
    }

    fn solid_scene(&mut self) -> lidar::Scene<'_, 'a> {
        let solids = self.solids.get_or_insert_with(|| Solids::new(self.clouds.cloud_set()));
        lidar::Scene { clouds: &self.clouds, selection: &self.maps.selection, solids }
    }

    /// Returns the clouds of a state as instances of the rasterizer.
    pub fn instances(&self, state: &SceneState) -> SceneInstances {
        self.clouds.instances(state, &self.maps.selection)
    }

    /// Returns the tracks of a log that its boxes alone show, by their first boxes: the skeleton has no
    /// points of them, and there is no template of their category.
    pub fn boxes_alone<'l>(&self, log: &'l Recording) -> Vec<&'l str> {
        self.clouds.boxes_alone(log, &self.maps.selection)
    }

    /// Returns the point count of all clouds.
    pub fn points(&self) -> usize {
        self.clouds.cloud_set().iter().map(|cloud| cloud.len()).sum()
    }

    /// Returns the rasterizer, for stage times and device information.
    pub fn rasterizer(&mut self) -> &mut (dyn Rasterizer + 'a) {
        self.rasterizer.as_mut()
    }

    /// Discards frames in flight.
    ///
    /// # Errors
    /// Fails if the rasterizer fails.
    pub fn discard(&mut self) -> Result<(), Error> {
        while !self.in_flight.is_empty() {
            self.finish()?;
        }
        Ok(())
    }
}
