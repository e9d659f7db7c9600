use rayon::prelude::*;
use smartcore::linalg::basic::arrays::Array;
use smartcore::linalg::basic::matrix::DenseMatrix;
use smartcore::linalg::traits::evd::EVDDecomposable;

/// Features `[N, D]`, a row per image or per video.
#[derive(Clone, Debug, PartialEq)]
pub struct FeatureSet {
    columns: usize,
    values: Vec<f64>,
}

impl FeatureSet {
    /// Creates a set from `values`, row by row. `None` if they are not whole rows of `columns` values.
    pub fn new(columns: usize, values: Vec<f64>) -> Option<Self> {
        let whole = values.is_empty() || (columns > 0 && values.len().is_multiple_of(columns));
        whole.then_some(Self { columns, values })
    }

    /// Number of features per row, D.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Iterates over the rows, `[D]` each.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = &[f64]> {
        self.values.chunks_exact(self.columns.max(1))
    }
}

/// Error of a Fréchet distance between two sets of features.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrechetError {
    /// A set has less than the two rows that a covariance needs.
    #[error("expected features of at least 2 images in each set, found {0} and {1}")]
    Rows(usize, usize),
    /// The sets differ in the number of features.
    #[error("expected as many features in both sets, found {0} and {1}")]
    Columns(usize, usize),
    /// A feature is NaN, infinite, or too large to be squared.
    #[error("expected finite features, found others")]
    NotFinite,
    /// An eigenvalue decomposition failed.
    #[error("expected covariances with eigenvalues, found none")]
    NoEigenvalues,
}

/// Computes the Fréchet distance between two normal distributions with the means and unbiased covariances of
/// two sets of features (M. Heusel et al., *GANs trained by a two time-scale update rule*, 2017, equation 6):
/// `|m_a - m_b|² + tr(A) + tr(B) - 2·tr(sqrt(sqrt(A)·B·sqrt(A)))`. In squared units of the features.
///
/// With fewer rows than features, the rank of a covariance is below D. The distance is still defined, but it
/// is biased upwards, depending on the number of rows. Then only compare distances between sets with the same
/// numbers of rows; the distance between two halves of the ground truth shows the level of no difference.
///
/// # Errors
/// Returns an error if a set has less than two rows, if the sets differ in the number of features, if a
/// feature is not finite, or if eigenvalues are not found.
pub fn frechet_distance(a: &FeatureSet, b: &FeatureSet) -> Result<f64, FrechetError> {
    let rows = [a, b].map(|set| set.rows().len());
    if rows.iter().any(|rows| *rows < 2) {
        return Err(FrechetError::Rows(rows[0], rows[1]));
    }
    if a.columns() != b.columns() {
        return Err(FrechetError::Columns(a.columns(), b.columns()));
    }
    let (mut a, mut b) = (Moments::new(a), Moments::new(b));
    let apart: f64 = a.mean.iter().zip(&b.mean).map(|(a, b)| (a - b).powi(2)).sum();
    let (trace_a, trace_b) = (a.trace(), b.trace());
    if !(apart + trace_a + trace_b).is_finite() {
        return Err(FrechetError::NotFinite);
    }
    let scale = trace_a.max(trace_b);
    if scale == 0.0 {
        return Ok(apart);
    }
    // Scales the eigenvalues to about 1, whatever the unit of the features.
    a.divide_by(scale.sqrt());
    b.divide_by(scale.sqrt());
    let cross = if a.columns() <= a.rows.min(b.rows) { by_covariances(&a, &b) } else { by_products(&a, &b) };
    let cross = cross.ok_or(FrechetError::NoEigenvalues)?;
    // Rounding may make the distance of equal sets slightly negative.
    Ok((apart + trace_a + trace_b - 2.0 * scale * cross).max(0.0))
}

/// Mean of a feature set, and deviations from it.
struct Moments {
    mean: Vec<f64>,
    rows: usize,
    /// Deviations `[N, D]`, divided by `sqrt(N - 1)`: the covariance is `deviationsᵀ·deviations`.
    deviations: Vec<f64>,
}

impl Moments {
    fn new(set: &FeatureSet) -> Self {
        let (rows, columns) = (set.rows().len(), set.columns());
        let mut mean = vec![0.0; columns];
        for row in set.rows() {
            mean.iter_mut().zip(row).for_each(|(sum, v)| *sum += v);
        }
        mean.iter_mut().for_each(|sum| *sum /= rows as f64);
        let root = ((rows - 1) as f64).sqrt();
        let deviations =
            set.rows().flat_map(|row| row.iter().zip(&mean).map(|(v, m)| (v - m) / root)).collect();
        Self { mean, rows, deviations }
    }

    fn columns(&self) -> usize {
        self.mean.len()
    }

    fn trace(&self) -> f64 {
        self.deviations.iter().map(|v| v * v).sum()
    }

    fn divide_by(&mut self, scale: f64) {
        self.deviations.iter_mut().for_each(|v| *v /= scale);
    }

    /// Covariance matrix, `[D, D]`.
    fn covariance(&self) -> Vec<f64> {
        let columns = self.columns();
        let flipped = transposed(&self.deviations, columns);
        rows_product(&flipped, &flipped, self.rows)
    }
}

/// Computes `tr(sqrt(sqrt(A)·B·sqrt(A)))` directly.
fn by_covariances(a: &Moments, b: &Moments) -> Option<f64> {
    let columns = a.columns();
    let root = square_root(a.covariance(), columns)?;
    // All of these matrices are symmetric, so rows are columns.
    let left = rows_product(&root, &b.covariance(), columns);
    trace_of_root(rows_product(&left, &root, columns), columns)
}

/// Computes the same trace from the deviations X and Y: `sqrt(A)·B·sqrt(A)` has the eigenvalues of
/// `(X·Yᵀ)·(X·Yᵀ)ᵀ`, except for zeros. Faster if there are fewer rows than features.
fn by_products(a: &Moments, b: &Moments) -> Option<f64> {
    let (few, many) = if a.rows <= b.rows { (a, b) } else { (b, a) };
    let cross = rows_product(&few.deviations, &many.deviations, a.columns());
    trace_of_root(rows_product(&cross, &cross, many.rows), few.rows)
}

/// Returns the square root of a symmetric matrix `[n, n]` whose eigenvalues are nonnegative, except for
/// rounding.
fn square_root(matrix: Vec<f64>, n: usize) -> Option<Vec<f64>> {
    let (values, vectors) = eigen(matrix, n)?;
    let scaled: Vec<f64> =
        (0..n * n).map(|i| vectors.get((i / n, i % n)) * values[i % n].max(0.0).powf(0.25)).collect();
    Some(rows_product(&scaled, &scaled, n))
}

fn trace_of_root(matrix: Vec<f64>, n: usize) -> Option<f64> {
    let trace: f64 = eigen(matrix, n)?.0.iter().map(|v| v.max(0.0).sqrt()).sum();
    trace.is_finite().then_some(trace)
}

/// Returns the eigenvalues and, in columns, the eigenvectors of a symmetric matrix `[n, n]`.
fn eigen(matrix: Vec<f64>, n: usize) -> Option<(Vec<f64>, DenseMatrix<f64>)> {
    let matrix = DenseMatrix::new(n, n, matrix, false).ok()?;
    let parts = matrix.evd_mut(true).ok()?;
    Some((parts.d, parts.V))
}

/// Transposes `[N, columns]`.
fn transposed(matrix: &[f64], columns: usize) -> Vec<f64> {
    (0..columns).flat_map(|c| matrix.iter().skip(c).step_by(columns).copied()).collect()
}

/// Computes `a·bᵀ`, `[N, M]`, of `[N, inner]` and `[M, inner]`. The order of the sums does not depend on the
/// number of threads.
fn rows_product(a: &[f64], b: &[f64], inner: usize) -> Vec<f64> {
    let row = |a: &[f64]| b.chunks_exact(inner).map(|b| dot(a, b)).collect::<Vec<f64>>();
    a.par_chunks_exact(inner).flat_map_iter(row).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    const LANES: usize = 8;
    let mut sums = [0.0; LANES];
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    for (a, b) in a.iter().zip(b) {
        (0..LANES).for_each(|i| sums[i] += a[i] * b[i]);
    }
    sums.iter().sum::<f64>() + a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the corners of a box around a mean: exactly uncorrelated columns. The variance of a column is
    /// `s²·8/(8-1)` for half sides `s`.
    fn corners(mean: [f64; 3], half: [f64; 3]) -> FeatureSet {
        let corner =
            |i: usize| (0..3).map(move |c| mean[c] + half[c] * if i >> c & 1 == 1 { 1.0 } else { -1.0 });
        FeatureSet::new(3, (0..8).flat_map(corner).collect()).unwrap()
    }

    #[test]
    fn distance_of_diagonal_gaussians() {
        let (a, b) = (corners([0.0; 3], [1.0, 2.0, 3.0]), corners([1.0, -2.0, 0.5], [2.0, 2.0, 0.0]));
        // |m|² plus the squared differences of standard deviations, which are sqrt(8/7) times the half sides.
        let expected = (1.0 + 4.0 + 0.25) + (1.0 + 0.0 + 9.0) * 8.0 / 7.0;
        assert!((frechet_distance(&a, &b).unwrap() - expected).abs() < 1e-9);
        assert!((frechet_distance(&b, &a).unwrap() - expected).abs() < 1e-9);
        assert!(frechet_distance(&a, &a).unwrap() < 1e-9);
    }

    #[test]
    fn both_methods_agree() {
        let wave = |rows: usize, phase: f64| {
            let value = |i: usize| ((i * i) as f64 * 0.37 + phase).sin() * (1.0 + (i % 5) as f64);
            Moments::new(&FeatureSet::new(5, (0..rows * 5).map(value).collect()).unwrap())
        };
        for (a, b) in
            [(wave(20, 0.0), wave(11, 1.0)), (wave(3, 0.5), wave(9, 2.0)), (wave(2, 0.1), wave(2, 0.2))]
        {
            let (one, other) = (by_covariances(&a, &b).unwrap(), by_products(&a, &b).unwrap());
            assert!((one - other).abs() < 1e-6 * (1.0 + other), "{one} {other}");
        }
    }

    #[test]
    fn distance_with_fewer_rows_than_features() {
        // Two rows of four features each, so each set varies along one direction.
        let a = FeatureSet::new(4, vec![3.0, 0.0, 0.0, 0.0, -3.0, 0.0, 0.0, 0.0]).unwrap();
        let b = FeatureSet::new(4, vec![0.0, 2.0, 0.0, 0.0, 0.0, -2.0, 0.0, 0.0]).unwrap();
        // Variances 18 and 8 along different axes have no common part.
        assert!((frechet_distance(&a, &b).unwrap() - 26.0).abs() < 1e-9);
        let c = FeatureSet::new(4, vec![2.0, 0.0, 0.0, 0.0, -2.0, 0.0, 0.0, 0.0]).unwrap();
        let shared = 18.0_f64.sqrt() - 8.0_f64.sqrt();
        assert!((frechet_distance(&a, &c).unwrap() - shared * shared).abs() < 1e-9);
    }

    #[test]
    fn rejects_invalid_feature_sets() {
        assert_eq!([FeatureSet::new(2, vec![1.0; 3]), FeatureSet::new(0, vec![1.0])], [None, None]);
        let (one, two) =
            (FeatureSet::new(2, vec![1.0; 2]).unwrap(), FeatureSet::new(2, vec![1.0; 4]).unwrap());
        assert_eq!(frechet_distance(&one, &two), Err(FrechetError::Rows(1, 2)));
        let wide = FeatureSet::new(4, vec![1.0; 8]).unwrap();
        assert_eq!(frechet_distance(&two, &wide), Err(FrechetError::Columns(2, 4)));
        let bad = FeatureSet::new(2, vec![1.0, f64::NAN, 2.0, 3.0]).unwrap();
        assert_eq!(frechet_distance(&two, &bad), Err(FrechetError::NotFinite));
        // Without spread, only the means count.
        let other = FeatureSet::new(2, vec![2.0; 4]).unwrap();
        assert_eq!(frechet_distance(&two, &other), Ok(2.0));
        assert_eq!(frechet_distance(&two, &two), Ok(0.0));
    }
}
