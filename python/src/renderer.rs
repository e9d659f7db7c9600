use std::ffi::CString;
use std::sync::{Arc, Mutex, PoisonError};

use point_skeleton::lidar::Motion;
use point_skeleton::pipeline::Pipeline;
use point_skeleton::scene::Substitutes;
use point_skeleton::{Maps, RenderOptions};
use pyo3::exceptions::{PyRuntimeError, PyUserWarning, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyIterator};
use self_cell::self_cell;

use crate::error::{FORKS, RenderError, raise};
use crate::keywords::Keywords;
use crate::maps::{dictionary, lidar};
use crate::pool::detached;
use crate::scene::Scene;
use crate::skeleton::Skeleton;

/// Values that a renderer borrows.
struct Source {
    skeleton: Arc<point_skeleton::Skeleton>,
    substitutes: Substitutes,
    log: String,
}

type Borrowing<'a> = point_skeleton::Renderer<'a>;

self_cell!(
    /// A renderer together with the values it borrows.
    struct Owned {
        owner: Source,
        #[not_covariant]
        dependent: Borrowing,
    }
);

struct Device {
    /// `None` when closed.
    owned: Option<Owned>,
    /// Number of calls that began a series of frames; frames in flight belong to the last.
    series: u64,
}

/// Base of `pskel.Renderer`, which documents the keyword arguments that it passes by name.
#[pyclass(frozen, subclass, module = "pskel._pskel")]
pub(crate) struct Renderer {
    device: Mutex<Device>,
    /// Log whose actors are rendered.
    log: String,
    /// Process that opened the device.
    process: u32,
}

#[pymethods]
impl Renderer {
    #[new]
    fn new(py: Python<'_>, skeleton: &Skeleton, keywords: &Bound<'_, PyDict>) -> PyResult<Self> {
        let keywords = Keywords(keywords);
        let (conditions, selection) = (keywords.conditions()?, keywords.selection()?);
        let (substitutes, rasterizer) = (keywords.substitutes()?, keywords.rasterizer()?);
        let distort: bool = keywords.get("distort")?;
        if distort && conditions.color_filter.needs_depth() {
            let found = conditions.color_filter.name();
            let message = format!("expected the color_filter bilinear with distort, found {found}");
            return Err(PyValueError::new_err(message));
        }
        let optional_map = keywords.maps()?.is_none();
        let skeleton = Arc::clone(&skeleton.inner);
        let given: Option<String> = keywords.get("log")?;
        if let Some(log) = given.as_ref().filter(|log| skeleton.manifest.times_us(log).is_none()) {
            let found: Vec<&str> =
                skeleton.manifest.sources.iter().map(|source| source.log.as_str()).collect();
            let message = format!("expected a log of the skeleton ({}), found {log:?}", found.join(", "));
            return Err(PyValueError::new_err(message));
        }
        let first = || skeleton.manifest.sources.first().map_or("", |source| source.log.as_str());
        let log = given.unwrap_or_else(|| first().to_owned());
        let name = log.clone();
        let open = || {
            let (substitutes, _) = substitutes.make(&skeleton, &log).map_err(raise)?;
            Owned::try_new(Source { skeleton, substitutes, log }, |source| {
                let options = RenderOptions {
                    conditions,
                    selection,
                    rasterizer,
                    substitutes: &source.substitutes,
                    log: Some(&source.log),
                    distort,
                    optional_map,
                    ..RenderOptions::default()
                };
                point_skeleton::Renderer::new(&source.skeleton, options).map_err(raise)
            })
        };
        let owned = Some(detached(py, open)?);
        let device = Mutex::new(Device { owned, series: 0 });
        Ok(Self { device, log: name, process: std::process::id() })
    }

    /// Renders the maps of a scene: a dictionary of arrays over all cameras. Raises `RenderError`, and
    /// `ValueError` for a scene of another log.
    fn render<'py>(&self, py: Python<'py>, scene: &Scene) -> PyResult<Bound<'py, PyDict>> {
        let scene = scene.checked(&self.log)?;
        let call = || {
            let render = |renderer: &mut Borrowing<'_>| renderer.render(&scene).map_err(raise);
            self.with(None, render)
        };
        arrays(py, &detached(py, call)?.0)
    }

    /// Renders a LiDAR sweep of a scene: a dictionary of arrays. `spec` is a preset or a JSON file, `other`
    /// the scene at another time, through which ego and actors move while the LiDAR turns (nothing moves
    /// without it), `position` (x, y, z) where devices without a mount are on the ego, meters. Points are in
    /// the ego frame at the scene's time; intensity is 0. Raises `RenderError`, and `ValueError` for invalid
    /// values.
    #[pyo3(signature = (scene, spec, *, other=None, position=None))]
    fn lidar<'py>(
        &self,
        py: Python<'py>,
        scene: &Scene,
        spec: &str,
        other: Option<&Scene>,
        position: Option<[f64; 3]>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let spec = lidar::spec(spec, position)?;
        let scene = scene.checked(&self.log)?;
        let other = other.map(|other| other.checked(&self.log)).transpose()?;
        let call = || {
            let motion = Motion::new(&scene, other.as_deref());
            self.with(None, |renderer| renderer.lidar(&spec, &motion).map_err(raise))
        };
        lidar::dictionary(py, &detached(py, call)?.0)
    }

    /// Renders the maps of scenes in order. The device renders a scene while Python uses the maps of the
    /// previous one. After another call of this renderer, the iterator raises `RuntimeError`.
    fn render_all(slf: Bound<'_, Self>, scenes: &Bound<'_, PyAny>) -> PyResult<Frames> {
        let scenes = scenes.try_iter()?.unbind();
        let (py, renderer) = (slf.py(), slf.get());
        let discard = |renderer: &mut Borrowing<'_>| renderer.discard().map_err(raise);
        let ((), series) = detached(py, || renderer.with(None, discard))?;
        Ok(Frames { renderer: slf.unbind(), scenes, series, pipeline: Pipeline::default() })
    }

    /// Name of the device and its driver.
    #[getter]
    fn device(&self, py: Python<'_>) -> PyResult<String> {
        let read = |renderer: &mut Borrowing<'_>| Ok(renderer.rasterizer().info());
        let series = detached(py, || Ok(self.lock().series))?;
        let info = detached(py, || self.with(Some(series), read))?.0;
        Ok(format!("{}, {} ({})", info.rasterizer, info.device, info.driver))
    }

    /// Releases the device. Further calls raise `RuntimeError`.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        self.check_process()?;
        detached(py, || {
            self.lock().owned.take();
            Ok(())
        })
    }

    fn __repr__(&self) -> String {
        format!("Renderer({:?})", self.log)
    }

    fn __enter__(slf: Bound<'_, Self>) -> PyResult<Bound<'_, Self>> {
        let renderer = slf.get();
        detached(slf.py(), || renderer.check_open())?;
        Ok(slf)
    }

    #[pyo3(signature = (*_exception))]
    fn __exit__(&self, py: Python<'_>, _exception: Vec<Py<PyAny>>) -> PyResult<()> {
        self.close(py)
    }
}

/// A fork must not release the device of its parent.
impl Drop for Renderer {
    fn drop(&mut self) {
        if std::process::id() != self.process {
            let device = self.device.get_mut().unwrap_or_else(PoisonError::into_inner);
            std::mem::forget(device.owned.take());
        }
    }
}

impl Renderer {
    /// Returns the name of the log whose actors are rendered.
    pub(crate) fn log(&self) -> &str {
        &self.log
    }

    /// Calls a function with the renderer, after calls of other threads; it ends a series of frames.
    pub(crate) fn use_now<T>(&self, call: impl FnOnce(&mut Borrowing<'_>) -> PyResult<T>) -> PyResult<T> {
        self.with(None, |renderer| {
            renderer.discard().map_err(raise)?;
            call(renderer)
        })
        .map(|(value, _)| value)
    }

    fn check_process(&self) -> PyResult<()> {
        let here = std::process::id();
        if here == self.process {
            return Ok(());
        }
        Err(RenderError::new_err(format!(
            "expected the process that opened the device ({}), found its fork {here}: open a Renderer in \
                each process; {FORKS}",
            self.process
        )))
    }

    fn check_open(&self) -> PyResult<()> {
        self.check_process()?;
        if self.lock().owned.is_some() { Ok(()) } else { Err(closed()) }
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Device> {
        self.device.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Calls a function with the renderer, after calls of other threads, and returns the number of the frame
    /// series. `series`: the series it belongs to; `None` begins one.
    fn with<T>(
        &self,
        series: Option<u64>,
        call: impl FnOnce(&mut Borrowing<'_>) -> PyResult<T>,
    ) -> PyResult<(T, u64)> {
        self.check_process()?;
        let Device { owned, series: current } = &mut *self.lock();
        let owned = owned.as_mut().ok_or_else(closed)?;
        if series.is_some_and(|series| series != *current) {
            let message = "expected no other call of the Renderer while its frames are iterated, found one";
            return Err(PyRuntimeError::new_err(message));
        }
        *current += u64::from(series.is_none());
        let series = *current;
        owned.with_dependent_mut(|_, renderer| call(renderer)).map(|value| (value, series))
    }
}

/// Iterator over the maps of scenes.
#[pyclass(module = "pskel")]
pub(crate) struct Frames {
    renderer: Py<Renderer>,
    scenes: Py<PyIterator>,
    series: u64,
    pipeline: Pipeline<()>,
}

#[pymethods]
impl Frames {
    fn __iter__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }

    fn __next__<'py>(&mut self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        let (mut renderer, series) = (self.renderer.get(), Some(self.series));
        let begin = |renderer: &mut &Renderer| {
            let Some(scene) = self.scenes.bind(py).clone().next().transpose()? else { return Ok(None) };
            let scene = scene.cast::<Scene>()?.get().checked(&renderer.log)?;
            let begin = |renderer: &mut Borrowing<'_>| renderer.begin(&scene).map_err(raise);
            detached(py, || renderer.with(series, begin)).map(|_| Some(()))
        };
        let finish = |renderer: &mut &Renderer, (): &()| {
            let finish = |renderer: &mut Borrowing<'_>| renderer.finish().map_err(raise);
            Ok(detached(py, || renderer.with(series, finish))?.0)
        };
        // Another call since then has begun another series, also if no frame is left.
        detached(py, || renderer.with(series, |_| Ok(())))?;
        let maps: Option<((), Maps)> = self.pipeline.next(&mut renderer, begin, finish)?;
        maps.map(|((), maps)| arrays(py, &maps)).transpose()
    }
}

/// Returns the maps as arrays. Warns of lenses that show more than distorted maps do.
fn arrays<'py>(py: Python<'py>, maps: &Maps) -> PyResult<Bound<'py, PyDict>> {
    for (camera, share) in maps.cameras().iter().zip(maps.uncovered()).filter(|(_, share)| **share > 0.0) {
        let (name, percent) = (&camera.name, 100.0 * share);
        let text = format!(
            "distort leaves {percent:.1} % of {name} empty: its lens shows more there than a pinhole can"
        );
        PyErr::warn(py, &py.get_type::<PyUserWarning>(), &CString::new(text).unwrap_or_default(), 1)?;
    }
    dictionary(py, maps.cameras())
}

fn closed() -> PyErr {
    PyRuntimeError::new_err("expected an open Renderer, found a closed one")
}
