//! Speeds and curvatures of a sequence of poses, by regularized least squares.
//!
//! Both problems are solved by their normal equations, which are positive definite. NAVSIM uses a
//! pseudoinverse, with the same solution.

use glam::DVec2;

use super::state::STEP_S;

/// Weights of the accelerations, of the curvature rates, and of the first curvature.
const JERK_PENALTY: f64 = 1e-4;
const CURVATURE_RATE_PENALTY: f64 = 1e-2;
const CURVATURE_PENALTY: f64 = 1e-10;

/// Speeds (meters per second) and curvatures (1/m) at all poses but the last.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Profile {
    pub(super) speeds_mps: Vec<f64>,
    pub(super) curvatures: Vec<f64>,
}

impl Profile {
    /// Fits the profile to poses (x and y in meters, yaw in radians) that are [`STEP_S`] apart. Source:
    /// NAVSIM's `get_velocity_curvature_profiles_with_derivatives_from_poses`.
    pub(super) fn of(poses: &[(DVec2, f64)]) -> Self {
        let speeds_mps = speeds(poses);
        let curvatures = curvatures(poses, &speeds_mps);
        Self { speeds_mps, curvatures }
    }
}

/// Fits the first speed and the accelerations.
fn speeds(poses: &[(DVec2, f64)]) -> Vec<f64> {
    let count = poses.len().saturating_sub(1);
    // Displacements along the headings.
    let along: Vec<f64> =
        poses.windows(2).map(|pair| DVec2::from_angle(pair[0].1).dot(pair[1].0 - pair[0].0)).collect();
    let weight = |column: usize| if column == 0 { STEP_S } else { STEP_S * STEP_S };
    let mut matrix = Square::zeros(count);
    for (i, j) in matrix.places() {
        *matrix.at(i, j) = (count - i.max(j)) as f64 * weight(i) * weight(j);
    }
    // NAVSIM means differences of neighboring accelerations; its matrix has only the last one, and before it
    // the accelerations themselves.
    if count > 2 {
        (1..count).for_each(|i| *matrix.at(i, i) += JERK_PENALTY);
        *matrix.at(count - 2, count - 1) -= JERK_PENALTY;
        *matrix.at(count - 1, count - 2) -= JERK_PENALTY;
    }
    let right = (0..count).map(|column| weight(column) * along[column..].iter().sum::<f64>()).collect();
    integrated(&matrix.solved(right))
}

/// Fits the first curvature and the curvature rates to the turns between poses.
fn curvatures(poses: &[(DVec2, f64)], speeds_mps: &[f64]) -> Vec<f64> {
    let count = speeds_mps.len();
    let turns = poses.windows(2).map(|pair| {
        let turn = pair[1].1 - pair[0].1;
        turn.sin().atan2(turn.cos())
    });
    let turns: Vec<f64> = turns.collect();
    let weight = |row: usize, column: usize| match (row < column, column) {
        (true, _) => 0.0,
        (_, 0) => speeds_mps[row] * STEP_S,
        _ => speeds_mps[row] * STEP_S * STEP_S,
    };
    let mut matrix = Square::zeros(count);
    for (i, j) in matrix.places() {
        *matrix.at(i, j) = (i.max(j)..count).map(|row| weight(row, i) * weight(row, j)).sum();
    }
    for i in 0..count {
        *matrix.at(i, i) += if i == 0 { CURVATURE_PENALTY } else { CURVATURE_RATE_PENALTY };
    }
    let right = (0..count).map(|column| (column..count).map(|row| weight(row, column) * turns[row]).sum());
    integrated(&matrix.solved(right.collect()))
}

/// Integrates a first value and its rates.
fn integrated(values: &[f64]) -> Vec<f64> {
    let mut sum = 0.0;
    let first = values.first().copied().unwrap_or_default();
    let rates = values.iter().skip(1).map(|rate| {
        sum += rate * STEP_S;
        first + sum
    });
    std::iter::once(first).chain(rates).take(values.len()).collect()
}

/// Symmetric, positive definite matrix.
struct Square {
    size: usize,
    numbers: Vec<f64>,
}

impl Square {
    fn zeros(size: usize) -> Self {
        Self { size, numbers: vec![0.0; size * size] }
    }

    fn at(&mut self, row: usize, column: usize) -> &mut f64 {
        &mut self.numbers[row * self.size + column]
    }

    fn places(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let size = self.size;
        (0..size).flat_map(move |i| (0..size).map(move |j| (i, j)))
    }

    /// Returns the solution for a right side (Cholesky).
    fn solved(mut self, mut right: Vec<f64>) -> Vec<f64> {
        for i in 0..self.size {
            for j in 0..=i {
                let sum = *self.at(i, j) - (0..j).map(|k| *self.at(i, k) * *self.at(j, k)).sum::<f64>();
                *self.at(i, j) = if i == j { sum.sqrt() } else { sum / *self.at(j, j) };
            }
        }
        for i in 0..self.size {
            let sum: f64 = (0..i).map(|k| *self.at(i, k) * right[k]).sum();
            right[i] = (right[i] - sum) / *self.at(i, i);
        }
        for i in (0..self.size).rev() {
            let sum: f64 = (i + 1..self.size).map(|k| *self.at(k, i) * right[k]).sum();
            right[i] = (right[i] - sum) / *self.at(i, i);
        }
        right
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn even_motion_has_its_speed_and_curvature() {
        // Chords of a circle of 20 m radius at 5 m/s: along the heading they are shorter by their half angle.
        let turn = 5.0 * STEP_S / 20.0;
        let pose = |i: usize| {
            let (sin, cos) = (turn * i as f64).sin_cos();
            (DVec2::new(20.0 * sin, 20.0 * (1.0 - cos)), turn * i as f64)
        };
        let profile = Profile::of(&(0..41).map(pose).collect::<Vec<_>>());
        assert_eq!((profile.speeds_mps.len(), profile.curvatures.len()), (40, 40));
        let speed = 20.0 * turn.sin() / STEP_S;
        assert!(profile.speeds_mps.iter().all(|found| (found - speed).abs() < 1e-9));
        assert!(profile.curvatures.iter().all(|found| (found * speed - turn / STEP_S).abs() < 1e-6));
    }

    #[test]
    fn standing_has_no_curvature() {
        let profile = Profile::of(&[(DVec2::X, 0.3); 41]);
        assert!(profile.speeds_mps.iter().chain(&profile.curvatures).all(|value| value.abs() < 1e-12));
    }
}
