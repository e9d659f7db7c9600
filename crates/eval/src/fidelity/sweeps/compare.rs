//! Sums over rays of a sweep and of the true one.

use std::collections::HashMap;

use glam::DVec3;
use serde::Serialize;

/// Distance of points that agree, meters.
const NEAR_M: f64 = 0.1;
/// Distance behind the plane of the true surface from which on a return is behind it, meters.
const BEHIND_M: f64 = 0.1;

/// Row of the table.
#[derive(Clone, Debug, Serialize)]
pub struct SweepRow {
    /// Ego pose relative to the recorded one, or device.
    pub sweep: String,
    /// Number of compared sweeps.
    pub sweeps: usize,
    /// Number of returns.
    pub returns: usize,
    /// Number of true returns.
    pub true_returns: usize,
    /// Median absolute difference of ranges where both have a return, meters; `None` without any.
    pub median_m: Option<f64>,
    /// Share of the returns within 10 cm of a true one.
    pub precision: Option<f64>,
    /// Share of the true returns within 10 cm of a return.
    pub recall: Option<f64>,
    /// Harmonic mean of both.
    pub f_score: Option<f64>,
    /// Share of the returns over 10 cm behind the true surface's plane, where that is known and opaque;
    /// `None` if it is nowhere.
    pub behind: Option<f64>,
}

/// A ray of both sweeps.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Ray {
    /// Meters, in the frame of the true sweep.
    pub(super) origin: DVec3,
    /// Unit direction.
    pub(super) direction: DVec3,
    pub(super) found_m: Option<f64>,
    pub(super) true_m: Option<f64>,
    /// Cosine of the angle between the ray and the normal of the true surface; `None` if it is unknown, or if
    /// the surface is glass.
    pub(super) facing: Option<f64>,
}

/// Sums over sweeps.
#[derive(Clone, Debug, Default)]
pub(super) struct Sums {
    sweeps: usize,
    errors: Vec<f64>,
    /// Numbers of returns: all, and those that agree, of both sweeps.
    found: [usize; 2],
    truth: [usize; 2],
    /// Number of returns of rays with a known surface, and of those behind it.
    behind: [usize; 2],
}

impl Sums {
    /// Adds the rays of a sweep.
    pub(super) fn add(&mut self, rays: &[Ray]) {
        let points = |range_m: fn(&Ray) -> Option<f64>| -> Vec<DVec3> {
            rays.iter().filter_map(|ray| Some(ray.origin + ray.direction * range_m(ray)?)).collect()
        };
        let (found, truth) = (points(|ray| ray.found_m), points(|ray| ray.true_m));
        self.sweeps += 1;
        self.found[0] += found.len();
        self.truth[0] += truth.len();
        self.found[1] += near(&found, &truth);
        self.truth[1] += near(&truth, &found);
        for ray in rays {
            let (Some(found_m), Some(true_m)) = (ray.found_m, ray.true_m) else { continue };
            self.errors.push((found_m - true_m).abs());
            if let Some(facing) = ray.facing {
                self.behind[0] += 1;
                self.behind[1] += usize::from((found_m - true_m) * facing > BEHIND_M);
            }
        }
    }

    /// Returns the sums over devices of the same sweeps.
    pub(super) fn of_all<'s>(devices: impl Iterator<Item = &'s Self>) -> Self {
        devices.fold(Self::default(), |mut all, device| {
            let pairs = [
                (&mut all.found, device.found),
                (&mut all.truth, device.truth),
                (&mut all.behind, device.behind),
            ];
            for (all, device) in pairs {
                (all[0], all[1]) = (all[0] + device[0], all[1] + device[1]);
            }
            all.sweeps = all.sweeps.max(device.sweeps);
            all.errors.extend(&device.errors);
            all
        })
    }

    /// Returns the row of the table.
    pub(super) fn row(mut self, sweep: String) -> SweepRow {
        let share = |[all, some]: [usize; 2]| (all > 0).then(|| some as f64 / all as f64);
        let (precision, recall) = (share(self.found), share(self.truth));
        let f_score =
            precision.zip(recall).map(|(p, r)| if p + r > 0.0 { 2.0 * p * r / (p + r) } else { 0.0 });
        let middle = self.errors.len() / 2;
        let median_m =
            (!self.errors.is_empty()).then(|| *self.errors.select_nth_unstable_by(middle, f64::total_cmp).1);
        SweepRow {
            sweep,
            sweeps: self.sweeps,
            returns: self.found[0],
            true_returns: self.truth[0],
            median_m,
            precision,
            recall,
            f_score,
            behind: share(self.behind),
        }
    }
}

/// Returns the number of points with another one within [`NEAR_M`].
fn near(points: &[DVec3], others: &[DVec3]) -> usize {
    let cell = |at: DVec3| (at / NEAR_M).floor().as_ivec3().to_array();
    let mut cells: HashMap<[i32; 3], Vec<DVec3>> = HashMap::new();
    others.iter().for_each(|at| cells.entry(cell(*at)).or_default().push(*at));
    let around: Vec<[i32; 3]> =
        (-1..=1).flat_map(|x| (-1..=1).flat_map(move |y| (-1..=1).map(move |z| [x, y, z]))).collect();
    let is_near = |at: &&DVec3| {
        let own = cell(**at);
        let near = around.iter().filter_map(|step| cells.get(&[0, 1, 2].map(|i| own[i] + step[i])));
        near.flatten().any(|other| other.distance(**at) <= NEAR_M)
    };
    points.iter().filter(is_near).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ray(y: f64, found_m: Option<f64>, true_m: Option<f64>, facing: Option<f64>) -> Ray {
        Ray { origin: DVec3::new(0.0, y, 0.0), direction: DVec3::X, found_m, true_m, facing }
    }

    /// Four rays a meter apart: 5 cm, 30 cm of slope 0.2, 30 cm behind a wall, and one that is missing.
    #[test]
    fn rows_are_sums_over_rays() {
        let mut sums = Sums::default();
        sums.add(&[
            ray(0.0, Some(10.05), Some(10.0), Some(1.0)),
            ray(1.0, Some(10.3), Some(10.0), Some(0.2)),
            ray(2.0, Some(10.3), Some(10.0), Some(1.0)),
            ray(3.0, None, Some(10.0), Some(1.0)),
        ]);
        let row = sums.row("a".into());
        assert_eq!((row.sweeps, row.returns, row.true_returns), (1, 3, 4));
        assert!((row.median_m.unwrap() - 0.3).abs() < 1e-9);
        assert_eq!((row.precision, row.recall, row.behind), (Some(1.0 / 3.0), Some(0.25), Some(1.0 / 3.0)));
        assert!((row.f_score.unwrap() - 2.0 / 7.0).abs() < 1e-12);
        let one = [ray(0.0, Some(10.05), Some(10.0), Some(1.0))];
        let [mut first, mut second] = [Sums::default(), Sums::default()];
        first.add(&one);
        second.add(&one);
        let all = Sums::of_all([first, second].iter()).row("all".into());
        assert_eq!((all.sweeps, all.returns, all.true_returns, all.precision), (1, 2, 2, Some(1.0)));
        let none = Sums::default().row("b".into());
        assert_eq!((none.median_m, none.f_score, none.behind), (None, None, None));
    }
}
