use glam::DVec3;
use numpy::PyArray1;
use point_skeleton::scene::SceneMap;
use pskel_sim::pdm::{PdmResult, PdmScorer, PdmScores};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::error::LogError;
use crate::log::Log;
use crate::maps::arrays::{Numbers, shaped};
use crate::pool::detached;

/// A score by its name.
type Column = (&'static str, fn(&PdmScores) -> f64);

/// Scores of a plan without two-frame comfort, which compares two plans.
const COLUMNS: [Column; 11] = [
    ("no_at_fault_collisions", |scores| scores.no_at_fault_collisions),
    ("drivable_area_compliance", |scores| scores.drivable_area_compliance),
    ("driving_direction_compliance", |scores| scores.driving_direction_compliance),
    ("traffic_light_compliance", |scores| scores.traffic_light_compliance),
    ("ego_progress", |scores| scores.ego_progress),
    ("time_to_collision_within_bound", |scores| scores.time_to_collision_within_bound),
    ("lane_keeping", |scores| scores.lane_keeping),
    ("history_comfort", |scores| scores.history_comfort),
    ("comfort", |scores| scores.comfort),
    ("pdms", |scores| scores.pdms),
    ("epdms", |scores| scores.epdms),
];

/// Scores plans from a time of a log on as NAVSIM does. Returns `pdms`, `epdms` and the sub-scores, each
/// `[P]` of 0 to 1.
///
/// Parameters
/// ----------
/// log : Log
///     Log with an HD map, as recorded or with a scenario.
/// plans : array_like
///     `[P, N, 3]`: rear-axle poses in the ego frame at that time, meters forward and to the
///     left, and radians to the left. The first pose is one interval later, the last one at least 4 s.
/// t_us : int
///     Time of the log, absolute microseconds, at least 1.5 s after its first frame and 4 s before its last.
/// interval_s : float
///     Time between poses, seconds.
/// human_filter : bool
///     Whether what the recorded driver did, too, costs nothing.
///
/// Raises
/// ------
/// LogError
///     If the log has no HD map with a drivable area.
/// ValueError
///     For other shapes, values that are not finite, plans of less than 4 s, or a time outside of the log's.
#[pyfunction]
#[pyo3(signature = (log, plans, t_us, *, interval_s=0.5, human_filter=false))]
pub(crate) fn score_plans<'py>(
    py: Python<'py>,
    log: &Log,
    plans: Numbers<'py>,
    t_us: i64,
    interval_s: f64,
    human_filter: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let plans = read(&plans, interval_s)?;
    let inner = &log.inner;
    let score = || {
        let map = inner.map().ok_or_else(no_map)?;
        scored(inner, &map, &plans, t_us, interval_s, human_filter)
    };
    let scores = detached(py, score)?;
    let result = PyDict::new(py);
    for (name, of) in COLUMNS {
        result.set_item(name, PyArray1::from_iter(py, scores.iter().map(of)))?;
    }
    Ok(result)
}

/// Reads plans `[P, N, 3]` of at least 4 s.
fn read(plans: &Numbers<'_>, interval_s: f64) -> PyResult<Vec<Vec<DVec3>>> {
    let view = shaped("plans", plans, &[0, 0, 3])?;
    if !(interval_s.is_finite() && interval_s > 0.0) {
        return Err(PyValueError::new_err(format!("expected interval_s of more than 0, found {interval_s}")));
    }
    let (count, poses) = (view.shape()[0], view.shape()[1]);
    if (poses as f64) * interval_s < 4.0 - 1e-9 {
        let message = format!("expected plans of at least 4 s, found {poses} poses every {interval_s} s");
        return Err(PyValueError::new_err(message));
    }
    if view.iter().any(|value| !value.is_finite()) {
        return Err(PyValueError::new_err("expected plans of finite numbers, found others"));
    }
    let pose = |plan: usize, i: usize| DVec3::from_array([0, 1, 2].map(|part| view[[plan, i, part]]));
    Ok((0..count).map(|plan| (0..poses).map(|i| pose(plan, i)).collect()).collect())
}

fn scored(
    log: &point_skeleton::Log,
    map: &SceneMap,
    plans: &[Vec<DVec3>],
    t_us: i64,
    interval_s: f64,
    human_filter: bool,
) -> PyResult<Vec<PdmScores>> {
    let recording = log.recording();
    let scorer = PdmScorer::new(recording, map.vector_map()).ok_or_else(no_map)?;
    let scene = scorer.scene(t_us).ok_or_else(|| {
        let ends = [recording.frames.first(), recording.frames.last()];
        let [first, last] = ends.map(|frame| frame.map_or(0, |frame| frame.t_us));
        PyValueError::new_err(format!(
            "expected t_us of 1.5 s after the first frame of the log ({first}) to 4 s before its last \
                ({last}), found {t_us}"
        ))
    })?;
    let still = || PyValueError::new_err("expected a log whose ego moves: its path is the route");
    let score = |plans: &[Vec<DVec3>], interval_s: f64| scene.score(plans, interval_s).ok_or_else(still);
    let scores = score(plans, interval_s)?.into_iter().map(|PdmResult { scores, .. }| scores);
    if !human_filter {
        return Ok(scores.collect());
    }
    let recorded = score(&[scene.recorded_plan()], 0.5)?[0].scores;
    Ok(scores.map(|scores| scores.forgiven(&recorded)).collect())
}

fn no_map() -> PyErr {
    LogError::new_err("scores need an HD map with a drivable area, and the log has none")
}
