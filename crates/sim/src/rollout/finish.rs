use std::path::Path;

use point_skeleton::conditions::write::meta::Index;
use point_skeleton::error::{FileError, with_causes};
use point_skeleton::files::input::is_there;
use point_skeleton::files::json;
use point_skeleton::files::{OutputFolder, write_json};
use serde::{Deserialize, Serialize};

use super::earlier::read_record;
use super::error::RolloutError;
use super::options::RolloutInputs;
use super::output::Output;
use super::output::files::{INDEX, METRICS, PAGE, ROLLOUT, STATES, VIDEO};
#[cfg(feature = "video")]
use super::output::video;
use super::report::RolloutReport;
use super::sources::Sources;
use crate::report::page::{self, Page, PageActor, PageEvent, PageStep};
use crate::report::{ActorRow, Phase, StepRow, visibility};
use crate::{Collision, DrivingScores, EndReason, Metrics};

/// Names and colors of the lines in the bird's-eye view.
pub(super) const TRACES: [(&str, [u8; 4]); 3] = [
    ("recorded path", [150, 160, 182, 150]),
    ("driven path", [64, 196, 255, 230]),
    ("plan", [255, 201, 77, 255]),
];

/// Part of `metrics.json` that says whether a step failed.
#[derive(Deserialize)]
struct Ending {
    failure: Option<String>,
}

/// Returns whether a folder has a rollout that ended without a failure, and all of its files.
///
/// # Errors
/// Fails if its metrics cannot be read.
pub fn is_finished(folder: &Path) -> Result<bool, FileError> {
    let path = folder.join(METRICS);
    // The index is written last.
    if !is_there(&path)? || !is_there(&folder.join(INDEX))? {
        return Ok(false);
    }
    let ending: Ending = json::read(&path, "metrics of a rollout")?;
    Ok(ending.failure.is_none())
}

/// Checks that a rollout in a folder, which is finished, was made from the same log, skeleton, HD map and
/// annotations.
///
/// # Errors
/// Fails if it was made from others, or if its options cannot be read.
pub fn check_finished(folder: &Path, inputs: &RolloutInputs<'_>) -> Result<(), RolloutError> {
    let marker = folder.join(ROLLOUT);
    let before = read_record(&marker)?;
    let sources = Sources::new(inputs.scenario, inputs.skeleton, inputs.prompt)?;
    Ok(sources.check(&before["sources"], &marker, &inputs.paths)?)
}

/// Content of `metrics.json`.
#[derive(Serialize)]
pub(super) struct MetricsFile<'a> {
    ended: Option<EndReason>,
    failure: Option<String>,
    #[serde(flatten)]
    metrics: &'a Metrics,
    scores: &'a DrivingScores,
    steps_beyond_log: usize,
    notes: &'a std::collections::BTreeMap<String, usize>,
}

impl<'a> MetricsFile<'a> {
    pub(super) fn new(report: &'a RolloutReport) -> Self {
        let RolloutReport { metrics, scores, ended, notes, steps_beyond_log, .. } = report;
        let failure = report.failure.as_ref().map(|error| with_causes(error));
        Self { ended: *ended, failure, metrics, scores, steps_beyond_log: *steps_beyond_log, notes }
    }
}

/// Writes the summary files of all steps: metrics, video, page, and the index last.
pub(super) fn finish(
    output: &Output<'_>,
    files: &OutputFolder,
    report: &RolloutReport,
) -> Result<(), RolloutError> {
    write_json(&files.claim(METRICS)?, &MetricsFile::new(report))?;
    #[cfg(feature = "video")]
    video::write(output, &files.claim(VIDEO)?, report)?;
    page(output, report).write(&files.claim(PAGE)?)?;
    let cameras: Vec<_> = report.cameras.iter().map(|(name, _)| name.clone()).collect();
    let frames = report.rows.iter().map(|row| row.index_frame(&cameras)).collect();
    Index { options: output.record, frames }.write(&files.claim(INDEX)?)?;
    Ok(())
}

fn page(output: &Output<'_>, report: &RolloutReport) -> Page {
    let rows = &report.rows;
    let first_us = rows.first().map_or(0, |row| row.t_us);
    let step = |row: &StepRow| PageStep {
        name: row.name(),
        step: row.step,
        t_s: (row.t_us - first_us) as f64 / 1e6,
        warm_up: row.phase == Phase::WarmUp,
        speed_mps: row.ego.speed_mps,
        acceleration_mps2: row.ego.acceleration_mps2,
        lateral_m: Some(row.ego.lateral_deviation_m),
        heading_rad: Some(row.ego.heading_deviation_rad),
        fresh: newly_visible(row, report),
    };
    let mut table = serde_json::to_value(&report.metrics).map(|v| page::table(&v)).unwrap_or_default();
    table.extend(serde_json::to_value(&report.scores).map(|v| page::table(&v)).unwrap_or_default());
    let notes = report.notes.iter().map(|(note, count)| [format!("note: {note}"), count.to_string()]);
    table.extend(notes);
    let color = |[r, g, b, _]: [u8; 4]| format!("#{r:02x}{g:02x}{b:02x}");
    Page {
        log: output.record.log.clone(),
        facts: report.facts.clone(),
        failure: report.failure.as_ref().map(|error| with_causes(error)),
        sim_hz: output.record.sim_hz,
        maps: report.layout.maps.clone(),
        sheet: report.layout.clone(),
        traces: TRACES.iter().map(|(name, rgba)| [color(*rgba), (*name).to_owned()]).collect(),
        steps: rows.iter().map(step).collect(),
        events: report.metrics.collisions.iter().map(|c| event(c, rows.get(c.step))).collect(),
        metrics: table,
        files: cfg!(feature = "video")
            .then_some(VIDEO)
            .into_iter()
            .chain([METRICS, STATES, INDEX])
            .map(str::to_owned)
            .collect(),
    }
}

/// Returns the actors that newly enter a camera's view, with their boxes in the page's image.
fn newly_visible(row: &StepRow, report: &RolloutReport) -> Vec<PageActor> {
    let place = |seen: &visibility::VisibleActor| {
        let place = report.layout.cameras.get(seen.camera)?;
        let (_, [width, height]) = report.cameras.get(seen.camera)?;
        let [x, y] =
            [f64::from(place.width) / f64::from(*width), f64::from(place.height) / f64::from(*height)];
        let [left, top, right, bottom] = seen.bounds.map(f64::from);
        let at = [f64::from(place.left) + left * x, f64::from(place.top) + top * y];
        Some([at[0], at[1], (right - left) * x, (bottom - top) * y])
    };
    let actor = |actor: &ActorRow| {
        let new = actor.new_in_view.as_ref().filter(|new| !new.is_empty())?;
        let seen = actor.seen.iter().flatten().filter(|seen| new.contains(&seen.camera));
        let (track, category) = (actor.track.clone(), actor.category.clone());
        Some(PageActor { track, category, boxes: seen.filter_map(place).collect() })
    };
    row.actors.iter().filter_map(actor).collect()
}

/// Describes a collision; `row` is its step.
pub(super) fn event(collision: &Collision, row: Option<&StepRow>) -> PageEvent {
    let actor = row.and_then(|row| row.actors.iter().find(|actor| actor.track == collision.track));
    let category = actor.map_or("an actor", |actor| actor.category.as_str());
    let text = collision.text(category);
    PageEvent { step: collision.step, text }
}
