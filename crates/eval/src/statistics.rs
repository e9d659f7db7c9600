/// Mean of independent values, one per scene, and its 95 % confidence interval by Student's t.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct MeanInterval {
    /// Number of values.
    pub count: usize,
    /// Mean of the values.
    pub mean: f64,
    /// Half the length of the interval, which is `mean - half_width` to `mean + half_width`; `None` for a
    /// single value.
    pub half_width: Option<f64>,
}

impl MeanInterval {
    /// Returns the interval of values in another unit.
    pub(crate) fn scaled(self, factor: f64) -> Self {
        let half_width = self.half_width.map(|half_width| factor * half_width);
        Self { mean: factor * self.mean, half_width, ..self }
    }
}

/// Computes the mean of all finite values; `None` if there are none. The half width is `t·s/sqrt(n)`, with
/// the unbiased standard deviation s and the 97.5 % quantile t for n - 1 degrees of freedom.
pub fn mean_interval(values: &[f64]) -> Option<MeanInterval> {
    let values: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    let count = values.len();
    if count == 0 {
        return None;
    }
    let mean = values.iter().sum::<f64>() / count as f64;
    let half_width = (count > 1).then(|| {
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (count - 1) as f64;
        student_t(count - 1) * (variance / count as f64).sqrt()
    });
    Some(MeanInterval { count, mean, half_width })
}

/// Computes the mean of the differences `a - b` between values of the same scenes; skips pairs with a missing
/// value.
pub fn paired_difference(a: &[Option<f64>], b: &[Option<f64>]) -> Option<MeanInterval> {
    let differences: Vec<f64> = a.iter().zip(b).filter_map(|(a, b)| Some((*a)? - (*b)?)).collect();
    mean_interval(&differences)
}

/// 97.5 % quantiles of Student's t for 1 to 30 degrees of freedom.
const STUDENT_T: [f64; 30] = [
    12.706_204_736,
    4.302_652_730,
    3.182_446_305,
    2.776_445_105,
    2.570_581_836,
    2.446_911_851,
    2.364_624_252,
    2.306_004_135,
    2.262_157_163,
    2.228_138_852,
    2.200_985_160,
    2.178_812_830,
    2.160_368_656,
    2.144_786_688,
    2.131_449_546,
    2.119_905_299,
    2.109_815_578,
    2.100_922_040,
    2.093_024_054,
    2.085_963_447,
    2.079_613_845,
    2.073_873_068,
    2.068_657_610,
    2.063_898_562,
    2.059_538_553,
    2.055_529_439,
    2.051_830_516,
    2.048_407_142,
    2.045_229_642,
    2.042_272_456,
];

/// Returns the 97.5 % quantile of Student's t. Beyond the table it uses the expansion about the normal
/// quantile (M. Abramowitz, I. Stegun, *Handbook of Mathematical Functions*, 26.7.5), with an error below
/// 1e-6 there.
pub(super) fn student_t(degrees: usize) -> f64 {
    const Z: f64 = 1.959_963_984_540_054;
    if let Some(t) = degrees.checked_sub(1).and_then(|at| STUDENT_T.get(at)) {
        return *t;
    }
    let terms = [
        Z,
        (Z.powi(3) + Z) / 4.0,
        (5.0 * Z.powi(5) + 16.0 * Z.powi(3) + 3.0 * Z) / 96.0,
        (3.0 * Z.powi(7) + 19.0 * Z.powi(5) + 17.0 * Z.powi(3) - 15.0 * Z) / 384.0,
        (79.0 * Z.powi(9) + 776.0 * Z.powi(7) + 1482.0 * Z.powi(5) - 1920.0 * Z.powi(3) - 945.0 * Z)
            / 92160.0,
    ];
    terms.iter().rev().fold(0.0, |sum, term| sum / degrees as f64 + term)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn computes_confidence_intervals() {
        let interval = mean_interval(&[1.0, 2.0, 3.0, 4.0, f64::INFINITY]).unwrap();
        assert_eq!((interval.count, interval.mean), (4, 2.5));
        // The variance is 5/3, with three degrees of freedom.
        let expected = 3.182_446_305 * (5.0_f64 / 3.0 / 4.0).sqrt();
        assert!((interval.half_width.unwrap() - expected).abs() < 1e-12);
        assert_eq!(mean_interval(&[7.0]), Some(MeanInterval { count: 1, mean: 7.0, half_width: None }));
        assert_eq!(mean_interval(&[f64::NAN]), None);
        let a = [Some(3.0), Some(5.0), None, Some(9.0)];
        let b = [Some(1.0), Some(3.0), Some(4.0), Some(7.0)];
        let same = paired_difference(&a, &b).unwrap();
        assert_eq!(same, MeanInterval { count: 3, mean: 2.0, half_width: Some(0.0) });
    }

    #[test]
    fn quantiles_match_scipy_beyond_the_table() {
        // scipy.stats.t.ppf(0.975, n)
        for (degrees, expected) in [(31, 2.039_513_446), (60, 2.000_297_822), (1000, 1.962_339_081)] {
            assert!((student_t(degrees) - expected).abs() < 1e-6, "{degrees}: {}", student_t(degrees));
        }
    }
}
