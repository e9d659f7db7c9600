//! Driving scores over many rollouts: of several starts in each log, as recorded or changed.

use std::path::PathBuf;

use point_skeleton::dataset::Recording;
use point_skeleton::error::FileError;
use point_skeleton::files::json;
use pskel_sim::Rates;
use pskel_sim::rollout::METRICS;
use serde::{Deserialize, Serialize};

use super::clips::{Clip, ClipClock};
use crate::intervals::{Interval, score_interval, share_interval};
use crate::table::{markdown, range};

/// Name of the row over all families.
const ALL: &str = "all";

/// Rollout of the protocol.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ScenarioRollout {
    /// Name of the log.
    pub log: String,
    /// Name of what was changed in the log.
    pub change: String,
    /// Name of the group in the table.
    pub family: String,
    /// Folder of the rollout.
    #[serde(skip)]
    pub folder: PathBuf,
}

/// Scores of all rollouts.
#[derive(Clone, Debug, Serialize)]
pub struct ScenarioReport {
    method: String,
    /// Families in the order of their first rollouts, then all.
    families: Vec<Family>,
    rollouts: Vec<Scored>,
}

/// Scores of a family.
#[derive(Clone, Debug, Serialize)]
struct Family {
    name: String,
    rollouts: usize,
    /// Intervals by the names of columns; those that no rollout has are missing.
    scores: Vec<(&'static str, Option<Interval>)>,
}

/// Scores of a rollout.
#[derive(Clone, Debug, Serialize)]
struct Scored {
    #[serde(flatten)]
    rollout: ScenarioRollout,
    collision: bool,
    scores: Scores,
}

/// Content of `metrics.json` that is used here.
#[derive(Deserialize)]
struct Metrics {
    failure: Option<String>,
    collisions: Vec<serde::de::IgnoredAny>,
    scores: Scores,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Scores {
    route_completion: f64,
    neuro_ncap: NeuroNcap,
    alpasim: AlpaSim,
    pdm: Option<Pdm>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct NeuroNcap {
    score: f64,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct AlpaSim {
    collision_at_fault: bool,
    offroad: Option<bool>,
    passed: bool,
    score: f64,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Pdm {
    no_at_fault_collisions: f64,
    drivable_area_compliance: f64,
    driving_direction_compliance: f64,
    traffic_light_compliance: f64,
    ego_progress: f64,
    time_to_collision_within_bound: f64,
    lane_keeping: f64,
    history_comfort: f64,
    pdms: f64,
    epdms: f64,
}

/// Column of shares or of scores.
#[derive(Clone, Copy)]
enum Column {
    /// Shares of rollouts, in percent.
    Share(fn(&Scored) -> Option<bool>),
    /// Means, times a factor, with a number of digits.
    Score(fn(&Scored) -> Option<f64>, f64, usize),
}

/// Columns of the table.
const COLUMNS: [(&str, Column); 17] = [
    ("collisions (%)", Column::Share(|s| Some(s.collision))),
    ("at fault (%)", Column::Share(|s| Some(s.scores.alpasim.collision_at_fault))),
    ("off road (%)", Column::Share(|s| s.scores.alpasim.offroad)),
    ("NeuroNCAP", Column::Score(|s| Some(s.scores.neuro_ncap.score), 1.0, 2)),
    ("route completion (%)", Column::Score(|s| Some(s.scores.route_completion), 100.0, 1)),
    ("AlpaSim pass (%)", Column::Share(|s| Some(s.scores.alpasim.passed))),
    ("AlpaSim score", Column::Score(|s| Some(s.scores.alpasim.score), 1.0, 3)),
    ("PDMS", Column::Score(|s| Some(pdm(s)?.pdms), 100.0, 1)),
    ("EPDMS", Column::Score(|s| Some(pdm(s)?.epdms), 100.0, 1)),
    ("NC", Column::Score(|s| Some(pdm(s)?.no_at_fault_collisions), 100.0, 1)),
    ("DAC", Column::Score(|s| Some(pdm(s)?.drivable_area_compliance), 100.0, 1)),
    ("DDC", Column::Score(|s| Some(pdm(s)?.driving_direction_compliance), 100.0, 1)),
    ("TLC", Column::Score(|s| Some(pdm(s)?.traffic_light_compliance), 100.0, 1)),
    ("EP", Column::Score(|s| Some(pdm(s)?.ego_progress), 100.0, 1)),
    ("TTC", Column::Score(|s| Some(pdm(s)?.time_to_collision_within_bound), 100.0, 1)),
    ("LK", Column::Score(|s| Some(pdm(s)?.lane_keeping), 100.0, 1)),
    ("HC", Column::Score(|s| Some(pdm(s)?.history_comfort), 100.0, 1)),
];

fn pdm(scored: &Scored) -> Option<&Pdm> {
    scored.scores.pdm.as_ref()
}

impl Column {
    fn interval(self, rollouts: &[&Scored]) -> Option<Interval> {
        match self {
            Self::Share(value) => {
                share_interval(&rollouts.iter().filter_map(|s| value(s)).collect::<Vec<bool>>())
            }
            Self::Score(value, ..) => {
                score_interval(&rollouts.iter().filter_map(|s| value(s)).collect::<Vec<f64>>())
            }
        }
    }

    fn cell(self, interval: Option<Interval>) -> String {
        match self {
            Self::Share(_) => range(interval.map(|interval| interval.scaled(100.0)), 1),
            Self::Score(_, factor, digits) => range(interval.map(|interval| interval.scaled(factor)), digits),
        }
    }
}

/// Returns the rollouts of a log: `seconds` long, `every_s` apart, all within the log except the first one if
/// the log is shorter.
pub fn scenario_clips(log: &Recording, rates: Rates, seconds: f64, every_s: f64) -> Vec<Clip> {
    let Some((first, last)) = log.frames.first().zip(log.frames.last()) else { return Vec::new() };
    let duration_us = (seconds * 1e6).round() as i64;
    let clip = |number: usize| {
        let start_s = number as f64 * every_s;
        Clip {
            name: format!("{}-{start_s:05.1}s", log.name),
            start_us: first.t_us + (start_s * 1e6).round() as i64,
            clock: ClipClock::Rates(rates),
            frames: (seconds * rates.plan_hz).round() as usize + 1,
        }
    };
    let fits = |clip: &Clip| clip.start_us == first.t_us || clip.start_us + duration_us <= last.t_us;
    (0..).map(clip).take_while(fits).collect()
}

impl ScenarioReport {
    /// Reads the scores of finished rollouts.
    ///
    /// # Errors
    /// Fails if the metrics of a rollout cannot be read, or if a step of it failed.
    pub fn read(method: &str, rollouts: &[ScenarioRollout]) -> Result<Self, FileError> {
        let rollouts = rollouts.iter().map(Scored::read).collect::<Result<Vec<_>, _>>()?;
        let mut names: Vec<&str> = Vec::new();
        for scored in &rollouts {
            if !names.contains(&scored.rollout.family.as_str()) {
                names.push(&scored.rollout.family);
            }
        }
        let family = |name: &str, members: Vec<&Scored>| Family {
            name: name.to_owned(),
            rollouts: members.len(),
            scores: COLUMNS.iter().map(|(title, column)| (*title, column.interval(&members))).collect(),
        };
        let of = |name: &&str| family(name, rollouts.iter().filter(|s| s.rollout.family == **name).collect());
        let mut families: Vec<Family> = names.iter().map(of).collect();
        if families.len() > 1 {
            families.push(family(ALL, rollouts.iter().collect()));
        }
        Ok(Self { method: method.to_owned(), families, rollouts })
    }

    /// Formats a row per family as Markdown, with means and 95 % confidence intervals over rollouts.
    pub fn table(&self) -> String {
        let titles = ["scenarios", "rollouts"].into_iter().chain(COLUMNS.map(|(title, _)| title));
        let header: Vec<String> = titles.map(str::to_owned).collect();
        let row = |family: &Family| {
            let cells = COLUMNS.iter().zip(&family.scores);
            let cells = cells.map(|((_, column), (_, interval))| column.cell(*interval));
            [family.name.clone(), family.rollouts.to_string()].into_iter().chain(cells).collect()
        };
        let cells: Vec<Vec<String>> = std::iter::once(header).chain(self.families.iter().map(row)).collect();
        let note = "Means with 95 % confidence intervals: Wilson's of shares, of scores by the bootstrap.";
        markdown(&cells) + &format!("\nMethod {}. {note}\n", self.method)
    }
}

impl Scored {
    fn read(rollout: &ScenarioRollout) -> Result<Self, FileError> {
        let path = rollout.folder.join(METRICS);
        let Metrics { failure, collisions, scores } = json::read(&path, "metrics of a rollout with scores")?;
        if let Some(failure) = failure {
            return Err(FileError::content("a rollout without a failure", failure, &path));
        }
        Ok(Self { rollout: rollout.clone(), collision: !collisions.is_empty(), scores })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use std::path::Path;

    fn write(folder: &Path, ncap: f64, passed: bool, epdms: Option<f64>) {
        let pdm = epdms.map(|epdms| {
            json!({"windows": 3, "no_at_fault_collisions": 1.0, "drivable_area_compliance": 1.0,
                   "driving_direction_compliance": 1.0, "traffic_light_compliance": 1.0, "ego_progress": 0.5,
                   "time_to_collision_within_bound": 1.0, "lane_keeping": 1.0, "history_comfort": 1.0,
                   "comfort": 1.0, "two_frame_extended_comfort": null, "pdms": 0.9, "epdms": epdms})
        });
        let collisions = if passed { json!([]) } else { json!([{"step": 3}]) };
        let alpasim = json!({"collision_at_fault": !passed, "offroad": null, "passed": passed,
                             "score": f64::from(u8::from(passed)), "wrong_lane": null});
        let scores =
            json!({"route_completion": 0.5, "neuro_ncap": {"score": ncap}, "alpasim": alpasim, "pdm": pdm});
        let metrics = json!({"ended": "steps", "failure": null, "collisions": collisions, "scores": scores});
        std::fs::create_dir_all(folder).unwrap();
        std::fs::write(folder.join(METRICS), metrics.to_string()).unwrap();
    }

    fn rollout(root: &Path, family: &str, number: usize) -> ScenarioRollout {
        let folder = root.join(format!("{family}{number}"));
        ScenarioRollout {
            log: "log".into(),
            change: format!("{family}{number}"),
            family: family.into(),
            folder,
        }
    }

    #[test]
    fn families_have_rows_with_intervals() {
        let folder = tempfile::tempdir().unwrap();
        let rollouts =
            [("frontal", 0), ("frontal", 1), ("side", 0)].map(|(f, n)| rollout(folder.path(), f, n));
        write(&rollouts[0].folder, 5.0, true, Some(0.8));
        write(&rollouts[1].folder, 2.0, false, None);
        write(&rollouts[2].folder, 5.0, true, Some(0.6));
        let report = ScenarioReport::read("planner", &rollouts).unwrap();
        let table = report.table();
        let lines: Vec<&str> = table.lines().collect();
        let half = "50.0 [9.5, 90.5]";
        let frontal =
            format!("| frontal | 2 | {half} | {half} | - | 3.50 [2.00, 5.00] | 50.0 [50.0, 50.0] |");
        assert!(lines[2].starts_with(&frontal), "{table}");
        assert!(lines[2].contains("| 90.0 [90.0, 90.0] | 80.0 [80.0, 80.0] |"), "{table}");
        assert!(lines[4].starts_with("| all | 3 | 33.3 ["), "{table}");
        assert_eq!(lines.len(), 7);
        // A single family has no row of all.
        let side = ScenarioReport::read("planner", &rollouts[2..]).unwrap();
        assert_eq!(side.table().lines().count(), 5);
    }

    #[test]
    fn failed_rollouts_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let rollout = rollout(folder.path(), "side", 0);
        write(&rollout.folder, 5.0, true, None);
        let path = rollout.folder.join(METRICS);
        let text =
            std::fs::read_to_string(&path).unwrap().replace("\"failure\":null", "\"failure\":\"no plan\"");
        std::fs::write(&path, text).unwrap();
        let error = ScenarioReport::read("planner", &[rollout]).unwrap_err().to_string();
        assert!(error.starts_with("expected a rollout without a failure, found no plan"), "{error}");
    }
}
