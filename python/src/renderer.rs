use std::sync::{Arc, Mutex, PoisonError};

use point_skeleton::pipeline::Pipeline;
use point_skeleton::raster::RasterizerDesc;
use point_skeleton::scene::{SelectionOptions, Substitutes};
use point_skeleton::{ConditionOptions, MapSet, Maps, RenderOptions};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyIterator, PyString};
use self_cell::self_cell;

use crate::error::{FORKS, RenderError, invalid, raise};
use crate::maps::arrays::Size;
use crate::maps::dictionary;
use crate::pool::detached;
use crate::scene::Scene;
use crate::skeleton::Skeleton;

static NO_TEMPLATES: Substitutes = Substitutes::NONE;

/// Values that a renderer borrows.
struct Source {
    skeleton: Arc<point_skeleton::Skeleton>,
    log: Option<String>,
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

/// Argument that names a device.
#[derive(FromPyObject)]
enum DeviceName {
    Index(u32),
    Text(String),
}

struct Device {
    /// `None` when closed.
    owned: Option<Owned>,
    /// Number of calls that began a series of frames; frames in flight belong to the last.
    series: u64,
}

/// Renders the condition maps of scenes from a skeleton. Owns a device and the points on it.
///
/// - `size`: (height, width) to render at, pixels; by default that of the cameras.
/// - `out_size`: (height, width) of the maps, to which they are reduced after rendering; by default `size`.
/// - `maps`: names of maps, by default color, depth, class, instance and boxes; also map (needs an HD map),
///   point and tensor.
/// - `splat`: radius by depth `Z:R,..`, by default `15:2,35:1,100:0`. Up to Z meters a point covers (2R+1) x
///   (2R+1) pixels of `size`; points beyond the last Z are not drawn.
/// - `radius`: distance from the ego along the global x and y axes up to which points are drawn, meters.
/// - `min_actor_points`: actors with at most so many points get the shape of the template of their kind, if
///   there is one, in all maps but color; trucks, buses, trailers and construction vehicles keep theirs.
/// - `default_templates`: whether the built-in templates are used, besides those of the skeleton.
/// - `rasterizer`: auto, compute, graphics or cpu (needs no driver); all give the same maps.
/// - `device`: index, UUID, PCI address or part of the name; by default `PSKEL_DEVICE`, else the fastest.
/// - `log`: name of the log whose actors are rendered, by default the first one of the skeleton.
///
/// Raises `ValueError` for invalid options, `RenderError` without a suitable device.
#[pyclass(frozen, module = "pskel")]
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
    #[pyo3(signature = (skeleton, *, size=None, out_size=None, maps=None, splat=None, radius=100.0,
        min_actor_points=20_000, default_templates=true, rasterizer="auto", device=None, log=None))]
    #[allow(clippy::too_many_arguments)] // keyword arguments of Python
    fn new(
        py: Python<'_>,
        skeleton: &Skeleton,
        size: Option<Size>,
        out_size: Option<Size>,
        maps: Option<Bound<'_, PyAny>>,
        splat: Option<&str>,
        radius: f64,
        min_actor_points: usize,
        default_templates: bool,
        rasterizer: &str,
        device: Option<DeviceName>,
        log: Option<String>,
    ) -> PyResult<Self> {
        let mut conditions = ConditionOptions {
            radius_m: radius,
            size: size.map(|Size(size)| size),
            out_size: out_size.map(|Size(size)| size),
            ..ConditionOptions::default()
        };
        if radius.is_nan() || radius <= 0.0 {
            return Err(PyValueError::new_err(format!("expected a radius above 0 m, found {radius}")));
        }
        if let Some(maps) = maps {
            conditions.maps = map_set(&maps)?;
        }
        if let Some(splat) = splat {
            conditions.splat = splat.parse().map_err(invalid)?;
        }
        let kind = rasterizer.parse().map_err(invalid)?;
        let device = device.map(|device| match device {
            DeviceName::Index(index) => index.to_string(),
            DeviceName::Text(text) => text,
        });
        let rasterizer = RasterizerDesc { kind, device, ..RasterizerDesc::default() };
        let skeleton = Arc::clone(&skeleton.inner);
        if let Some(log) = log.as_ref().filter(|log| skeleton.manifest.times_us(log).is_none()) {
            let found: Vec<&str> =
                skeleton.manifest.sources.iter().map(|source| source.log.as_str()).collect();
            let message = format!("expected a log of the skeleton ({}), found {log:?}", found.join(", "));
            return Err(PyValueError::new_err(message));
        }
        let first = || skeleton.manifest.sources.first().map_or("", |source| source.log.as_str());
        let name = log.as_deref().unwrap_or_else(first).to_owned();
        let open = || {
            Owned::try_new(Source { skeleton, log }, |source| {
                let options = RenderOptions {
                    conditions,
                    selection: SelectionOptions { min_actor_points, ..SelectionOptions::default() },
                    rasterizer,
                    substitutes: if default_templates { Substitutes::built_in() } else { &NO_TEMPLATES },
                    log: source.log.as_deref(),
                    ..RenderOptions::default()
                };
                point_skeleton::Renderer::new(&source.skeleton, options)
            })
            .map_err(raise)
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
        dictionary(py, detached(py, call)?.0.cameras())
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
        maps.map(|((), maps)| dictionary(py, maps.cameras())).transpose()
    }
}

fn closed() -> PyErr {
    PyRuntimeError::new_err("expected an open Renderer, found a closed one")
}

/// Reads map names.
fn map_set(maps: &Bound<'_, PyAny>) -> PyResult<MapSet> {
    let names: Vec<String> = match maps.is_instance_of::<PyString>() {
        true => Vec::new(),
        false => maps.extract()?,
    };
    if let Some(part) = names.iter().find(|name| ["points", "layout"].contains(&name.as_str())) {
        return Err(PyValueError::new_err(format!(
            "expected the map tensor, of which {part} is a part, found {part}"
        )));
    }
    if names.is_empty() || names.iter().any(|name| name.contains(',')) {
        let found = maps.repr()?;
        return Err(PyValueError::new_err(format!("expected a sequence of map names, found {found}")));
    }
    names.join(",").parse().map_err(invalid)
}
