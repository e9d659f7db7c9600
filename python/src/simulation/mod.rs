pub(super) mod callback;
pub(super) mod roll;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use numpy::ndarray::ArrayViewD;
use point_skeleton::error::with_causes;
use pskel_sim::{
    EgoKind, EgoPolicy, Instant, PathAnchor, PlannerAddress, PlannerSpec, SavedState, Scenario, SimOptions,
    scene_state,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use self_cell::self_cell;
use serde::Serialize;

use crate::error::{SimulationError, invalid, raise_sim};
use crate::keywords::Keywords;
use crate::log::Log;
use crate::log::owned::OwnedLog;
use crate::maps::arrays::Numbers;
use crate::pool::detached;
use crate::scene::Scene;
use crate::time::{Committed, Forecast};

type Borrowing<'a> = pskel_sim::Simulation<'a>;

self_cell!(
    /// A simulation together with the log it borrows.
    struct Owned {
        owner: Arc<OwnedLog>,
        #[not_covariant]
        dependent: Borrowing,
    }
);

/// Base of `pskel.Simulation`, which documents the keyword arguments that it passes by name.
#[pyclass(frozen, subclass, module = "pskel._pskel")]
pub(crate) struct Simulation {
    state: Mutex<State>,
}

struct State {
    owned: Owned,
    progress: Progress,
}

#[derive(Default)]
struct Progress {
    /// Whether the iteration has begun.
    begun: bool,
    /// The step before the committed one.
    previous: Option<Instant>,
}

impl Progress {
    /// Computes and commits the next step; `false` once the simulation is over.
    fn step(&mut self, simulation: &mut Borrowing<'_>) -> PyResult<bool> {
        let now: Instant = (*simulation.committed().get()).clone();
        let stepped = simulation.step().map_err(raise_sim)?.is_some();
        if stepped {
            self.previous = Some(now);
        }
        Ok(stepped)
    }
}

#[pymethods]
impl Simulation {
    #[new]
    fn new(py: Python<'_>, log: &Log, keywords: &Bound<'_, PyDict>) -> PyResult<Self> {
        let keywords = Keywords(keywords);
        let options = options(keywords)?;
        let saved: Option<String> = keywords.get("saved")?;
        let saved: Option<SavedState> =
            saved.as_deref().map(serde_json::from_str).transpose().map_err(|error| {
                let message = "expected a state that Simulation.save returned, found another text";
                PyValueError::new_err(format!("{message}: {error}"))
            })?;
        let (rates, log) = (log.rates(), Arc::clone(&log.inner));
        let start = || {
            Owned::try_new(log, |log| {
                let scenario = Scenario { log: log.recording(), map: log.map(), rates };
                match &saved {
                    Some(saved) => Borrowing::resume(&scenario, options, saved),
                    None => Borrowing::new(&scenario, options),
                }
            })
            .map_err(raise_sim)
        };
        let owned = detached(py, start)?;
        Ok(Self { state: Mutex::new(State { owned, progress: Progress::default() }) })
    }

    /// Number of the committed step.
    #[getter]
    fn index(&self, py: Python<'_>) -> PyResult<usize> {
        self.read(py, |simulation, _| Ok(simulation.committed().get().step))
    }

    /// The committed scene.
    #[getter]
    fn scene(&self, py: Python<'_>) -> PyResult<Scene> {
        self.read(py, |simulation, log| Ok(scene(log, simulation.committed().get())))
    }

    /// The scene of the step before the committed one: ego and actors move through both while a LiDAR turns.
    /// `None` at the first step, also of a resumed simulation.
    #[getter]
    fn previous(&self, py: Python<'_>) -> PyResult<Option<Scene>> {
        detached(py, || {
            let State { owned, progress } = &*self.lock();
            let log = owned.borrow_owner();
            Ok(progress.previous.as_ref().map(|instant| scene(log, instant)))
        })
    }

    /// The committed scene, as a value of the past.
    #[getter]
    fn committed(&self, py: Python<'_>) -> PyResult<Committed> {
        let (scene, step) = self.read(py, |simulation, log| {
            let committed = simulation.committed();
            let scene = scene(log, committed.get());
            Ok((scene, committed.map(|_| ())))
        })?;
        let scene = Py::new(py, scene)?.into_any();
        Ok(Committed { inner: step.map(|()| scene) })
    }

    /// Predicts the scenes of the next planning steps: the ego follows the rest of its plan, the actors their
    /// policy. Fewer if the log ends and the ego follows it.
    fn forecast(&self, py: Python<'_>, count: usize) -> PyResult<Vec<Forecast>> {
        let scenes = self.read(py, |simulation, log| {
            let of = |instant: &pskel_sim::Forecast<Instant>| scene(log, instant.get());
            Ok(simulation.forecast(count).iter().map(of).collect::<Vec<_>>())
        })?;
        let predicted =
            |scene| Ok(Forecast { inner: pskel_sim::Forecast::new(Py::new(py, scene)?.into_any()) });
        scenes.into_iter().map(predicted).collect()
    }

    /// The observation of the committed step, as planners in other processes receive it
    /// (docs/src/reference/planner.md). After resuming from `saved`, its `history` begins with the saved
    /// step.
    #[getter]
    fn observation<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let text = self.read(py, |simulation, _| json(&simulation.observation()))?;
        parsed(py, &text)
    }

    /// Whether the next step needs a plan (`act`).
    #[getter]
    fn needs_plan(&self, py: Python<'_>) -> PyResult<bool> {
        self.read(py, |simulation, _| Ok(simulation.needs_plan()))
    }

    /// Whether the simulation is over: all steps are simulated, or the log has ended and the ego follows it.
    #[getter]
    fn done(&self, py: Python<'_>) -> PyResult<bool> {
        self.read(py, |simulation, _| Ok(simulation.is_done()))
    }

    /// Whether the committed step is after the end of the log, where no recorded road users are left.
    #[getter]
    fn is_beyond_log(&self, py: Python<'_>) -> PyResult<bool> {
        self.read(py, |simulation, log| {
            let end_us = log.recording().frames.last().map(|frame| frame.t_us);
            Ok(end_us.is_some_and(|end_us| simulation.committed().get().t_us > end_us))
        })
    }

    /// Metrics of the committed steps: collisions, distances, comfort, off-road time.
    #[getter]
    fn metrics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let text = self.read(py, |simulation, _| json(&simulation.metrics()))?;
        parsed(py, &text)
    }

    /// Seconds between planning steps.
    #[getter]
    fn plan_dt(&self, py: Python<'_>) -> PyResult<f64> {
        self.read(py, |simulation, _| Ok(simulation.rates().plan_hz.recip()))
    }

    /// Sets the plan of an ego with `ego="caller"`: waypoints `[N, 3]` (x and y in meters, heading in
    /// radians) every `dt` seconds from now, or `[N, 5]` (time in seconds, x, y, heading, speed in meters per
    /// second). `frame`: `ego` or `global`. Raises `ValueError` for a plan that is invalid, too short, or not
    /// needed.
    #[pyo3(signature = (waypoints, *, dt=0.5, frame="ego"))]
    fn act(&self, py: Python<'_>, waypoints: Numbers<'_>, dt: f64, frame: &str) -> PyResult<()> {
        let view = waypoints.as_array();
        if frame != "ego" && frame != "global" {
            return Err(PyValueError::new_err(format!("expected the frame ego or global, found {frame:?}")));
        }
        if !(dt.is_finite() && dt > 0.0) {
            return Err(PyValueError::new_err(format!("expected dt above 0 s, found {dt}")));
        }
        if view.ndim() != 2 || (view.shape()[1] != 3 && view.shape()[1] != 5) {
            return Err(PyValueError::new_err(format!(
                "expected waypoints [N, 3] or [N, 5], found {:?}",
                view.shape()
            )));
        }
        if let Some(value) = view.iter().find(|value| !value.is_finite()) {
            return Err(PyValueError::new_err(format!("expected finite waypoints, found {value}")));
        }
        self.change(py, |simulation, _| {
            let at = simulation.committed().get().ego.position_m();
            let from = if frame == "ego" { [0.0, 0.0] } else { at.to_array() };
            let answer = json(&Answer { frame, trajectory: points(&view, from, dt) })?;
            simulation.follow(answer.as_bytes()).map_err(raise_sim)
        })
    }

    /// Computes and commits the next step. Returns `False` once the simulation is over. Raises
    /// `SimulationError` if a plan is missing.
    fn step(&self, py: Python<'_>) -> PyResult<bool> {
        self.change(py, |simulation, progress| progress.step(simulation))
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        self.read(py, |simulation, log| {
            Ok(format!("Simulation({:?}, step {})", log.name(), simulation.committed().get().step))
        })
    }

    /// Returns the state as text, for `Simulation(log, saved=..)` with the same options.
    fn save(&self, py: Python<'_>) -> PyResult<String> {
        self.read(py, |simulation, _| json(&simulation.save()))
    }

    fn __iter__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }

    fn __next__<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let text = self.change(py, |simulation, progress| {
            let plans = |simulation: &Borrowing<'_>| {
                let step = simulation.committed().get().step;
                step >= simulation.takeover_step() && step.is_multiple_of(simulation.steps_per_plan())
            };
            if !std::mem::replace(&mut progress.begun, true) && plans(simulation) && !simulation.is_done() {
                return json(&simulation.observation()).map(Some);
            }
            while progress.step(simulation)? {
                if plans(simulation) && !simulation.is_done() {
                    return json(&simulation.observation()).map(Some);
                }
            }
            Ok(None)
        })?;
        text.map(|text| parsed(py, &text)).transpose()
    }
}

/// Answer of a planner.
#[derive(Serialize)]
struct Answer<'a> {
    frame: &'a str,
    trajectory: Vec<Point>,
}

#[derive(Serialize)]
struct Point {
    t: f64,
    x: f64,
    y: f64,
    heading: f64,
    v: f64,
}

impl Simulation {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn read<T: Send>(
        &self,
        py: Python<'_>,
        call: impl FnOnce(&Borrowing<'_>, &point_skeleton::Log) -> PyResult<T> + Send,
    ) -> PyResult<T> {
        detached(py, || self.lock().owned.with_dependent(|log, simulation| call(simulation, log)))
    }

    fn change<T: Send>(
        &self,
        py: Python<'_>,
        call: impl FnOnce(&mut Borrowing<'_>, &mut Progress) -> PyResult<T> + Send,
    ) -> PyResult<T> {
        detached(py, || {
            let State { owned, progress } = &mut *self.lock();
            owned.with_dependent_mut(|_, simulation| call(simulation, progress))
        })
    }
}

fn scene(log: &point_skeleton::Log, instant: &Instant) -> Scene {
    Scene::of_log(scene_state(log.recording(), instant, log.map()), log)
}

/// Converts waypoints; the speed of those without one is that from the waypoint before, along the heading.
fn points(view: &ArrayViewD<'_, f64>, from: [f64; 2], dt: f64) -> Vec<Point> {
    let mut before = from;
    let mut point = |row: usize| {
        if view.shape()[1] == 5 {
            let [t, x, y, heading, v] = std::array::from_fn(|column| view[[row, column]]);
            return Point { t, x, y, heading, v };
        }
        let [x, y, heading] = std::array::from_fn(|column| view[[row, column]]);
        let (dx, dy) = (x - before[0], y - before[1]);
        before = [x, y];
        let v = (dx * heading.cos() + dy * heading.sin()) / dt;
        Point { t: (row + 1) as f64 * dt, x, y, heading, v }
    };
    (0..view.shape()[0]).map(&mut point).collect()
}

fn options(keywords: Keywords<'_, '_>) -> PyResult<SimOptions> {
    let kind: EgoKind = keywords.named("ego")?;
    let anchor = if keywords.get("reanchor")? { PathAnchor::EachPlan } else { PathAnchor::Takeover };
    let path = keywords.path("trajectory")?.as_deref().map(|path| EgoPolicy::read(path, anchor)).transpose();
    let path = path.map_err(|error| invalid(with_causes(&error)))?;
    let planner = keywords.get::<Option<String>>("planner")?;
    let planner: Option<PlannerAddress> = planner.as_deref().map(str::parse).transpose().map_err(invalid)?;
    for (name, is_given, needs) in
        [("trajectory", path.is_some(), EgoKind::File), ("planner", planner.is_some(), EgoKind::External)]
    {
        if is_given != (kind == needs) {
            let found = if is_given { kind.name() } else { "none" };
            let message = match is_given {
                true => format!("expected the ego {needs} with a {name}, found {found}"),
                false => format!("expected a {name} with the ego {needs}, found {found}"),
            };
            return Err(PyValueError::new_err(message));
        }
    }
    let timeout_s = keywords.number("planner_timeout", "above 0 s", |seconds| seconds > 0.0)?;
    let planner = planner.map(|address| PlannerSpec { address, timeout_s: timeout_s.unwrap_or(10.0) });
    let ego = EgoPolicy::new(kind, path, planner).unwrap_or(EgoPolicy::Caller);
    Ok(SimOptions {
        seed: keywords.get("seed")?,
        steps: keywords.get("steps")?,
        sim_hz: keywords.get("sim_hz")?,
        plan_hz: keywords.get("plan_hz")?,
        warmup_frames: keywords.get("warmup_frames")?,
        start_us: keywords.get("start_us")?,
        ego,
        actors: keywords.named("actors")?,
        tracking: keywords.named("tracking")?,
        ..SimOptions::default()
    })
}

fn json(value: &impl Serialize) -> PyResult<String> {
    serde_json::to_string(value).map_err(|error| SimulationError::new_err(error.to_string()))
}

fn parsed<'py>(py: Python<'py>, text: &str) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (text,))
}
