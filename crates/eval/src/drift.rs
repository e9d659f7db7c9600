/// Change of a metric over a rollout.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Drift {
    /// Slope of the least-squares line through the values, per second.
    pub slope_per_s: f64,
    /// Mean of the last third of the values minus mean of the first third.
    pub last_minus_first_third: f64,
}

impl Drift {
    /// Computes the drift of a series at times in seconds. Missing and non-finite values are skipped. A third
    /// is rounded down to whole values. `None` if there are less than three values, or if all are of the same
    /// time.
    pub fn of(t_s: &[f64], values: &[Option<f64>]) -> Option<Self> {
        let known = |(t, value): (&f64, &Option<f64>)| value.filter(|v| v.is_finite()).map(|v| (*t, v));
        let known: Vec<(f64, f64)> = t_s.iter().zip(values).filter_map(known).collect();
        let third = known.len() / 3;
        if third == 0 {
            return None;
        }
        let mean = |part: &[(f64, f64)], of: fn(&(f64, f64)) -> f64| {
            part.iter().map(of).sum::<f64>() / part.len() as f64
        };
        let (mean_t, mean_v) = (mean(&known, |k| k.0), mean(&known, |k| k.1));
        let across: f64 = known.iter().map(|(t, v)| (t - mean_t) * (v - mean_v)).sum();
        let along: f64 = known.iter().map(|(t, _)| (t - mean_t).powi(2)).sum();
        (along > 0.0).then(|| Self {
            slope_per_s: across / along,
            last_minus_first_third: mean(&known[known.len() - third..], |k| k.1)
                - mean(&known[..third], |k| k.1),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drift_of_a_line_is_its_slope() {
        let t_s: Vec<f64> = (0..7).map(|i| 5.0 + 0.5 * f64::from(i)).collect();
        let mut values: Vec<Option<f64>> = t_s.iter().map(|t| Some(20.0 - 3.0 * t)).collect();
        let drift = Drift::of(&t_s, &values).unwrap();
        assert!((drift.slope_per_s + 3.0).abs() < 1e-12);
        // Thirds of two values each, 2.5 s apart.
        assert!((drift.last_minus_first_third + 7.5).abs() < 1e-12);
        // Missing values are skipped; the others are on the same line.
        values[3] = None;
        values[0] = Some(f64::INFINITY);
        let drift = Drift::of(&t_s, &values).unwrap();
        assert!((drift.slope_per_s + 3.0).abs() < 1e-12);
        assert!((drift.last_minus_first_third + 7.5).abs() < 1e-12);
    }

    #[test]
    fn symmetric_noise_has_zero_slope() {
        let t_s = [0.0, 1.0, 2.0, 3.0];
        let drift = Drift::of(&t_s, &[1.0, 2.0, 2.0, 1.0].map(Some)).unwrap();
        assert_eq!((drift.slope_per_s, drift.last_minus_first_third), (0.0, 0.0));
    }

    #[test]
    fn few_values_have_no_drift() {
        assert_eq!(Drift::of(&[0.0, 1.0], &[Some(1.0), Some(2.0)]), None);
        assert_eq!(Drift::of(&[0.0, 1.0, 2.0], &[Some(1.0), None, Some(2.0)]), None);
        assert_eq!(Drift::of(&[1.0; 3], &[Some(1.0); 3]), None);
    }
}
