use glam::{DMat3, DVec3};

/// Values of three recorded quantities at a time, with first and second derivatives per second.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Motion {
    pub(crate) value: DVec3,
    pub(crate) rate: DVec3,
    pub(crate) second: DVec3,
}

/// Evaluates a least-squares quadratic through samples (seconds relative to the evaluated time, values). It
/// fits a line for fewer than three distinct times or if `line` is set, a constant for one time.
pub(crate) fn motion(samples: &[(f64, DVec3)], line: bool) -> Motion {
    let Some((_, first)) = samples.first() else { return Motion::default() };
    // Times of order 1 keep the matrix well-conditioned.
    let scale_s = samples.iter().map(|(t, _)| t.abs()).fold(0.0, f64::max);
    if scale_s == 0.0 {
        return Motion { value: *first, ..Motion::default() };
    }
    let mut times: Vec<f64> = samples.iter().map(|(t, _)| *t).collect();
    times.dedup();
    let degree = if line { 1 } else { 2 }.min(times.len() - 1);
    let powers = |t: f64| {
        let u = t / scale_s;
        DVec3::new(1.0, if degree > 0 { u } else { 0.0 }, if degree > 1 { u * u } else { 0.0 })
    };
    let (mut matrix, mut sums) = (DMat3::ZERO, [DVec3::ZERO; 3]);
    for (t, numbers) in samples {
        let p = powers(*t);
        matrix += DMat3::from_cols(p * p.x, p * p.y, p * p.z);
        for (sum, number) in sums.iter_mut().zip((*numbers - *first).to_array()) {
            *sum += p * number;
        }
    }
    // Unused coefficients are 0.
    for row in degree + 1..3 {
        matrix.col_mut(row)[row] = 1.0;
    }
    let inverse = matrix.inverse();
    let [x, y, z] = sums.map(|sum| inverse * sum);
    let coefficient = |i: usize| DVec3::new(x[i], y[i], z[i]);
    Motion {
        value: coefficient(0) + *first,
        rate: coefficient(1) / scale_s,
        second: coefficient(2) * (2.0 / (scale_s * scale_s)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recovers_parabolas() {
        let base = DVec3::new(4e6, -7.0, 0.0);
        let (v, a) = (DVec3::new(12.0, -3.0, 0.2), DVec3::new(-2.0, 0.5, 0.1));
        let sample = |t: f64| (t, base + v * t + a * (t * t / 2.0));
        for times in [vec![-0.5, -0.1, 0.2, 0.7], vec![0.0, 0.1, 0.25], vec![-3.0, -2.0, -1.0, 1.0]] {
            let samples: Vec<_> = times.into_iter().map(sample).collect();
            let found = motion(&samples, false);
            assert!((found.value - base).length() < 1e-8, "{found:?}");
            assert!((found.rate - v).length() < 1e-7 && (found.second - a).length() < 1e-6, "{found:?}");
        }
    }

    #[test]
    fn few_samples_give_lower_orders() {
        let (p, q) = (DVec3::new(1.0, 2.0, 3.0), DVec3::new(2.0, 2.0, 1.0));
        let two = motion(&[(-0.5, p), (0.5, q)], false);
        assert!((two.value - (p + q) / 2.0).length() < 1e-12 && (two.rate - (q - p)).length() < 1e-12);
        assert_eq!(two.second, DVec3::ZERO);
        assert_eq!(motion(&[(0.0, p)], false), Motion { value: p, ..Motion::default() });
        assert_eq!(motion(&[(0.3, p)], false), Motion { value: p, ..Motion::default() });
        // Two poses at the same time.
        let same = motion(&[(0.0, p), (0.0, p), (0.1, p)], false);
        assert!(same.rate.length() < 1e-12 && same.second == DVec3::ZERO);
        assert_eq!(motion(&[], true), Motion::default());
        let bent = motion(&[(-1.0, p), (0.0, q), (1.0, p)], true);
        assert!(bent.rate.length() < 1e-12 && bent.second == DVec3::ZERO);
    }
}
