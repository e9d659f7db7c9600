//! The plane through some points.

use glam::{DVec3, Vec3};

/// Rotations of the Jacobi method: three would do for any matrix of three rows.
const SWEEPS: usize = 8;

/// Mean of points, and the plane of least squared distances through it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Plane {
    pub(super) mean: Vec3,
    /// Unit normal.
    pub(super) normal: Vec3,
    /// Standard deviation of the distances from the plane, meters.
    pub(super) thickness_m: f32,
    /// Standard deviation along the shorter axis in the plane, meters.
    pub(super) width_m: f32,
}

impl Plane {
    /// Returns the plane through points; `None` without points.
    pub(super) fn through(points: impl ExactSizeIterator<Item = Vec3> + Clone) -> Option<Self> {
        let (count, first) = (points.len() as f64, points.clone().next()?.as_dvec3());
        let (mut sum, mut squares) = (DVec3::ZERO, [[0.0; 3]; 3]);
        for point in points {
            let p = point.as_dvec3() - first;
            sum += p;
            for i in 0..3 {
                for j in i..3 {
                    squares[i][j] += p[i] * p[j];
                }
            }
        }
        let mean = sum / count;
        let covariance = |i: usize, j: usize| squares[i.min(j)][i.max(j)] / count - mean[i] * mean[j];
        let matrix = [0, 1, 2].map(|i| [0, 1, 2].map(|j| covariance(i, j)));
        let axes = axes(matrix);
        let [thin, wide, _] = axes.map(|(variance, _)| variance.max(0.0).sqrt() as f32);
        Some(Self {
            mean: (first + mean).as_vec3(),
            normal: axes[0].1.as_vec3(),
            thickness_m: thin,
            width_m: wide,
        })
    }
}

/// Returns the eigenvalues of a symmetric matrix and their unit vectors, the least first (Jacobi's method).
fn axes(mut a: [[f64; 3]; 3]) -> [(f64, DVec3); 3] {
    let mut vectors = [DVec3::X, DVec3::Y, DVec3::Z];
    for _ in 0..SWEEPS {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if a[p][q] == 0.0 {
                continue;
            }
            let half = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
            let tangent = half.signum() / (half.abs() + half.hypot(1.0));
            let cosine = 1.0 / tangent.hypot(1.0);
            let sine = tangent * cosine;
            for row in &mut a {
                (row[p], row[q]) = (cosine * row[p] - sine * row[q], sine * row[p] + cosine * row[q]);
            }
            let (first, second) = (a[p], a[q]);
            a[p] = std::array::from_fn(|k| cosine * first[k] - sine * second[k]);
            a[q] = std::array::from_fn(|k| sine * first[k] + cosine * second[k]);
            (vectors[p], vectors[q]) =
                (vectors[p] * cosine - vectors[q] * sine, vectors[p] * sine + vectors[q] * cosine);
        }
    }
    let mut axes = [0, 1, 2].map(|i| (a[i][i], vectors[i]));
    axes.sort_by(|a, b| a.0.total_cmp(&b.0));
    axes
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    /// A grid of 1 by 0.5 m, tilted, with points 1 cm to either side.
    #[test]
    fn planes_of_tilted_grids_are_exact() {
        let rotation = DQuat::from_euler(glam::EulerRot::XYZ, 0.4, -0.7, 1.1);
        let center = DVec3::new(3.0, -8.0, 1.5);
        let grid = (0..21).flat_map(|i| (0..21).map(move |j| [f64::from(i) / 20.0, f64::from(j) / 20.0]));
        let points: Vec<Vec3> = grid
            .flat_map(|[x, y]| [-0.01, 0.01].map(|z| DVec3::new(x - 0.5, y * 0.5 - 0.25, z)))
            .map(|at| (center + rotation * at).as_vec3())
            .collect();
        let plane = Plane::through(points.into_iter()).unwrap();
        assert!(plane.normal.dot((rotation * DVec3::Z).as_vec3()).abs() > 0.999_999);
        assert!(plane.mean.distance(center.as_vec3()) < 1e-5);
        // A uniform grid of 21 points has a variance of (21² − 1) / 12 steps.
        let expected = 0.025 * (440.0_f32 / 12.0).sqrt();
        assert!(
            (plane.thickness_m - 0.01).abs() < 1e-5 && (plane.width_m - expected).abs() < 1e-4,
            "{plane:?}"
        );
        assert_eq!(Plane::through([].into_iter()), None);
    }

    #[test]
    fn equal_points_have_no_extent() {
        let plane = Plane::through([Vec3::new(1.0, 2.0, 3.0); 4].into_iter()).unwrap();
        assert_eq!((plane.thickness_m, plane.width_m, plane.mean), (0.0, 0.0, Vec3::new(1.0, 2.0, 3.0)));
        assert!((plane.normal.length() - 1.0).abs() < 1e-6);
    }
}
