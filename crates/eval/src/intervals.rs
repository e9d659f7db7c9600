//! Confidence intervals over many rollouts.
//!
//! Shares (collisions, passes) have Wilson's interval (1927), which stays within 0 and 1 and has a width even
//! where no rollout or every one counts. Scores, bounded and far from normal, have the percentile interval of
//! the bootstrap (Efron, 1979). Both are asymmetric, unlike [`mean_interval`](crate::mean_interval).

use rand_chacha::ChaCha8Rng;
use rand_core::Rng as _;
use rand_seeder::Seeder;
use serde::{Deserialize, Serialize};

/// 97.5 % quantile of the normal distribution.
const Z: f64 = 1.959_963_984_540_054;
/// Number of resamples.
const RESAMPLES: usize = 2000;

/// Mean or share of values, and its 95 % confidence interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Number of values.
    pub count: usize,
    /// Mean or share.
    pub mean: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

impl Interval {
    /// Returns the interval in another unit.
    pub(crate) fn scaled(self, factor: f64) -> Self {
        Self { mean: factor * self.mean, low: factor * self.low, high: factor * self.high, ..self }
    }
}

/// Computes a share by Wilson's score interval; `None` of no values.
pub fn share_interval(values: &[bool]) -> Option<Interval> {
    let count = values.len();
    if count == 0 {
        return None;
    }
    let n = count as f64;
    let mean = values.iter().filter(|value| **value).count() as f64 / n;
    let center = (mean + Z * Z / (2.0 * n)) / (1.0 + Z * Z / n);
    let half = Z / (1.0 + Z * Z / n) * (mean * (1.0 - mean) / n + Z * Z / (4.0 * n * n)).sqrt();
    // Rounding must not exclude a share of 0 or 1.
    let (low, high) = ((center - half).clamp(0.0, mean), (center + half).clamp(mean, 1.0));
    Some(Interval { count, mean, low, high })
}

/// Computes a mean by the percentile bootstrap with a fixed seed; `None` of no values. Values are resampled
/// independently, `RESAMPLES` times.
pub fn score_interval(values: &[f64]) -> Option<Interval> {
    let count = values.len();
    if count == 0 {
        return None;
    }
    let mean = |sum: f64| sum / count as f64;
    let mut random: ChaCha8Rng = Seeder::from("bootstrap").into_rng();
    let mut draw = || values[((u128::from(random.next_u64()) * count as u128) >> 64) as usize];
    let mut means: Vec<f64> = (0..RESAMPLES).map(|_| mean((0..count).map(|_| draw()).sum::<f64>())).collect();
    means.sort_by(f64::total_cmp);
    let cut = RESAMPLES / 40; // 2.5 %
    let (low, high) = (means[cut], means[RESAMPLES - 1 - cut]);
    Some(Interval { count, mean: mean(values.iter().sum()), low, high })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_match_wilson() {
        // scipy.stats.binomtest(3, 10).proportion_ci(method="wilson")
        let values: Vec<bool> = (0..10).map(|i| i < 3).collect();
        let found = share_interval(&values).unwrap();
        assert!(
            (found.low - 0.107_791_3).abs() < 1e-6 && (found.high - 0.603_221_9).abs() < 1e-6,
            "{found:?}"
        );
        // Without a hit, the upper end is z² / (n + z²).
        let none = share_interval(&[false; 20]).unwrap();
        assert!(none.low == 0.0 && (none.high - Z * Z / (20.0 + Z * Z)).abs() < 1e-12);
        assert_eq!(share_interval(&[]), None);
    }

    #[test]
    fn means_have_bootstrap_intervals() {
        let same = score_interval(&[2.5; 7]).unwrap();
        assert_eq!(same, Interval { count: 7, mean: 2.5, low: 2.5, high: 2.5 });
        // Of 0 and 1 in equal shares, the standard error is 0.5 / sqrt(n): the interval is about 1.96 of
        // them.
        let values: Vec<f64> = (0..400).map(|i| f64::from(i % 2)).collect();
        let found = score_interval(&values).unwrap();
        assert!((found.low - 0.451).abs() < 0.004 && (found.high - 0.549).abs() < 0.004, "{found:?}");
        assert_eq!(score_interval(&values), Some(found));
        assert_eq!(score_interval(&[]), None);
    }
}
