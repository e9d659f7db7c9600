use std::sync::Arc;

use glam::DAffine3;
use numpy::ndarray::{Array2, Array3};
use numpy::{IntoPyArray, PyArray2, PyArray3};
use point_skeleton::{EgoOffset, SceneState};
use pyo3::exceptions::{PyKeyError, PyValueError};
use pyo3::prelude::*;

/// State of a scene at one instant: ego pose, cameras and actors. Immutable; methods return changed copies.
#[pyclass(frozen, module = "pskel")]
pub(crate) struct State {
    pub(crate) inner: Arc<SceneState>,
}

impl State {
    pub(crate) fn new(state: SceneState) -> Self {
        Self { inner: Arc::new(state) }
    }
}

/// Returns the rows of a homogeneous transform.
fn rows(affine: &DAffine3) -> [[f64; 4]; 4] {
    let columns = glam::DMat4::from(*affine).transpose();
    columns.to_cols_array_2d()
}

#[pymethods]
impl State {
    /// Name, the folder name of the maps.
    #[getter]
    fn name(&self) -> &str {
        &self.inner.name
    }

    /// Time, microseconds.
    #[getter]
    fn t_us(&self) -> i64 {
        self.inner.t_us
    }

    /// Pose of the ego, `global_from_ego`, `[4, 4]`, meters.
    #[getter]
    fn ego<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        Array2::from(rows(&self.inner.global_from_ego.affine()).to_vec()).into_pyarray(py)
    }

    /// Names of the cameras, the order of the first axis of all maps.
    #[getter]
    fn cameras(&self) -> Vec<String> {
        self.inner.cameras.iter().map(|camera| camera.view.camera.name.to_string()).collect()
    }

    /// Intrinsics of the cameras at their recorded size, `[V, 3, 3]`, pixels.
    #[getter]
    fn intrinsics<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray3<f64>> {
        let all: Vec<_> = self.inner.cameras.iter().map(|camera| camera.view.camera.rows()).collect();
        Array3::from(all).into_pyarray(py)
    }

    /// Transforms `camera_from_global`, `[V, 4, 4]`, meters.
    #[getter]
    fn camera_from_global<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray3<f64>> {
        let all: Vec<_> = self.inner.cameras.iter().map(|camera| rows(&camera.view.camera_from_world)).collect();
        Array3::from(all).into_pyarray(py)
    }

    /// Track ids of the actors; actor `i` has number `i + 1` in the instance map.
    #[getter]
    fn tracks(&self) -> Vec<&str> {
        self.inner.actors.iter().map(|actor| actor.track.as_str()).collect()
    }

    /// Returns the state with ego and cameras displaced in the ego frame: meters, degrees to the left.
    #[pyo3(signature = (*, forward=0.0, left=0.0, yaw_deg=0.0))]
    fn move_ego(&self, forward: f64, left: f64, yaw_deg: f64) -> PyResult<Self> {
        for (name, value) in [("forward", forward), ("left", left), ("yaw_deg", yaw_deg)] {
            if !value.is_finite() {
                return Err(PyValueError::new_err(format!("expected a finite {name}, found {value}")));
            }
        }
        let offset = EgoOffset { x_m: forward, y_m: left, yaw_rad: yaw_deg.to_radians() };
        Ok(Self::new(self.inner.moved(offset)))
    }

    /// Returns the state without one or more actors.
    #[pyo3(signature = (*tracks))]
    fn without(&self, tracks: Vec<String>) -> PyResult<Self> {
        let mut state = (*self.inner).clone();
        for track in tracks {
            let count = state.actors.len();
            state.actors.retain(|actor| actor.track != track);
            if state.actors.len() == count {
                return Err(PyKeyError::new_err(format!("expected the track of an actor, found {track:?}")));
            }
        }
        Ok(Self::new(state))
    }

    fn __repr__(&self) -> String {
        let (cameras, actors) = (self.inner.cameras.len(), self.inner.actors.len());
        format!("State({:?}, {cameras} cameras, {actors} actors)", self.inner.name)
    }
}
