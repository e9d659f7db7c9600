//! Events of a rollout in the order of its steps.

use std::path::Path;

use point_skeleton::error::{FileError, with_causes};
use pskel_mcap::Level;

use super::finish::event;
use super::output::files::{STATE, step_folder};
use super::report::RolloutReport;
use crate::report::images::is_reference;
use crate::report::{Phase, StepRow};
use crate::{EndReason, SavedState};

/// An event of a step.
pub(super) struct Event {
    pub(super) level: Level,
    /// Part of the program that it is about.
    pub(super) source: &'static str,
    pub(super) text: String,
}

/// Finds the events of one step after the other.
pub(super) struct Events<'a> {
    report: &'a RolloutReport,
    /// Folder of the rollout; without it, only the events in the report are known.
    folder: Option<&'a Path>,
    phase: Option<Phase>,
    /// Number of instants so far with a part of the ego off the road.
    off_road_instants: usize,
    is_off_road: bool,
    /// Whether the latest images are references.
    is_reference: Option<bool>,
}

impl<'a> Events<'a> {
    pub(super) fn new(report: &'a RolloutReport, folder: Option<&'a Path>) -> Self {
        Self { report, folder, phase: None, off_road_instants: 0, is_off_road: false, is_reference: None }
    }

    /// Returns the events of the next step.
    pub(super) fn of(&mut self, row: &StepRow) -> Result<Vec<Event>, FileError> {
        let mut events = Vec::new();
        let mut add = |level, source, text: String| events.push(Event { level, source, text });
        if self.phase.is_none() {
            add(Level::Info, "rollout", self.report.facts.join(", "));
        }
        if self.phase.replace(row.phase) == Some(Phase::WarmUp) && row.phase == Phase::Policy {
            add(Level::Info, "rollout", "the policies take over from the log".to_owned());
        }
        if let Some(folder) = self.folder {
            let folder = step_folder(folder, &row.name());
            if let Some(is_off) = self.off_road(&folder)? {
                let text = if is_off {
                    "the ego leaves the drivable area"
                } else {
                    "the ego is back on the drivable area"
                };
                add(if is_off { Level::Warning } else { Level::Info }, "road", text.to_owned());
            }
            let is_reference = is_reference(&folder)?.or(self.is_reference);
            if is_reference != self.is_reference {
                let kind =
                    if is_reference == Some(true) { "references, from the recording" } else { "generated" };
                add(Level::Info, "generator", format!("images from here on are {kind}"));
            }
            self.is_reference = is_reference;
        }
        let collisions = &self.report.metrics.collisions;
        for collision in collisions.iter().filter(|collision| collision.step == row.step) {
            let level = if collision.at_fault == Some(true) { Level::Error } else { Level::Warning };
            add(level, "collision", event(collision, Some(row)).text);
        }
        if self.report.rows.last().is_some_and(|last| last.step == row.step) {
            let (level, text) = match (&self.report.failure, self.report.ended) {
                (Some(failure), _) => (Level::Error, with_causes(failure)),
                (None, Some(EndReason::LogEnded)) => (Level::Info, "the log ends".to_owned()),
                (None, _) => (Level::Info, "all steps are simulated".to_owned()),
            };
            add(level, "rollout", text);
        }
        Ok(events)
    }

    /// Returns whether the ego is off the road, if that changes at this step.
    fn off_road(&mut self, folder: &Path) -> Result<Option<bool>, FileError> {
        let instants = SavedState::read(&folder.join(STATE))?.off_road_instants();
        let is_off = instants > self.off_road_instants;
        self.off_road_instants = instants;
        let was_off = std::mem::replace(&mut self.is_off_road, is_off);
        Ok((is_off != was_off).then_some(is_off))
    }
}
