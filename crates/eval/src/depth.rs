/// Errors of a depth map, over pixels that have a depth in both the map and the ground truth.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DepthErrors {
    absolute_m: Vec<f32>,
    relative: Vec<f32>,
}

/// Summary statistics of depth errors.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct DepthSummary {
    /// Number of pixels compared.
    pub pixels: usize,
    /// Lower median of the absolute error, meters.
    pub median_m: f32,
    /// 95th percentile of the absolute error, meters.
    pub p95_m: f32,
    /// Lower median of the relative error, as a fraction of the true depth.
    pub median_relative: f32,
    /// 95th percentile of the relative error, as a fraction of the true depth.
    pub p95_relative: f32,
}

impl DepthErrors {
    /// Adds the errors of a depth map against the ground truth, both of one size, in meters. Values that are
    /// not finite are empty, and so is a true depth of 0.
    pub fn add(&mut self, map_m: &[f32], truth_m: &[f32]) {
        for (map, truth) in map_m.iter().zip(truth_m).filter(|(a, b)| a.is_finite() && b.is_finite()) {
            if *truth > 0.0 {
                self.absolute_m.push((map - truth).abs());
                self.relative.push((map - truth).abs() / truth);
            }
        }
    }

    /// Computes the summary; `None` if no pixel was compared.
    pub fn summary(mut self) -> Option<DepthSummary> {
        Some(DepthSummary {
            pixels: self.absolute_m.len(),
            median_m: quantile(&mut self.absolute_m, 0.5)?,
            p95_m: quantile(&mut self.absolute_m, 0.95)?,
            median_relative: quantile(&mut self.relative, 0.5)?,
            p95_relative: quantile(&mut self.relative, 0.95)?,
        })
    }
}

/// Returns a quantile: the smallest value that at least `share` of all values do not exceed.
fn quantile(values: &mut [f32], share: f64) -> Option<f32> {
    let at = ((values.len() as f64 * share).ceil() as usize).checked_sub(1)?;
    Some(*values.select_nth_unstable_by(at, f32::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn computes_depth_errors() {
        let mut errors = DepthErrors::default();
        assert_eq!(errors.clone().summary(), None);
        // True depth of 10 m, errors of 0, 1, .. 19 cm; plus pixels that are empty in one map.
        let truth: Vec<f32> = vec![10.0; 20];
        let map: Vec<f32> = (0..20).map(|i| 10.0 - 0.01 * i as f32).collect();
        errors.add(&map, &truth);
        errors.add(&[5.0, f32::INFINITY, 5.0], &[f32::INFINITY, 5.0, 0.0]);
        let summary = errors.summary().unwrap();
        assert_eq!(summary.pixels, 20);
        let close = |a: f32, b: f32| (a - b).abs() < 1e-5;
        assert!(close(summary.median_m, 0.09) && close(summary.p95_m, 0.18), "{summary:?}");
        assert!(close(summary.median_relative, 0.009) && close(summary.p95_relative, 0.018));
    }

    #[test]
    fn identical_maps_have_zero_error() {
        let mut errors = DepthErrors::default();
        errors.add(&[1.0, f32::INFINITY, 80.5], &[1.0, f32::INFINITY, 80.5]);
        let exact =
            DepthSummary { pixels: 2, median_m: 0.0, p95_m: 0.0, median_relative: 0.0, p95_relative: 0.0 };
        assert_eq!(errors.summary(), Some(exact));
    }
}
