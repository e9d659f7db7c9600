//! Lane change of one lane to the right.
//!
//! # How it works
//! The recorded path from the takeover on is smoothed. The lateral offset from it moves from the ego's
//! position to one lane on the right, as a quintic in the station with zero slope and curvature at its end.
//! The resulting path has a continuous heading and curvature. The quintic spans the distance driven in 4 s,
//! but has a minimum length so that a slow ego does not turn sharply. Along this path the speed changes to 10
//! m/s within limits of acceleration and jerk.

use glam::DVec2;
use point_skeleton::geometry::{Polyline, wrap_angle};

use super::course::{Course, straight};
use super::profile::Profile;
use super::smooth::Smooth;
use crate::EgoState;
use crate::recorded::Recorded;

const SPEED_MPS: f64 = 10.0;
const ACCELERATION_MPS2: f64 = 1.5;
const JERK_MPS3: f64 = 2.0;
/// Final lateral offset to the left of the recorded path, meters.
const OFFSET_M: f64 = -3.5;
const CHANGE_S: f64 = 4.0;
/// Minimum length of a change: shorter ones would exceed comfortable turning at the speed reached by then.
const MIN_CHANGE_M: f64 = 32.0;
/// Point spacing of the ego's path, meters.
const STEP_M: f64 = 0.25;
/// Maximum angle between the recorded path and the ego's heading; beyond it (the log drives backward) the
/// path is not followed.
const MAX_TURN_RAD: f64 = 1.0;
/// Search window for the takeover on the recorded path, meters before and after.
const NEAR_M: f64 = 5.0;

/// Returns the course of an ego at the takeover; `None` if its pose is not finite.
pub(super) fn course(recorded: &Recorded<'_>, start_us: i64, ego: &EgoState) -> Option<Course> {
    let from = (ego.speed_mps, ego.acceleration_mps2);
    let profile = Profile::smooth(from, SPEED_MPS, ACCELERATION_MPS2, JERK_MPS3);
    let change_m = profile.at(CHANGE_S).travelled_m.max(MIN_CHANGE_M);
    let near_m = recorded.route.station_at(start_us);
    let recorded_line = recorded.route.line().filter(|line| leads_on(line, near_m, ego));
    let smooth = match recorded_line {
        Some(line) => {
            let projection = line.project(ego.position_m(), near_m - NEAR_M..near_m + NEAR_M);
            Smooth::new(line, projection.station_m, change_m + NEAR_M)
        }
        None => Smooth::new(&straight(ego.position_m(), ego.heading_rad())?, 0.0, change_m + NEAR_M),
    };
    let points = beside(&smooth, ego, change_m);
    let path = Polyline::new(points.iter().map(|(place, _)| *place))?;
    let headings_rad: Vec<f64> = points.iter().map(|(_, yaw)| *yaw).collect();
    (path.points().len() == headings_rad.len()).then_some(Course { start_us, path, headings_rad, profile })
}

/// Returns whether the recorded path continues from a station in the ego's direction.
fn leads_on(line: &Polyline, station_m: f64, ego: &EgoState) -> bool {
    let ahead_m = NEAR_M.min((line.length_m() - station_m).max(0.0));
    let (to, _) = line.at(station_m + ahead_m);
    let (from, direction) = line.at(station_m);
    let direction = if ahead_m > NEAR_M / 2.0 { to - from } else { direction };
    wrap_angle(direction.to_angle() - ego.heading_rad()).abs() < MAX_TURN_RAD
}

/// Returns the ego's path beside a smooth path: points with yaws, radians.
fn beside(smooth: &Smooth, ego: &EgoState, change_m: f64) -> Vec<(DVec2, f64)> {
    let start = smooth.at(0.0);
    let left = start.tangent.normalize_or(DVec2::X).perp();
    let offset_m = left.dot(ego.position_m() - start.position_m);
    let slope =
        wrap_angle(ego.heading_rad() - start.tangent.to_angle()).clamp(-MAX_TURN_RAD, MAX_TURN_RAD).tan();
    let count = (smooth.length_m() / STEP_M) as usize;
    let mut points: Vec<(DVec2, f64)> = Vec::with_capacity(count + 1);
    for i in 0..=count {
        let station_m = i as f64 * STEP_M;
        let place = smooth.at(station_m);
        let (d, d_slope) = quintic(offset_m, slope, OFFSET_M, change_m, station_m);
        let length = place.tangent.length();
        let left = place.tangent.normalize_or(DVec2::X).perp();
        // The path is shorter on the inner side of a bend; beyond the bend's center it would reverse.
        let along = (length * (1.0 - place.curvature * d)).max(0.1);
        let yaw = wrap_angle(place.tangent.to_angle() + d_slope.atan2(along));
        let point = place.position_m + left * d;
        let goes_on = |(last, _): &(DVec2, f64)| place.tangent.dot(point - *last) > STEP_M * 0.05;
        if points.last().is_none_or(goes_on) {
            points.push((point, yaw));
        }
    }
    points
}

/// Returns an offset and its slope at a station. The quintic leads from a value and slope with zero curvature
/// at 0 to a value with zero slope and curvature at `length_m`, and stays constant afterwards.
fn quintic(from: f64, slope: f64, to: f64, length_m: f64, station_m: f64) -> (f64, f64) {
    if station_m >= length_m {
        return (to, 0.0);
    }
    let u = station_m / length_m;
    let (step, rise) = (to - from, slope * length_m);
    let (c3, c4, c5) = (10.0 * step - 6.0 * rise, -15.0 * step + 8.0 * rise, 6.0 * step - 3.0 * rise);
    let value = from + u * (rise + u * u * (c3 + u * (c4 + u * c5)));
    let derivative = rise + u * u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5));
    (value, derivative / length_m)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quintic_meets_its_end_conditions() {
        let q = |s: f64| quintic(0.2, -0.1, -3.5, 40.0, s);
        let close = |found: (f64, f64), wanted: (f64, f64)| {
            assert!((found.0 - wanted.0).abs() < 1e-9 && (found.1 - wanted.1).abs() < 1e-9, "{found:?}");
        };
        close(q(0.0), (0.2, -0.1));
        close(q(40.0), (-3.5, 0.0));
        close(q(50.0), (-3.5, 0.0));
        let h = 1e-4;
        let bend = |s: f64| (q(s + h).1 - q(s).1) / h;
        assert!(bend(0.0).abs() < 1e-5 && bend(40.0 - 2.0 * h).abs() < 1e-5);
        for s in [3.0, 17.0, 31.0] {
            assert!(((q(s + h).0 - q(s - h).0) / (2.0 * h) - q(s).1).abs() < 1e-7);
        }
    }
}
