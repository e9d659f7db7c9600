use candle_core::{DType, Device, Result, Tensor};

use crate::FirstGuess;

/// Weight of the squared matrix entries beside the squared errors, per row (ridge); prevents overfitting.
const RIDGE: f64 = 1e-3;

/// Sums for the least-squares linear map from rows `x [n, N]` to rows `y [n, C]`. Source: Hoerl and Kennard, "Ridge
/// Regression", 1970.
#[derive(Debug)]
pub(super) struct Regression {
    /// Width of `x` with a constant 1 appended, N + 1.
    width: usize,
    channels: usize,
    rows: usize,
    /// `sum x x`, `[N + 1, N + 1]`.
    squares: Vec<f64>,
    /// `sum x y`, `[N + 1, C]`.
    products: Vec<f64>,
    /// `sum y y`, `[C]`.
    own: Vec<f64>,
}

impl Regression {
    /// Creates empty sums for rows of N and C numbers.
    pub(super) fn new([numbers, channels]: [usize; 2]) -> Self {
        let width = numbers + 1;
        let (squares, products) = (vec![0.0; width * width], vec![0.0; width * channels]);
        Self { width, channels, rows: 0, squares, products, own: vec![0.0; channels] }
    }

    /// Adds rows `x [n, N]` and `y [n, C]`.
    pub(super) fn add(&mut self, x: &Tensor, y: &[f32]) -> Result<()> {
        let rows = x.dims2()?.0;
        let ones = Tensor::ones((rows, 1), DType::F32, &Device::Cpu)?;
        let across = Tensor::cat(&[x, &ones], 1)?;
        let y_rows = Tensor::from_slice(y, (rows, self.channels), &Device::Cpu)?;
        let down = across.t()?.contiguous()?;
        for (sums, of) in [(&mut self.squares, &across), (&mut self.products, &y_rows)] {
            let added = down.matmul(of)?.flatten_all()?.to_vec1::<f32>()?;
            sums.iter_mut().zip(added).for_each(|(sum, added)| *sum += f64::from(added));
        }
        for row in y.chunks(self.channels) {
            self.own.iter_mut().zip(row).for_each(|(sum, y)| *sum += f64::from(*y).powi(2));
        }
        self.rows += rows;
        Ok(())
    }

    /// Returns the linear map, and the root mean square of its remaining error per channel.
    pub(super) fn solve(&self) -> (FirstGuess, Vec<f64>) {
        let (n, count) = (self.width, self.rows.max(1) as f64);
        let mut regular = self.squares.clone();
        for i in 0..n {
            // The bias is hardly regularized.
            regular[i * n + i] += if i + 1 < n { RIDGE * count } else { 1e-9 * count };
        }
        let factor = cholesky(&regular, n);
        let mut guess = FirstGuess { matrix: Vec::new(), bias: Vec::new() };
        let mut left = Vec::new();
        for channel in 0..self.channels {
            let products: Vec<f64> = (0..n).map(|i| self.products[i * self.channels + channel]).collect();
            let map = solved(&factor, &products, n);
            let twice: f64 = map.iter().zip(&products).map(|(map, product)| map * product).sum();
            let shown = |i: usize| map[i] * dot(&self.squares[i * n..(i + 1) * n], &map);
            let squares = self.own[channel] - 2.0 * twice + (0..n).map(shown).sum::<f64>();
            left.push((squares / count).max(0.0).sqrt());
            guess.matrix.extend(map[..n - 1].iter().map(|value| *value as f32));
            guess.bias.push(map[n - 1] as f32);
        }
        (guess, left)
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Returns the lower triangular `L [n, n]` of a positive definite matrix `L L^T`.
fn cholesky(matrix: &[f64], n: usize) -> Vec<f64> {
    let mut lower = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..=i {
            let rest = matrix[i * n + j] - dot(&lower[i * n..i * n + j], &lower[j * n..j * n + j]);
            lower[i * n + j] =
                if i == j { rest.max(f64::MIN_POSITIVE).sqrt() } else { rest / lower[j * n + j] };
        }
    }
    lower
}

/// Solves `L L^T x = b`.
fn solved(lower: &[f64], b: &[f64], n: usize) -> Vec<f64> {
    let mut x = b.to_vec();
    for i in 0..n {
        x[i] = (x[i] - dot(&lower[i * n..i * n + i], &x[..i])) / lower[i * n + i];
    }
    for i in (0..n).rev() {
        x[i] /= lower[i * n + i];
        for j in 0..i {
            x[j] -= lower[i * n + j] * x[i];
        }
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Data in two parts: `y = 2 a - b + 3`, and a channel that is independent of both inputs.
    #[test]
    fn the_map_is_found_and_what_it_leaves() {
        let mut sums = Regression::new([2, 2]);
        for part in 0..2 {
            let x: Vec<f32> = (0..64).map(|i| ((i * 37 + part * 5) % 17) as f32 - 8.0).collect();
            let of =
                |(row, x): (usize, &[f32])| [2.0 * x[0] - x[1] + 3.0, if row % 2 == 0 { 0.5 } else { -0.5 }];
            let y: Vec<f32> = x.chunks(2).enumerate().flat_map(of).collect();
            sums.add(&Tensor::from_vec(x, (32, 2), &Device::Cpu).unwrap(), &y).unwrap();
        }
        let (guess, left) = sums.solve();
        let near = |found: f32, expected: f32| (found - expected).abs() < 2e-3;
        assert!(
            near(guess.matrix[0], 2.0) && near(guess.matrix[1], -1.0) && near(guess.bias[0], 3.0),
            "{guess:?}"
        );
        assert!(left[0] < 2e-3 && (0.45..=0.5001).contains(&left[1]), "{left:?}");
    }
}
