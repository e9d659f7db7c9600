use std::collections::BTreeMap;

use point_skeleton::files::FileName;

use super::error::RolloutError;
use super::options::RolloutRecord;
use super::profile::Profile;
use crate::report::{StepRow, view};
use crate::{DrivingScores, EndReason, Metrics, Scenario};

/// Result of a rollout.
#[derive(Debug)]
pub struct RolloutReport {
    /// All steps, including an earlier run's.
    pub rows: Vec<StepRow>,
    /// Metrics of these steps.
    pub metrics: Metrics,
    /// Scores of these steps.
    pub scores: DrivingScores,
    /// Notes on the log, with counts.
    pub notes: BTreeMap<String, usize>,
    /// Reason for the end; `None` if a step failed.
    pub ended: Option<EndReason>,
    /// Number of steps after the end of the log.
    pub steps_beyond_log: usize,
    /// Error of the step after the last one, which ended the rollout. All files describe the steps before it.
    pub failure: Option<RolloutError>,
    /// Error of writing the summary files: metrics, video, page and index.
    pub summary_failure: Option<RolloutError>,
    /// Durations.
    pub profile: Profile,
    /// Lines for the web page.
    pub(super) facts: Vec<String>,
    /// Placement of the cameras in the page's images.
    pub(super) layout: view::Layout,
    /// Names and sizes (width, height) of the maps.
    pub(super) cameras: Vec<(FileName, [u32; 2])>,
}

impl RolloutReport {
    /// Begins the report of a rollout with the steps of an earlier run.
    pub(super) fn new(rows: Vec<StepRow>, metrics: Metrics) -> Self {
        Self {
            rows,
            metrics,
            scores: DrivingScores::default(),
            notes: BTreeMap::new(),
            ended: None,
            steps_beyond_log: 0,
            failure: None,
            summary_failure: None,
            profile: Profile::default(),
            facts: Vec::new(),
            layout: view::Layout::default(),
            cameras: Vec::new(),
        }
    }

    /// Returns a note on steps after the end of the log; `None` if there are none.
    pub fn note_beyond_log(&self) -> Option<String> {
        beyond_log(self.steps_beyond_log)
    }

    /// Computes the scores, and adds the facts of the web page that are known after the last step.
    pub(super) fn close(&mut self, facts: Vec<String>, record: &RolloutRecord, scenario: &Scenario<'_>) {
        let log = scenario.log;
        self.scores = DrivingScores::of(scenario, &self.rows, &self.metrics);
        let options = &record.simulation;
        self.ended = self.ended.filter(|_| self.failure.is_none());
        let ended = match (&self.failure, self.ended) {
            (Some(_), _) => format!(" of {}, then it failed", options.steps),
            (None, Some(EndReason::LogEnded)) => format!(" of {}, then the log ended", options.steps),
            (None, _) => String::new(),
        };
        let is_beyond = |row: &&StepRow| log.frames.last().is_some_and(|last| row.t_us > last.t_us);
        self.steps_beyond_log = self.rows.iter().filter(is_beyond).count();
        self.facts = vec![
            format!("ego {}", options.ego.name()),
            format!("actors {}", options.actors.name()),
            format!("{} steps and {} plans a second", record.sim_hz, record.plan_hz),
            format!("{} steps{ended}", self.rows.len().saturating_sub(1)),
        ];
        self.facts.extend(facts);
        self.facts.extend(self.note_beyond_log());
    }
}

fn beyond_log(steps: usize) -> Option<String> {
    let steps = match steps {
        0 => return None,
        1 => "1 step lies".to_owned(),
        _ => format!("{steps} steps lie"),
    };
    Some(format!("{steps} beyond the end of the log: only actors under a policy remain there"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_beyond_the_log_are_counted() {
        assert_eq!(beyond_log(0), None);
        assert!(beyond_log(1).unwrap().starts_with("1 step lies beyond the end of the log: "));
        assert!(beyond_log(28).unwrap().starts_with("28 steps lie beyond the end of the log: "));
    }
}
