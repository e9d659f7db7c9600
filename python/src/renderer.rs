use std::sync::{Arc, Mutex, PoisonError};

use point_skeleton::raster::RasterizerDesc;
use point_skeleton::scene::Substitutes;
use point_skeleton::{ConditionOptions, ImageSize, MapSet, RenderOptions};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use self_cell::self_cell;

use crate::arrays::dictionary;
use crate::error::{invalid, raise};
use crate::skeleton::Skeleton;
use crate::state::State;

type Borrowing<'a> = point_skeleton::Renderer<'a>;

self_cell!(
    /// A renderer together with the skeleton it borrows.
    struct Owned {
        owner: Arc<point_skeleton::Skeleton>,
        #[not_covariant]
        dependent: Borrowing,
    }
);

/// Renders the condition maps of states from a skeleton. Owns the device and the points on it.
#[pyclass(frozen, module = "pskel")]
pub(crate) struct Renderer {
    /// `None` when closed.
    owned: Mutex<Option<Owned>>,
    /// Process that opened the device.
    process: u32,
}

#[pymethods]
impl Renderer {
    /// Opens a device and uploads the points of a skeleton.
    #[new]
    #[pyo3(signature = (skeleton, *, size=None, out_size=None, maps=None, splat=None, radius=100.0, rasterizer="auto", device=None, log=None))]
    #[allow(clippy::too_many_arguments)] // keyword arguments of Python
    fn new(
        py: Python<'_>,
        skeleton: &Skeleton,
        size: Option<(u32, u32)>,
        out_size: Option<(u32, u32)>,
        maps: Option<Vec<String>>,
        splat: Option<&str>,
        radius: f64,
        rasterizer: &str,
        device: Option<String>,
        log: Option<String>,
    ) -> PyResult<Self> {
        let sized = |size: Option<(u32, u32)>| size.map(|(height, width)| ImageSize { height, width });
        let mut conditions = ConditionOptions {
            radius_m: radius,
            size: sized(size),
            out_size: sized(out_size),
            ..ConditionOptions::default()
        };
        if let Some(maps) = maps {
            conditions.maps = maps.join(",").parse::<MapSet>().map_err(invalid)?;
        }
        if let Some(splat) = splat {
            conditions.splat = splat.parse().map_err(invalid)?;
        }
        let kind = rasterizer.parse().map_err(invalid)?;
        let rasterizer = RasterizerDesc { kind, device, ..RasterizerDesc::default() };
        let skeleton = Arc::clone(&skeleton.inner);
        let open = || {
            Owned::try_new(skeleton, |skeleton| {
                let (substitutes, log) = (Substitutes::built_in(), log.as_deref());
                let options = RenderOptions { conditions, rasterizer, substitutes, log, ..RenderOptions::default() };
                point_skeleton::Renderer::new(skeleton, options)
            })
        };
        let owned = py.detach(open).map_err(raise)?;
        Ok(Self { owned: Mutex::new(Some(owned)), process: std::process::id() })
    }

    /// Renders the maps of a state: a dictionary of arrays over all cameras.
    fn render<'py>(&self, py: Python<'py>, state: &State) -> PyResult<Bound<'py, PyDict>> {
        let state = Arc::clone(&state.inner);
        let maps = py.detach(|| self.with(|renderer| renderer.render(&state).map_err(raise)))?;
        dictionary(py, maps.cameras())
    }

    /// Releases the device. Further calls raise an error.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        self.check_process()?;
        py.detach(|| self.owned.lock().unwrap_or_else(PoisonError::into_inner).take());
        Ok(())
    }

    fn __enter__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }

    #[pyo3(signature = (*_exception))]
    fn __exit__(&self, py: Python<'_>, _exception: Vec<Py<PyAny>>) -> PyResult<()> {
        self.close(py)
    }
}

impl Renderer {
    fn check_process(&self) -> PyResult<()> {
        let here = std::process::id();
        if here == self.process {
            return Ok(());
        }
        Err(PyRuntimeError::new_err(format!(
            "expected the process that opened the device ({}), found its fork {here}: open a Renderer in each process",
            self.process
        )))
    }

    /// Calls a function with the renderer; waits while another thread renders.
    fn with<T>(&self, call: impl FnOnce(&mut Borrowing<'_>) -> PyResult<T>) -> PyResult<T> {
        self.check_process()?;
        let mut owned = self.owned.lock().unwrap_or_else(PoisonError::into_inner);
        let owned = owned.as_mut().ok_or_else(|| PyRuntimeError::new_err("expected an open Renderer, found a closed one"))?;
        owned.with_dependent_mut(|_, renderer| call(renderer))
    }
}
