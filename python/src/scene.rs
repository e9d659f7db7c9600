use std::sync::Arc;

use glam::{DVec2, DVec3};
use numpy::ndarray::{Array2, ArrayViewD};
use numpy::{PyArray2, PyArray3};
use point_skeleton::conditions::ImageSize;
use point_skeleton::dataset::Class;
use point_skeleton::files::FileName;
use point_skeleton::geometry::{Cuboid, Pose, View};
use point_skeleton::scene::{ActorState, SceneCamera};
use point_skeleton::{EgoOffset, SceneState, geometry};
use pyo3::exceptions::{PyKeyError, PyValueError};
use pyo3::prelude::*;

use crate::error::invalid;
use crate::maps::arrays::{Numbers, Size, intrinsics, matrix, pose, rows, shaped, stack};

/// Camera of a scene, mounted on the ego: a pinhole, or with a lens by `fisheye_mei` and `f_theta`.
///
/// `intrinsics` `[3, 3]` in pixels, `size` (height, width) in pixels, `ego_from_camera` `[4, 4]` in meters
/// (camera axes: x right, y down, z forward). Raises `ValueError` for singular intrinsics, focal lengths that
/// are not positive, and transforms that are not rigid.
#[pyclass(frozen, module = "pskel")]
#[derive(Clone)]
pub(crate) struct Camera {
    camera: geometry::Camera,
    ego_from_camera: Pose,
}

#[pymethods]
impl Camera {
    #[new]
    fn new(name: &str, intrinsics: Numbers<'_>, size: Size, ego_from_camera: Numbers<'_>) -> PyResult<Self> {
        let Size(size) = size;
        let k = shaped("intrinsics", &intrinsics, &[3, 3])?;
        let name: FileName = name.parse().map_err(invalid)?;
        let k = self::intrinsics(|row, column| k[[row, column]]);
        let camera = geometry::Camera::new(name, size.width, size.height, k).map_err(invalid)?;
        Ok(Self { camera, ego_from_camera: pose("ego_from_camera", &ego_from_camera)? })
    }

    /// Creates a fisheye camera in the model of Mei: `mirror_parameter`, `distortion` (k1, k2, p1, p2; the
    /// last two are not used), `projection` (gamma1, gamma2, u0, v0) in pixels. Raises `ValueError` for
    /// invalid numbers.
    #[staticmethod]
    fn fisheye_mei(
        name: &str,
        mirror_parameter: f64,
        distortion: [f64; 4],
        projection: [f64; 4],
        size: Size,
        ego_from_camera: Numbers<'_>,
    ) -> PyResult<Self> {
        let Size(ImageSize { height, width }) = size;
        let camera =
            geometry::Camera::fisheye_mei(name, width, height, mirror_parameter, distortion, projection);
        Ok(Self {
            camera: camera.map_err(invalid)?,
            ego_from_camera: pose("ego_from_camera", &ego_from_camera)?,
        })
    }

    /// Creates a camera in the f-theta model: `calibration` is the principal point (cx, cy), 6 coefficients
    /// of the radius in pixels by the angle in radians, and 6 of the inverse, which are not used. Raises
    /// `ValueError` for invalid numbers.
    #[staticmethod]
    fn f_theta(
        name: &str,
        calibration: [f64; 14],
        size: Size,
        ego_from_camera: Numbers<'_>,
    ) -> PyResult<Self> {
        let Size(ImageSize { height, width }) = size;
        let camera = geometry::Camera::f_theta(name, width, height, calibration).map_err(invalid)?;
        Ok(Self { camera, ego_from_camera: pose("ego_from_camera", &ego_from_camera)? })
    }

    /// Name.
    #[getter]
    fn name(&self) -> String {
        self.camera.name.to_string()
    }

    /// Returns where the recorded image shows points `[N, 3]` in the camera's frame: pixels `[N, 2]`, NaN
    /// where the lens does not show them. Pixels may be outside the image.
    fn project<'py>(&self, py: Python<'py>, points: Numbers<'_>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let (points, projection) = (shaped("points", &points, &[0, 3])?, self.camera.projection());
        let pixel = |p: ArrayViewD<'_, f64>| projection.pixel(DVec3::new(p[0], p[1], p[2]));
        let pixels = points.outer_iter().map(|p| pixel(p).unwrap_or(DVec2::NAN).to_array()).collect();
        Ok(table(py, pixels))
    }

    /// Returns the rays that pixels `[N, 2]` of the recorded image show: unit vectors `[N, 3]` in the
    /// camera's frame, NaN where the lens shows nothing.
    fn unproject<'py>(&self, py: Python<'py>, pixels: Numbers<'_>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let (pixels, projection) = (shaped("pixels", &pixels, &[0, 2])?, self.camera.projection());
        let ray = |p: ArrayViewD<'_, f64>| projection.ray(DVec2::new(p[0], p[1]));
        let rays =
            pixels.outer_iter().map(|p| ray(p).map_or(DVec3::NAN, DVec3::normalize).to_array()).collect();
        Ok(table(py, rays))
    }

    fn __repr__(&self) -> String {
        format!("Camera({:?}, {}x{})", self.name(), self.camera.height, self.camera.width)
    }
}

/// Returns an array of rows.
fn table<const N: usize>(py: Python<'_>, rows: Vec<[f64; N]>) -> Bound<'_, PyArray2<f64>> {
    PyArray2::from_owned_array(py, Array2::from(rows))
}

/// Actor of a scene: a box, with the points of its track in the skeleton or a template.
///
/// `category` as in nuScenes (`vehicle.car`, `human.pedestrian.adult` ..; any other is of class 4, without a
/// template and a drawn box), `size` (length, width, height) in meters, `global_from_box` `[4, 4]` in meters
/// (x forward, y left, z up, origin at the center). Raises `ValueError` for sizes that are not positive and
/// transforms that are not rigid.
#[pyclass(frozen, module = "pskel")]
#[derive(Clone)]
pub(crate) struct Actor {
    inner: ActorState,
}

#[pymethods]
impl Actor {
    #[new]
    fn new(track: String, category: String, size: [f64; 3], global_from_box: Numbers<'_>) -> PyResult<Self> {
        let cuboid =
            Cuboid::new(pose("global_from_box", &global_from_box)?, DVec3::from(size)).map_err(invalid)?;
        let class = Class::from_category(&category);
        Ok(Self { inner: ActorState { track, category, class, cuboid, appearance: None } })
    }

    /// Track id.
    #[getter]
    fn track(&self) -> &str {
        &self.inner.track
    }

    /// Category, as in nuScenes.
    #[getter]
    fn category(&self) -> &str {
        &self.inner.category
    }

    /// Length, width and height, meters.
    #[getter]
    fn size(&self) -> [f64; 3] {
        self.inner.cuboid.size.to_array()
    }

    /// Pose, `[4, 4]`, meters.
    #[getter]
    fn global_from_box<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        matrix(py, &self.inner.cuboid.pose.affine())
    }

    fn __repr__(&self) -> String {
        format!("Actor({:?}, {:?})", self.inner.track, self.inner.category)
    }
}

/// State of a scene at one instant: ego pose, cameras and actors. Immutable: methods return changed copies,
/// and arrays are copies.
///
/// A new scene has the HD map of `map_of`, a scene of the log whose coordinates it has, else none. `ego` is
/// `global_from_ego` `[4, 4]` in meters, `name` the folder name of its maps, `t_us` its time in microseconds.
/// Raises `ValueError` if the name of a camera or a track occurs twice.
#[pyclass(frozen, module = "pskel")]
pub(crate) struct Scene {
    pub(crate) inner: Arc<SceneState>,
    /// Name of its log; `None` for a scene of your own.
    pub(crate) log: Option<Arc<str>>,
}

impl Scene {
    pub(crate) fn of_log(state: SceneState, log: &point_skeleton::Log) -> Self {
        Self { inner: Arc::new(state), log: Some(log.name().into()) }
    }

    /// Checks that the scene is of a log, or of none: its coordinates and actors belong to its log.
    ///
    /// # Errors
    /// Raises `ValueError` for a scene of another log.
    pub(crate) fn checked(&self, log: &str) -> PyResult<Arc<SceneState>> {
        match self.log.as_deref().filter(|name| *name != log) {
            Some(name) => {
                Err(PyValueError::new_err(format!("expected a scene of log {log}, found one of {name}")))
            }
            None => Ok(Arc::clone(&self.inner)),
        }
    }

    fn with(&self, state: SceneState) -> Self {
        Self { inner: Arc::new(state), log: self.log.clone() }
    }
}

#[pymethods]
impl Scene {
    #[new]
    #[pyo3(signature = (ego, cameras, actors=None, *, name="000000", t_us=0, map_of=None))]
    fn from_parts(
        ego: Numbers<'_>,
        cameras: Vec<PyRef<'_, Camera>>,
        actors: Option<Vec<PyRef<'_, Actor>>>,
        name: &str,
        t_us: i64,
        map_of: Option<PyRef<'_, Self>>,
    ) -> PyResult<Self> {
        let global_from_ego = pose("ego", &ego)?;
        let actors = actors.unwrap_or_default();
        let mut actors: Vec<ActorState> = actors.iter().map(|actor| actor.inner.clone()).collect();
        actors.sort_by(|a, b| a.track.cmp(&b.track));
        if let Some(pair) = actors.windows(2).find(|pair| pair[0].track == pair[1].track) {
            return Err(PyValueError::new_err(format!(
                "expected tracks once each, found two {:?}",
                pair[0].track
            )));
        }
        for (i, camera) in cameras.iter().enumerate() {
            if cameras[..i].iter().any(|other| other.camera.name == camera.camera.name) {
                return Err(PyValueError::new_err(format!(
                    "expected cameras once each, found two {}",
                    camera.name()
                )));
            }
        }
        let camera = |camera: &PyRef<'_, Camera>| {
            let camera_from_world = (global_from_ego * camera.ego_from_camera).inverse().affine();
            let view = View { camera: camera.camera.clone(), camera_from_world };
            SceneCamera { view, ego_from_camera: Some(camera.ego_from_camera), global_from_ego }
        };
        let name: FileName = name.parse().map_err(invalid)?;
        let cameras = cameras.iter().map(camera).collect();
        let name = name.to_string();
        let map = map_of.as_ref().and_then(|scene| scene.inner.map.clone());
        let log = map_of.as_ref().and_then(|scene| scene.log.clone());
        let state = SceneState { name, t_us, global_from_ego, cameras, actors, map };
        Ok(Self { inner: Arc::new(state), log })
    }

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
        matrix(py, &self.inner.global_from_ego.affine())
    }

    /// Names of the cameras, the order of the first axis of all maps.
    #[getter]
    fn cameras(&self) -> Vec<String> {
        self.inner.cameras.iter().map(|camera| camera.view.camera.name.to_string()).collect()
    }

    /// Returns a camera with its lens, for the pixels of its recorded images. Raises `KeyError` for a name
    /// that is not in the scene.
    fn camera(&self, name: &str) -> PyResult<Camera> {
        let found = self.inner.cameras.iter().find(|camera| *camera.view.camera.name == *name);
        let SceneCamera { view, ego_from_camera, global_from_ego } = found
            .ok_or_else(|| PyKeyError::new_err(format!("expected the name of a camera, found {name:?}")))?;
        let mounted = || {
            let ego_from_camera = global_from_ego.inverse().affine() * view.camera_from_world.inverse();
            let (_, rotation, translation) = ego_from_camera.to_scale_rotation_translation();
            Pose { rotation: rotation.normalize(), translation }
        };
        Ok(Camera { camera: view.camera.clone(), ego_from_camera: ego_from_camera.unwrap_or_else(mounted) })
    }

    /// Image sizes of the cameras (height, width), pixels.
    #[getter]
    fn sizes(&self) -> Vec<(u32, u32)> {
        self.inner.cameras.iter().map(|c| (c.view.camera.height, c.view.camera.width)).collect()
    }

    /// Intrinsics of the cameras at these sizes, `[V, 3, 3]`, pixels.
    #[getter]
    fn intrinsics<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray3<f64>> {
        stack(py, self.inner.cameras.iter().map(|camera| camera.view.camera.rows()).collect())
    }

    /// Transforms `camera_from_global`, `[V, 4, 4]`, meters.
    #[getter]
    fn camera_from_global<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray3<f64>> {
        stack(py, self.inner.cameras.iter().map(|camera| rows(&camera.view.camera_from_world)).collect())
    }

    /// Actors, sorted by track; actor `i` has number `i + 1` in the instance map.
    #[getter]
    fn actors(&self) -> Vec<Actor> {
        self.inner.actors.iter().map(|actor| Actor { inner: actor.clone() }).collect()
    }

    /// Returns the scene with ego and cameras displaced in the ego frame: meters, degrees to the left and
    /// upward. Raises `ValueError` for numbers that are not finite.
    #[pyo3(signature = (*, forward_m=0.0, left_m=0.0, up_m=0.0, yaw_deg=0.0, pitch_deg=0.0))]
    fn move_ego(
        &self,
        forward_m: f64,
        left_m: f64,
        up_m: f64,
        yaw_deg: f64,
        pitch_deg: f64,
    ) -> PyResult<Self> {
        let parts = [
            ("forward_m", forward_m),
            ("left_m", left_m),
            ("up_m", up_m),
            ("yaw_deg", yaw_deg),
            ("pitch_deg", pitch_deg),
        ];
        for (name, value) in parts {
            if !value.is_finite() {
                return Err(PyValueError::new_err(format!("expected a finite {name}, found {value}")));
            }
        }
        let offset = EgoOffset { forward_m, left_m, up_m, yaw_deg, pitch_deg };
        Ok(self.with(self.inner.moved(offset)))
    }

    /// Returns the scene without one or more actors. Raises `KeyError` for a track that is not in it.
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
        Ok(self.with(state))
    }

    fn __repr__(&self) -> String {
        let (cameras, actors) = (self.inner.cameras.len(), self.inner.actors.len());
        format!("Scene({:?}, {cameras} cameras, {actors} actors)", self.inner.name)
    }
}
