use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use image::RgbImage;
use numpy::ndarray::Ix4;
use numpy::{PyArray1, PyArray4, PyArrayMethods};
use point_skeleton::error::with_causes;
use point_skeleton::geometry::ImageSize;
use point_skeleton::scene::SceneState;
use pskel_generate::{DenoiserRig, GenerationScene};
use pskel_network::{GeneratorName, GeneratorSettings};
use pskel_sim::rollout::{AnyError, ImageGenerator};
use pskel_sim::{Forecast, OtherSimulation};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

use crate::error::{Error, raise};
use crate::maps::arrays::Typed;
use crate::pool::detached;
use crate::renderer::Renderer;
use crate::scene::Scene;

/// A generator of camera images, as of `pskel simulate --generator`, for the states of another simulation:
/// `add_reference` with the first `references` images, then `step`.
///
/// Parameters
/// ----------
/// generator : str
///     `network`, `network:FILE`, `fill`, `process:PEER` or `images:PEER`, where PEER is a command,
///     `unix:PATH` or `tcp:HOST:PORT`.
/// scene : Scene
///     Its cameras are those of all scenes; scenes with an HD map have one in all of them.
/// fps : float
///     Steps per second.
/// log : str
///     Name of the log, for generators that want to know it.
/// prompt : str
///     Text of all frames.
/// recipe : path, optional
///     How its maps are rendered: a JSON file, as `--recipe`.
/// window : int, optional
///     Frames in the window; by default that of the network.
/// noise_seed : int
///     Seed of the noise.
/// timeout : float
///     Time-out for each answer of a process, seconds.
///
/// Raises
/// ------
/// ValueError
///     For options that do not fit.
/// Error
///     For weights that cannot be read, and for a process that does not start or answers wrongly.
#[pyclass(frozen, module = "pskel")]
pub(crate) struct Generator {
    state: Mutex<Option<State>>,
    /// Number of references.
    #[pyo3(get)]
    references: usize,
    /// Number of forecasts that it takes at most.
    #[pyo3(get)]
    forecasts: usize,
    size: ImageSize,
    views: usize,
}

struct State {
    generator: Box<dyn ImageGenerator + Send>,
    simulation: OtherSimulation,
    frames: usize,
}

#[pymethods]
impl Generator {
    #[new]
    #[pyo3(signature = (generator, scene, *, fps, log="", prompt="", recipe=None, window=None, noise_seed=0,
        timeout=60.0))]
    #[allow(clippy::too_many_arguments)] // keyword arguments of Python
    fn new(
        py: Python<'_>,
        generator: &str,
        scene: &Scene,
        fps: f64,
        log: &str,
        prompt: &str,
        recipe: Option<PathBuf>,
        window: Option<usize>,
        noise_seed: u64,
        timeout: f64,
    ) -> PyResult<Self> {
        let name: GeneratorName = generator.parse().map_err(PyValueError::new_err)?;
        let state = &scene.inner;
        let cameras = || state.cameras.iter().map(|camera| &camera.view.camera);
        let rig = DenoiserRig {
            cameras: cameras().map(|camera| camera.name.to_string()).collect(),
            image_sizes: cameras().map(ImageSize::of).collect(),
            fps,
        };
        let (views, has_map) = (rig.cameras.len(), state.map.is_some());
        let prompt = prompt.to_owned();
        let open = || {
            let recipe = recipe.as_deref().map(pskel_generate::Recipe::read).transpose().map_err(raise)?;
            let defaults = GeneratorSettings::default();
            let settings = GeneratorSettings { window, recipe, noise_seed, timeout_s: timeout, ..defaults };
            let opened = settings.open_generator(&name, rig, log, has_map).map_err(|error| {
                let text = with_causes(&error);
                if error.is_usage() { PyValueError::new_err(text) } else { Error::new_err(text) }
            })?;
            let (references, forecasts, size) = (opened.window() - 1, opened.forecasts(), opened.size());
            let scene = GenerationScene {
                has_map,
                prompt,
                captions: None,
                truth: None,
                ego_follows_log: false,
                actors_follow_log: false,
            };
            let generator = opened.session(scene).map_err(|error| Error::new_err(with_causes(&error)))?;
            let simulation = OtherSimulation::default();
            Ok((State { generator, simulation, frames: 0 }, references, forecasts, size))
        };
        let (state, references, forecasts, size) = detached(py, open)?;
        Ok(Self { state: Mutex::new(Some(state)), references, forecasts, size, views })
    }

    /// Height and width of its images, pixels.
    #[getter]
    fn image_size(&self) -> (u32, u32) {
        (self.size.height, self.size.width)
    }

    /// Takes the images of a committed scene, `uint8 [V, h, w, 3]`, as a reference. Raises `ValueError` for
    /// images of another size and for a scene that is not after the last one, `Error` if there are enough
    /// references.
    fn add_reference(
        &self,
        py: Python<'_>,
        renderer: &Renderer,
        scene: &Scene,
        images: Typed<'_, u8, Ix4>,
    ) -> PyResult<()> {
        let images = self.images(&images)?;
        let state = scene.checked(renderer.log())?;
        self.with(py, renderer, move |own, renderer| {
            let committed = own.simulation.commit((*state).clone()).map_err(late)?;
            own.generator.add_reference(committed.as_ref(), images, renderer).map_err(failed)?;
            own.frames += 1;
            Ok(())
        })
    }

    /// Generates the images of a committed scene, `uint8 [V, h, w, 3]`; `forecasts` are scenes that are
    /// expected after it. Raises `ValueError` for a scene that is not after the last one, `Error` if
    /// references are missing, or if rendering or the generator fails; then all further calls fail.
    fn step<'py>(
        &self,
        py: Python<'py>,
        renderer: &Renderer,
        scene: &Scene,
        forecasts: Vec<PyRef<'py, Scene>>,
    ) -> PyResult<Bound<'py, PyArray4<u8>>> {
        let state = scene.checked(renderer.log())?;
        let forecasts: Vec<Forecast<SceneState>> = forecasts
            .iter()
            .map(|scene| Ok(Forecast::new((*scene.checked(renderer.log())?).clone())))
            .collect::<PyResult<_>>()?;
        let bytes = self.with(py, renderer, move |own, renderer| {
            let committed = own.simulation.commit((*state).clone()).map_err(late)?;
            let made = own.generator.generate(own.frames, committed.as_ref(), &forecasts, renderer);
            let made = made.map_err(failed)?.ok_or_else(|| Error::new_err("the generator made no images"))?;
            own.frames += 1;
            Ok(made.images.iter().flat_map(|image| image.as_raw().iter().copied()).collect::<Vec<u8>>())
        })?;
        let shape = [self.views, self.size.height as usize, self.size.width as usize, 3];
        PyArray1::from_vec(py, bytes).reshape(shape)
    }

    /// Ends its process, if it has one. Further calls raise `RuntimeError`.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        detached(py, || {
            self.state.lock().unwrap_or_else(PoisonError::into_inner).take();
            Ok(())
        })
    }
}

impl Generator {
    /// Checks the images of a reference.
    fn images(&self, images: &Typed<'_, u8, Ix4>) -> PyResult<Vec<RgbImage>> {
        let array = images.0.as_array();
        let ImageSize { height, width } = self.size;
        let shape = [self.views, height as usize, width as usize, 3];
        if array.shape() != shape {
            let found = array.shape();
            return Err(PyValueError::new_err(format!("expected images {shape:?}, found {found:?}")));
        }
        let bytes: Vec<u8> = array.iter().copied().collect();
        let images = bytes.chunks(3 * self.size.pixels().max(1));
        Ok(images.filter_map(|image| RgbImage::from_raw(width, height, image.to_vec())).collect())
    }

    /// Calls a function with the open generator and a renderer.
    fn with<T: Send>(
        &self,
        py: Python<'_>,
        renderer: &Renderer,
        call: impl FnOnce(&mut State, &mut point_skeleton::Renderer<'_>) -> PyResult<T> + Send,
    ) -> PyResult<T> {
        detached(py, || {
            let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
            let state = state
                .as_mut()
                .ok_or_else(|| PyRuntimeError::new_err("expected an open Generator, found a closed one"))?;
            renderer.use_now(|renderer| call(state, renderer))
        })
    }
}

fn late(error: pskel_sim::SimError) -> PyErr {
    PyValueError::new_err(error.to_string())
}

fn failed(error: AnyError) -> PyErr {
    Error::new_err(with_causes(&*error))
}
