//! Comfort of NAVSIM: bounds of filtered accelerations, jerks and yaw rates.

use glam::DVec2;

use super::state::{PdmState, STEP_S};
use crate::REAR_AXLE_TO_CENTER_M;

/// Bounds of the longitudinal acceleration, meters per second squared.
const LONGITUDINAL_MPS2: [f64; 2] = [-4.05, 2.40];
/// Bounds of magnitudes: lateral acceleration in m/s², jerk and longitudinal jerk in m/s³, yaw rate in rad/s,
/// yaw acceleration in rad/s².
const LATERAL_MPS2: f64 = 4.89;
const JERK_MPS3: f64 = 8.37;
const LONGITUDINAL_JERK_MPS3: f64 = 4.13;
const YAW_RATE_RADPS: f64 = 0.95;
const YAW_ACCELERATION_RADPS2: f64 = 1.93;
/// Bounds of the root mean squares of the differences between two plans, in the same units: acceleration,
/// jerk, yaw rate, yaw acceleration.
const TWO_FRAME_BOUNDS: [f64; 4] = [0.7, 0.5, 0.1, 0.1];
/// Window lengths of the filters of accelerations, jerks, and yaw rates.
const ACCELERATION_WINDOW: usize = 8;
const JERK_WINDOW: usize = 15;
const YAW_WINDOW: usize = 5;

/// Filter of a value over time: a polynomial of a degree is fitted to a window, and a derivative is
/// evaluated.
#[derive(Clone, Copy, Debug)]
struct Filter {
    window: usize,
    degree: usize,
    derivative: usize,
}

/// Returns whether states, [`STEP_S`] apart, are comfortable. Source: NAVSIM's `ego_is_comfortable`, with
/// nuPlan's bounds.
pub(super) fn is_comfortable(states: &[PdmState]) -> bool {
    let centers: Vec<DVec2> = states.iter().map(center_acceleration).collect();
    let longitudinal = accelerations(centers.iter().map(|a| a.x));
    let lateral = accelerations(centers.iter().map(|a| a.y));
    let within =
        |values: &[f64], [min, max]: [f64; 2]| values.iter().all(|value| *value > min && *value < max);
    let below = |values: &[f64], max: f64| within(values, [-max, max]);
    within(&longitudinal, LONGITUDINAL_MPS2)
        && below(&lateral, LATERAL_MPS2)
        && below(&jerks(&magnitudes(states)), JERK_MPS3)
        && below(&jerks(&longitudinal), LONGITUDINAL_JERK_MPS3)
        && below(&yaw_rates(states, 2, 3), YAW_ACCELERATION_RADPS2)
        && below(&yaw_rates(states, 1, 2), YAW_RATE_RADPS)
}

/// Returns whether two plans over the same time hardly differ in acceleration, jerk, yaw rate and yaw
/// acceleration. Source: NAVSIM's `ego_is_two_frame_extended_comfort`.
pub(super) fn is_consistent(states: &[PdmState], other: &[PdmState]) -> bool {
    let features = |states: &[PdmState]| {
        let acceleration = magnitudes(states);
        let jerk = jerks(&acceleration);
        [acceleration, jerk, yaw_rates(states, 1, 2), yaw_rates(states, 2, 2)]
    };
    let pairs = features(states).into_iter().zip(features(other)).zip(TWO_FRAME_BOUNDS);
    pairs.into_iter().all(|((a, b), bound)| {
        let squares: f64 = a.iter().zip(&b).map(|(a, b)| (a - b).powi(2)).sum();
        (squares / a.len() as f64).sqrt() <= bound
    })
}

/// Returns the acceleration at the center of the vehicle, with the signs of NAVSIM's
/// `get_acceleration_shifted`: both terms add along the displacement.
fn center_acceleration(state: &PdmState) -> DVec2 {
    let along = REAR_AXLE_TO_CENTER_M * (state.yaw_rate_radps.powi(2) + state.yaw_acceleration_radps2);
    state.acceleration_mps2 + DVec2::new(along, 0.0)
}

fn magnitudes(states: &[PdmState]) -> Vec<f64> {
    accelerations(states.iter().map(|state| state.acceleration_mps2.length()))
}

fn accelerations(values: impl Iterator<Item = f64>) -> Vec<f64> {
    Filter { window: ACCELERATION_WINDOW, degree: 2, derivative: 0 }.apply(&values.collect::<Vec<_>>())
}

fn jerks(accelerations: &[f64]) -> Vec<f64> {
    Filter { window: JERK_WINDOW, degree: 2, derivative: 1 }.apply(accelerations)
}

/// Returns a derivative of the yaw.
fn yaw_rates(states: &[PdmState], derivative: usize, degree: usize) -> Vec<f64> {
    let mut turns = 0.0;
    let mut unwrapped: Vec<f64> = Vec::with_capacity(states.len());
    for (index, state) in states.iter().enumerate() {
        if index > 0 {
            let step = (state.heading_rad - states[index - 1].heading_rad) / std::f64::consts::TAU;
            turns += step.round_ties_even();
        }
        unwrapped.push(state.heading_rad - std::f64::consts::TAU * turns);
    }
    Filter { window: YAW_WINDOW, degree, derivative }.apply(&unwrapped)
}

impl Filter {
    /// Filters values as SciPy's `savgol_filter` does by default, and rounds to eight decimals. Windows of
    /// even length are evaluated at their middle, half a step late; near both ends the first and last window
    /// count.
    fn apply(self, values: &[f64]) -> Vec<f64> {
        let count = values.len();
        let window = self.window.min(count);
        let half = window / 2;
        let at = |index: usize| {
            let (start, place) = if index < half {
                (0, index as f64)
            } else if index + half >= count {
                (count - window, (index + window - count) as f64)
            } else {
                (index - half + usize::from(window.is_multiple_of(2)), (window - 1) as f64 / 2.0)
            };
            let fitted = self.fitted(&values[start..start + window], place);
            (fitted * 1e8).round_ties_even() / 1e8
        };
        (0..count).map(at).collect()
    }

    /// Fits the polynomial and evaluates its derivative at a place, in steps from the first value.
    fn fitted(self, values: &[f64], place: f64) -> f64 {
        let middle = (values.len() - 1) as f64 / 2.0;
        let terms = self.degree + 1;
        // Normal equations of the powers of the distance from the middle.
        let mut rows = vec![vec![0.0; terms + 1]; terms];
        for (index, value) in values.iter().enumerate() {
            let x = index as f64 - middle;
            for (i, row) in rows.iter_mut().enumerate() {
                for (j, cell) in row.iter_mut().enumerate() {
                    let other = if j < terms { x.powi(j as i32) } else { *value };
                    *cell += x.powi(i as i32) * other;
                }
            }
        }
        let coefficients = solved(rows);
        let x = place - middle;
        let derived = |(power, coefficient): (usize, &f64)| {
            let factor: f64 = (0..self.derivative).map(|k| (power - k) as f64).product();
            coefficient * factor * x.powi((power - self.derivative) as i32)
        };
        let sum: f64 = coefficients.iter().enumerate().skip(self.derivative).map(derived).sum();
        sum / STEP_S.powi(self.derivative as i32)
    }
}

/// Solves a small positive definite system whose rows end with the right side (Gauss).
fn solved(mut rows: Vec<Vec<f64>>) -> Vec<f64> {
    let count = rows.len();
    for pivot in 0..count {
        let (above, below) = rows.split_at_mut(pivot + 1);
        let top = &above[pivot];
        for row in below {
            let factor = row[pivot] / top[pivot];
            row.iter_mut().zip(top).for_each(|(cell, other)| *cell -= factor * other);
        }
    }
    let mut solution = vec![0.0; count];
    for row in (0..count).rev() {
        let known: f64 = (row + 1..count).map(|column| rows[row][column] * solution[column]).sum();
        solution[row] = (rows[row][count] - known) / rows[row][row];
    }
    solution
}

#[cfg(test)]
mod tests {
    use super::*;

    fn states(count: usize, state: impl Fn(f64) -> PdmState) -> Vec<PdmState> {
        (0..count).map(|i| state(i as f64 * STEP_S)).collect()
    }

    #[test]
    fn filters_match_scipy() {
        // scipy.signal.savgol_filter([0, 1, 4, 9, 16, 25, 36, 49, 64, 81], 8, 2), rounded to 8 decimals.
        let squares: Vec<f64> = (0..10).map(|i| f64::from(i * i)).collect();
        let found = Filter { window: 8, degree: 2, derivative: 0 }.apply(&squares);
        assert_eq!(found, [0.0, 1.0, 4.0, 9.0, 20.25, 30.25, 36.0, 49.0, 64.0, 81.0]);
        let found = Filter { window: 5, degree: 2, derivative: 1 }.apply(&squares);
        assert_eq!(found, [0.0, 20.0, 40.0, 60.0, 80.0, 100.0, 120.0, 140.0, 160.0, 180.0]);
        // scipy.signal.savgol_filter([0, 1, 0, 0, 2, 0, 1], 5, 3, deriv=2, delta=0.1)
        let found =
            Filter { window: 5, degree: 3, derivative: 2 }.apply(&[0.0, 1.0, 0.0, 0.0, 2.0, 0.0, 1.0]);
        let second = |w: [f64; 5], v: [f64; 5]| w.iter().zip(v).map(|(a, b)| a * b).sum::<f64>() / 7.0 / 0.01;
        assert!((found[2] - second([2.0, -1.0, -2.0, -1.0, 2.0], [0.0, 1.0, 0.0, 0.0, 2.0])).abs() < 1e-6);
    }

    #[test]
    fn each_bound_applies() {
        let longitudinal = |a: f64| {
            states(41, |_| PdmState { acceleration_mps2: DVec2::new(a, 0.0), ..PdmState::default() })
        };
        for (a, expected) in [(2.39, true), (2.41, false), (-4.04, true), (-4.06, false)] {
            assert_eq!(is_comfortable(&longitudinal(a)), expected, "{a}");
        }
        let lateral = |a: f64| {
            states(41, |_| PdmState { acceleration_mps2: DVec2::new(0.0, a), ..PdmState::default() })
        };
        assert!(is_comfortable(&lateral(4.88)) && !is_comfortable(&lateral(-4.9)));
        let jerk = |j: f64| {
            states(41, |t| PdmState {
                acceleration_mps2: DVec2::new(j * t - 2.0, 0.0),
                ..PdmState::default()
            })
        };
        assert!(is_comfortable(&jerk(1.0)) && !is_comfortable(&jerk(4.2)));
        let turning = |rate: f64| {
            states(41, |t| PdmState {
                heading_rad: super::super::state::principal(rate * t),
                ..PdmState::default()
            })
        };
        assert!(is_comfortable(&turning(0.94)) && !is_comfortable(&turning(-0.96)));
        let swerving = |a: f64| {
            states(41, |t| PdmState {
                heading_rad: a * (t - 0.2).max(0.0).powi(2).min(0.01) / 2.0,
                ..PdmState::default()
            })
        };
        assert!(is_comfortable(&swerving(1.0)) && !is_comfortable(&swerving(20.0)));
    }

    #[test]
    fn plans_that_differ_are_inconsistent() {
        let plan = |a: f64| {
            states(36, |_| PdmState { acceleration_mps2: DVec2::new(a, 0.0), ..PdmState::default() })
        };
        assert!(is_consistent(&plan(1.0), &plan(1.69)) && !is_consistent(&plan(1.0), &plan(1.71)));
        let turning = |rate: f64| states(36, |t| PdmState { heading_rad: rate * t, ..PdmState::default() });
        assert!(
            is_consistent(&turning(0.3), &turning(0.39)) && !is_consistent(&turning(0.3), &turning(0.41))
        );
    }
}
