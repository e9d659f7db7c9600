pub(super) mod owned;
mod scenario;

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::CString;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use numpy::{PyArray1, PyArray4, PyArrayMethods};
use point_skeleton::dataset::{Frame, Gap, LogLocator, LogOpener, ReadOptions, TrackSummary, register};
use point_skeleton::error::with_causes;
use point_skeleton::geometry::View;
use point_skeleton::scene::GroundTruthImages;
use pskel_eval::protocol::SIMGEN_FORMAT;
use pskel_sim::Rates;
use pyo3::exceptions::{PyIndexError, PyOverflowError, PyUserWarning, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList, PySlice};

use self::owned::OwnedLog;
use crate::error::{LogError, RenderError, raise};
use crate::keywords::named;
use crate::maps::arrays::Size;
use crate::pool::detached;
use crate::scene::Scene;

/// Adds the formats of other crates to those that logs have.
pub(crate) fn register_formats() {
    register(&SIMGEN_FORMAT);
    register(&pskel_town::FORMAT);
}

/// A recorded drive: sensors, calibration, ego poses, tracked boxes and HD map. Its items are the scenes at
/// key frames, by index or slice.
///
/// Parameters
/// ----------
/// name : str
///     `FORMAT:PATH[@VERSION][#SCENE]`, the path alone, or `town:OPTIONS`.
/// missing : {"skip", "error"}
///     Missing and damaged parts: `"skip"` counts them in `notes` and names missing ones in `gaps`,
///     `"error"` raises with the first.
/// sensor_root : path, optional
///     Folder of sweeps and images, if not in the data set's usual place.
/// map_root : path, optional
///     Folder of maps, if not in the data set's usual place.
/// allow_outside : bool
///     Also read files outside the data set's folder that it names by absolute paths or by paths with `..`:
///     only for data sets from trusted sources.
/// ring_is : {"auto", "device", "beam"}
///     What the ring numbers of sweeps are.
/// image_distortion : {"usual", "apply", "ignore"}
///     Whether recorded images have the lens distortion that the calibration states.
/// scenario : path or dict, optional
///     Changes of the actors, a file or its content; without points of files, which only commands draw.
///
/// Raises
/// ------
/// LogError
///     If the log or the scenario cannot be read.
/// ValueError
///     For an unknown value, or a scenario that does not fit the log.
///
/// Warns
/// -----
/// UserWarning
///     If parts of the log are missing, or if the HD map cannot be read.
#[pyclass(frozen, sequence, module = "pskel")]
pub(crate) struct Log {
    pub(crate) inner: Arc<OwnedLog>,
    text: String,
    locator: LogLocator,
}

#[pymethods]
impl Log {
    #[new]
    #[pyo3(signature = (name, missing="skip", *, sensor_root=None, map_root=None, allow_outside=false,
        ring_is="auto", image_distortion="usual", scenario=None))]
    #[allow(clippy::too_many_arguments)] // keyword arguments of Python
    fn new(
        py: Python<'_>,
        name: &str,
        missing: &str,
        sensor_root: Option<PathBuf>,
        map_root: Option<PathBuf>,
        allow_outside: bool,
        ring_is: &str,
        image_distortion: &str,
        scenario: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let scenario = scenario.map(scenario::read).transpose()?.unwrap_or_default();
        let reading = ReadOptions {
            rings: named("ring_is", ring_is)?,
            distortion: named("image_distortion", image_distortion)?,
            missing: named("missing", missing)?,
        };
        let locator = name.parse::<LogLocator>().map_err(raise)?;
        let locator = LogLocator { sensor_root, map_root, allow_outside, reading, ..locator };
        let open = || {
            let log = LogOpener::new().open(&locator).map(point_skeleton::Log::new).map_err(raise)?;
            log.optional_map().map_err(raise)?;
            let edited = log.edited(&scenario);
            Ok(OwnedLog::new(edited.map_err(|error| PyValueError::new_err(error.to_string()))?))
        };
        let log: OwnedLog = detached(py, open)?;
        let gaps = &log.recording().gaps;
        let first = gaps.first().map(|gap| format!("{name} has {} gaps, the first: {gap}", gaps.len()));
        let map = log.map_error().map(|error| format!("{name} has an HD map that cannot be read: {error}"));
        for text in first.into_iter().chain(map) {
            let text = CString::new(text.replace('\0', " ")).unwrap_or_default();
            PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 1)?;
        }
        Ok(Self { inner: Arc::new(log), text: name.to_owned(), locator })
    }

    /// Number of skipped and missing items, by kind.
    #[getter]
    fn notes(&self) -> BTreeMap<String, usize> {
        self.inner.recording().notes.clone()
    }

    /// Missing parts: files, records, boxes without a size.
    #[getter]
    fn gaps(&self) -> Vec<String> {
        self.inner.recording().gaps.iter().map(ToString::to_string).collect()
    }

    /// Tracks with boxes, by id, as scenarios name them: dictionaries of `track`, `category`, `size_m`
    /// (median length, width and height), `t_us` (first and last box, absolute microseconds), `frames` and
    /// `path_m` (length of the path).
    #[getter]
    fn tracks<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let tracks = TrackSummary::of(self.inner.recording());
        let dictionary = |TrackSummary { track, category, size_m, t_us, frames, path_m }: TrackSummary| {
            let fields = PyDict::new(py);
            fields.set_item("track", track)?;
            fields.set_item("category", category)?;
            fields.set_item("size_m", size_m.to_vec())?;
            fields.set_item("t_us", t_us.to_vec())?;
            fields.set_item("frames", frames)?;
            fields.set_item("path_m", path_m)?;
            Ok(fields)
        };
        PyList::new(py, tracks.into_iter().map(dictionary).collect::<PyResult<Vec<_>>>()?)
    }

    /// Arguments with which commands open this log: its name, and options that are not the default. Raises
    /// `ValueError` for a log with a scenario, which commands read from a file.
    #[getter]
    fn arguments(&self) -> PyResult<Vec<String>> {
        if !self.inner.recording().edits.is_empty() {
            let message = "expected a log without a scenario: commands read one with --scenario FILE";
            return Err(PyValueError::new_err(message));
        }
        Ok(std::iter::once(self.text.clone()).chain(self.locator.arguments()).collect())
    }

    /// Name of the scene, which identifies the log in skeletons.
    #[getter]
    fn name(&self) -> &str {
        self.inner.name()
    }

    /// Identifier within the data set: the token of the scene in nuScenes, else empty.
    #[getter]
    fn token(&self) -> &str {
        &self.inner.recording().token
    }

    /// Location of the HD map, such as `singapore-onenorth`; may be empty.
    #[getter]
    fn location(&self) -> &str {
        &self.inner.recording().location
    }

    /// Where the log's LiDAR is on the ego: x, y, z in meters; `None` for a log without sweeps.
    #[getter]
    fn lidar_position(&self) -> Option<(f64, f64, f64)> {
        self.inner.recording().lidar_position_m().map(Into::into)
    }

    /// Identifiers of the recorded images within the data set, by camera, for each key frame.
    #[getter]
    fn image_tokens(&self) -> Vec<BTreeMap<String, String>> {
        let log = self.inner.recording();
        let tokens = |frame: &Frame| {
            let images = frame.images.iter();
            images.map(|image| (log.cameras[image.channel].to_string(), image.token.clone())).collect()
        };
        log.frames.iter().map(tokens).collect()
    }

    /// Times of the key frames, microseconds.
    #[getter]
    fn times_us(&self) -> Vec<i64> {
        self.inner.recording().frames.iter().map(|frame| frame.t_us).collect()
    }

    /// Files of sweeps and images that the log names, each once, sorted, also missing ones.
    #[getter]
    fn files(&self) -> Vec<PathBuf> {
        let frames = self.inner.recording().frames.iter();
        let files = frames.flat_map(|frame| {
            let images = frame.images.iter().chain(&frame.between_images).map(|image| &image.path);
            images.chain(frame.sweeps.iter().map(|sweep| &sweep.path))
        });
        let missing = self.inner.recording().gaps.iter().filter_map(Gap::file);
        let files = files.map(PathBuf::as_path).chain(missing);
        files.collect::<BTreeSet<_>>().into_iter().map(Path::to_owned).collect()
    }

    fn __len__(&self) -> usize {
        self.inner.recording().frames.len()
    }

    /// Returns the scene at a key frame, or a list of scenes for a slice; negative indices count from the
    /// end.
    fn __getitem__<'py>(&self, py: Python<'py>, index: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let count = self.__len__();
        if let Ok(slice) = index.cast::<PySlice>() {
            let range = slice.indices(count as isize)?;
            let scenes = (0..range.slicelength).map(|i| self.scene(range.start + i as isize * range.step));
            return Ok(PyList::new(py, scenes.collect::<PyResult<Vec<_>>>()?)?.into_any());
        }
        let index = match index.extract::<isize>() {
            Err(error) if error.is_instance_of::<PyOverflowError>(py) => {
                return Err(PyIndexError::new_err(format!("expected a frame below {count}, found {index}")));
            }
            other => other?,
        };
        let at = if index < 0 { index.saturating_add_unsigned(count) } else { index };
        let scene =
            if at < 0 { Err(self.beyond(index)) } else { self.scene(at).map_err(|_| self.beyond(index)) };
        Ok(Bound::new(py, scene?)?.into_any())
    }

    fn __iter__(slf: Bound<'_, Self>) -> Scenes {
        Scenes { log: slf.unbind(), next: 0 }
    }

    /// Returns the scene at a time (microseconds), with interpolated ego and actors. Raises `ValueError`
    /// outside the log.
    fn at(&self, t_us: i64) -> PyResult<Scene> {
        let scene = self.inner.state_at(t_us).map(|state| Scene::of_log(state, &self.inner));
        scene.ok_or_else(|| {
            let times = self.times_us();
            let (first, last) = (times.first().unwrap_or(&0), times.last().unwrap_or(&0));
            PyValueError::new_err(format!("expected a time of the log, {first} to {last} us, found {t_us}"))
        })
    }

    /// Returns the camera images of a scene, `[V, H, W, 3]` `uint8`: recorded images nearest in time, without
    /// lens distortion and resized to `size` (height, width), or images rendered at the scene's poses if the
    /// log is a town. Raises `ValueError` for a scene of another log, `LogError` if an image cannot be read,
    /// and `RenderError` if it cannot be rendered, as in the fork of a process that has rendered images of
    /// the log.
    #[pyo3(signature = (scene, size))]
    fn images<'py>(&self, py: Python<'py>, scene: &Scene, size: Size) -> PyResult<Bound<'py, PyArray4<u8>>> {
        let (log, scene, Size(size)) = (Arc::clone(&self.inner), scene.checked(self.name())?, size);
        log.claim_images()?;
        let read = || {
            let truth = GroundTruthImages::new(log.reader());
            let drawn =
                |view: &View| View { camera: view.camera.resized(size.height, size.width), ..view.clone() };
            truth.of(&scene, drawn, size, false).map_err(|error| match log.is_rendered() {
                true => RenderError::new_err(with_causes(&error).to_string()),
                false => LogError::new_err(with_causes(&error).to_string()),
            })
        };
        let images = detached(py, read)?;
        let shape = [images.len(), size.height as usize, size.width as usize, 3];
        let bytes = images.into_iter().map(|image| image.into_raw()).collect::<Vec<_>>().concat();
        PyArray1::from_vec(py, bytes).reshape(shape)
    }

    fn __repr__(&self) -> String {
        format!("Log({:?}, {} frames)", self.text, self.__len__())
    }

    /// Returns the arguments of a copy in another process, which opens the log again.
    fn __getnewargs_ex__<'py>(&self, py: Python<'py>) -> PyResult<((&str, &str), Bound<'py, PyDict>)> {
        let LogLocator { sensor_root, map_root, allow_outside, reading, .. } = &self.locator;
        let keywords = PyDict::new(py);
        keywords.set_item("sensor_root", sensor_root)?;
        keywords.set_item("map_root", map_root)?;
        keywords.set_item("allow_outside", allow_outside)?;
        keywords.set_item("ring_is", reading.rings.name())?;
        keywords.set_item("image_distortion", reading.distortion.name())?;
        let edits = &self.inner.recording().edits;
        if !edits.is_empty() {
            keywords.set_item("scenario", scenario::content(py, edits)?)?;
        }
        Ok(((&self.text, reading.missing.name()), keywords))
    }
}

/// Iterator over the scenes at key frames.
#[pyclass(module = "pskel")]
pub(crate) struct Scenes {
    log: Py<Log>,
    next: usize,
}

#[pymethods]
impl Scenes {
    fn __iter__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }

    fn __next__(&mut self) -> Option<Scene> {
        let log = &self.log.get().inner;
        let scene = log.frame(self.next).map(|state| Scene::of_log(state, log));
        self.next += 1;
        scene
    }
}

impl Log {
    fn scene(&self, index: isize) -> PyResult<Scene> {
        let state = usize::try_from(index).ok().and_then(|index| self.inner.frame(index));
        state.map(|state| Scene::of_log(state, &self.inner)).ok_or_else(|| self.beyond(index))
    }

    fn beyond(&self, index: isize) -> PyErr {
        PyIndexError::new_err(format!("expected a frame below {}, found {index}", self.__len__()))
    }

    /// Returns the default rates of the log.
    pub(crate) fn rates(&self) -> Rates {
        Rates::of(self.locator.format, self.inner.recording())
    }
}
