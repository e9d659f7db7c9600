//! Traffic lights: two phases per junction in a fixed cycle.

use super::{JunctionKind, Network, Signal};

/// Durations of green, yellow and all-red, seconds.
const GREEN_S: f64 = 10.0;
const YELLOW_S: f64 = 3.6;
const CLEAR_S: f64 = 2.0;
const PHASE_S: f64 = GREEN_S + YELLOW_S + CLEAR_S;
const CYCLE_S: f64 = 2.0 * PHASE_S;

impl Network {
    /// Returns the state of the traffic light for vehicles that approach a junction on a road, at a time in
    /// seconds. `None` without a traffic light.
    pub fn signal_at(&self, junction: usize, road: usize, t_s: f64) -> Option<Signal> {
        let at = self.signal_phase_s(junction, road, t_s)?;
        Some(match at {
            at if at < GREEN_S => Signal::Green,
            at if at < GREEN_S + YELLOW_S => Signal::Yellow,
            _ => Signal::Red,
        })
    }

    /// Returns how long the light remains red after a time, seconds; 0 if it is not red, `None` if absent.
    pub(super) fn red_for_s(&self, junction: usize, road: usize, t_s: f64) -> Option<f64> {
        let at = self.signal_phase_s(junction, road, t_s)?;
        Some(if at < GREEN_S + YELLOW_S { 0.0 } else { CYCLE_S - at })
    }

    /// Returns the seconds since the light turned green.
    fn signal_phase_s(&self, junction: usize, road: usize, t_s: f64) -> Option<f64> {
        let place = self.junctions.get(junction)?;
        if place.kind != JunctionKind::Signals {
            return None;
        }
        let [_, direction] = self.roads.get(road)?.mouth(junction)?;
        let [_, first] = self.roads.get(*place.roads().first()?)?.mouth(junction)?;
        let across = first.perp_dot(direction).abs() > std::f64::consts::FRAC_1_SQRT_2;
        // Shifts by the golden ratio, so that no two junctions are in phase.
        let shift_s = (junction as f64 * 0.618_034).fract() * CYCLE_S;
        let start_s = shift_s + if across { PHASE_S } else { 0.0 };
        Some((t_s - start_s).rem_euclid(CYCLE_S))
    }
}
