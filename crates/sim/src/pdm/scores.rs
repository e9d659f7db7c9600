//! Scores of a plan and their weighted means.

use serde::Serialize;

use super::comfort::is_consistent;
use super::score::Parts;
use super::state::PdmState;

/// Weights of the means. Sources: NAVSIM 0a380a9 (EPDMS), and the paper of NAVSIM, equation 1 (PDMS).
const PROGRESS: f64 = 5.0;
const TIME_TO_COLLISION: f64 = 5.0;
const COMFORT: f64 = 2.0;
const LANE_KEEPING: f64 = 2.0;

/// Sub-scores and scores of a plan, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PdmScores {
    /// No at-fault collision: 0 after one with a road user, 0.5 after one with an object.
    pub no_at_fault_collisions: f64,
    /// Whether all corners stay on roads, intersections and car parks.
    pub drivable_area_compliance: f64,
    /// 0.5 and 0 from 2 and 6 m off the lanes of the route within 1 s.
    pub driving_direction_compliance: f64,
    /// Whether no lane connector of the route is touched while its light is red.
    pub traffic_light_compliance: f64,
    /// Progress along the route, relative to the best of this plan and PDM-Closed.
    pub ego_progress: f64,
    /// Whether no contact would follow within 0.9 s at constant velocity.
    pub time_to_collision_within_bound: f64,
    /// Whether the ego is never more than 0.5 m beside the center line for 2 s.
    pub lane_keeping: f64,
    /// Whether the past 1.5 s and the drive are comfortable.
    pub history_comfort: f64,
    /// Whether the drive alone is comfortable; part of [`Self::pdms`] only.
    pub comfort: f64,
    /// Whether the drive hardly differs from the previous plan's; `None` without one.
    pub two_frame_extended_comfort: Option<f64>,
    /// PDM score: no collision × drivable area × mean of progress (5), time to collision (5) and comfort (2).
    pub pdms: f64,
    /// Extended PDM score: the product of the first four sub-scores and the mean of progress (5), time to
    /// collision (5), lane keeping (2), history comfort (2) and two-frame comfort (2, if known).
    pub epdms: f64,
}

/// Scores of a plan, and the states that were scored.
#[derive(Clone, Debug, PartialEq)]
pub struct PdmResult {
    /// Scores without two-frame comfort.
    pub scores: PdmScores,
    /// States of the ego, 41 at 10 Hz.
    pub states: Vec<PdmState>,
}

impl PdmScores {
    /// Combines the sub-scores.
    pub(super) fn of(parts: &Parts, progress: f64, history_comfort: bool, comfort: bool) -> Self {
        let flag = |flag: bool| f64::from(u8::from(flag));
        Self {
            no_at_fault_collisions: parts.no_at_fault_collisions,
            drivable_area_compliance: parts.drivable_area,
            driving_direction_compliance: parts.driving_direction,
            traffic_light_compliance: parts.traffic_light,
            ego_progress: progress,
            time_to_collision_within_bound: parts.time_to_collision,
            lane_keeping: parts.lane_keeping,
            history_comfort: flag(history_comfort),
            comfort: flag(comfort),
            two_frame_extended_comfort: None,
            pdms: 0.0,
            epdms: 0.0,
        }
        .combined()
    }

    /// Returns the mean of all scores, without two-frame comfort; `None` of none.
    pub(super) fn mean(all: &[Self]) -> Option<Self> {
        let mean = |value: fn(&Self) -> f64| all.iter().map(value).sum::<f64>() / all.len() as f64;
        (!all.is_empty()).then(|| Self {
            no_at_fault_collisions: mean(|s| s.no_at_fault_collisions),
            drivable_area_compliance: mean(|s| s.drivable_area_compliance),
            driving_direction_compliance: mean(|s| s.driving_direction_compliance),
            traffic_light_compliance: mean(|s| s.traffic_light_compliance),
            ego_progress: mean(|s| s.ego_progress),
            time_to_collision_within_bound: mean(|s| s.time_to_collision_within_bound),
            lane_keeping: mean(|s| s.lane_keeping),
            history_comfort: mean(|s| s.history_comfort),
            comfort: mean(|s| s.comfort),
            two_frame_extended_comfort: None,
            pdms: mean(|s| s.pdms),
            epdms: mean(|s| s.epdms),
        })
    }

    /// Returns the scores with both means computed anew.
    pub(super) fn combined(self) -> Self {
        let safe = self.no_at_fault_collisions * self.drivable_area_compliance;
        let common = PROGRESS * self.ego_progress + TIME_TO_COLLISION * self.time_to_collision_within_bound;
        let weights = PROGRESS + TIME_TO_COLLISION;
        let pdms = safe * (common + COMFORT * self.comfort) / (weights + COMFORT);
        let extended = common + LANE_KEEPING * self.lane_keeping + COMFORT * self.history_comfort;
        let weights = weights + LANE_KEEPING + COMFORT;
        let mean = match self.two_frame_extended_comfort {
            Some(comfort) => (extended + COMFORT * comfort) / (weights + COMFORT),
            None => extended / weights,
        };
        let penalty = safe * self.traffic_light_compliance * self.driving_direction_compliance;
        Self { pdms, epdms: penalty * mean, ..self }
    }

    /// Returns the scores without penalties for what the recorded driver did, too: its sub-scores of 0 count
    /// as 1 here. Source: NAVSIM's `human_penalty_filter`. Progress is never 0 for the recorded driver, and
    /// its comfort is not compared, as in NAVSIM.
    #[must_use]
    pub fn forgiven(self, recorded: &Self) -> Self {
        let forgiven = |own: f64, recorded: f64| if recorded == 0.0 { 1.0 } else { own };
        Self {
            no_at_fault_collisions: forgiven(self.no_at_fault_collisions, recorded.no_at_fault_collisions),
            drivable_area_compliance: forgiven(
                self.drivable_area_compliance,
                recorded.drivable_area_compliance,
            ),
            driving_direction_compliance: forgiven(
                self.driving_direction_compliance,
                recorded.driving_direction_compliance,
            ),
            traffic_light_compliance: forgiven(
                self.traffic_light_compliance,
                recorded.traffic_light_compliance,
            ),
            time_to_collision_within_bound: forgiven(
                self.time_to_collision_within_bound,
                recorded.time_to_collision_within_bound,
            ),
            lane_keeping: forgiven(self.lane_keeping, recorded.lane_keeping),
            ..self
        }
        .combined()
    }
}

impl PdmResult {
    /// Returns the scores with the comfort between this plan and one that began `samples` (tenths of a
    /// second) earlier; without it if they do not overlap.
    pub fn after(&self, earlier: &Self, samples: usize) -> PdmScores {
        let overlap = self.states.len().saturating_sub(samples);
        let two_frame_extended_comfort = (overlap > 1).then(|| {
            let same_time = (&self.states[..overlap], &earlier.states[samples..]);
            f64::from(u8::from(is_consistent(same_time.0, same_time.1)))
        });
        PdmScores { two_frame_extended_comfort, ..self.scores }.combined()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scores_are_weighted_means() {
        let parts = Parts {
            no_at_fault_collisions: 0.5,
            drivable_area: 1.0,
            driving_direction: 0.5,
            traffic_light: 1.0,
            progress_m: 3.0,
            time_to_collision: 1.0,
            lane_keeping: 0.0,
        };
        let scores = PdmScores::of(&parts, 0.8, true, false);
        assert!((scores.pdms - 0.5 * (4.0 + 5.0) / 12.0).abs() < 1e-12);
        assert!((scores.epdms - 0.25 * (4.0 + 5.0 + 2.0) / 14.0).abs() < 1e-12);
        let with = PdmScores { two_frame_extended_comfort: Some(1.0), ..scores }.combined();
        assert!((with.epdms - 0.25 * (4.0 + 5.0 + 2.0 + 2.0) / 16.0).abs() < 1e-12);
        let recorded = PdmScores { lane_keeping: 0.0, driving_direction_compliance: 0.0, ..scores };
        let forgiven = scores.forgiven(&recorded);
        assert_eq!((forgiven.lane_keeping, forgiven.driving_direction_compliance), (1.0, 1.0));
        assert_eq!(forgiven.no_at_fault_collisions, 0.5);
        assert!((forgiven.epdms - 0.5 * (4.0 + 5.0 + 2.0 + 2.0) / 14.0).abs() < 1e-12);
    }
}
