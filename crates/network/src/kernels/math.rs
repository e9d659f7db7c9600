use pulp::{Simd, WithSimd};

use super::LANES;

/// Runs loops with the widest vector instructions of the processor.
#[inline(always)]
pub(super) fn wide<R>(loops: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(loops)
}

/// Returns `e^x` by a polynomial, with a relative error below 4e-7. Arguments below -87 give about 1e-38.
/// Source: Cephes, `expf`.
#[inline(always)]
pub(super) fn exp(x: f32) -> f32 {
    let x = x.clamp(-87.0, 88.0);
    let magic = 12_582_912.0_f32; // 1.5 * 2^23: adding it rounds to a whole number
    let shifted = x.mul_add(std::f32::consts::LOG2_E, magic);
    let octaves = shifted - magic;
    // ln 2 is split into two parts, so that the first product is exact.
    let rest = octaves.mul_add(-0.693_145_75, x);
    let rest = octaves.mul_add(-1.428_606_8e-6, rest);
    let mut p = 1.987_569_1e-4_f32;
    for factor in [1.398_199_9e-3, 8.333_452e-3, 4.166_579_6e-2, 1.666_666_5e-1, 0.5] {
        p = p.mul_add(rest, factor);
    }
    let p = p.mul_add(rest * rest, rest) + 1.0;
    let exponent = shifted.to_bits().wrapping_sub(magic.to_bits()) << 23;
    f32::from_bits(p.to_bits().wrapping_add(exponent))
}

/// `2 sqrt(2 / pi)`.
const GELU_SLOPE: f32 = 1.595_769;
const GELU_CUBE: f32 = 0.044_715;

/// Returns GELU in its tanh form, `x / (1 + exp(-2 sqrt(2/pi) (x + 0.044715 x^3)))`. Source: Hendrycks and
/// Gimpel, 2016.
#[inline(always)]
pub(super) fn gelu(x: f32) -> f32 {
    x / (1.0 + exp(-GELU_SLOPE * x * (1.0 + GELU_CUBE * x * x)))
}

/// Computes `x / (1 + exp(-x))` in place. Source: Elfwing et al., 2018.
pub(in super::super) fn silu(values: &mut [f32]) {
    values.iter_mut().for_each(|x| *x /= 1.0 + exp(-*x));
}

/// A small matrix product, `out[rows, columns] = a[rows, inner] b[inner, columns]`. `b` and `out` are
/// row-major, and `columns` is a multiple of [`LANES`]. Each value is summed in the order of `inner`.
pub(super) struct Product<'a> {
    pub(super) rows: usize,
    pub(super) inner: usize,
    pub(super) columns: usize,
    pub(super) a: &'a [f32],
    /// Strides of `a` to the next row, and to the next column.
    pub(super) strides: [usize; 2],
    pub(super) b: &'a [f32],
    pub(super) out: &'a mut [f32],
    /// Whether the product is added to `out`.
    pub(super) accumulate: bool,
}

impl Product<'_> {
    /// Computes the product.
    #[inline(always)]
    pub(super) fn run(self) {
        pulp::Arch::new().dispatch(self);
    }

    /// Computes a tile: `R` rows from `first`, and `W` vectors per row from vector `begin`.
    #[inline(always)]
    fn tile<S: Simd, const R: usize, const W: usize>(&mut self, simd: S, first: usize, begin: usize) {
        let [down, across] = self.strides;
        let (b, _) = S::as_simd_f32s(self.b);
        let (out, _) = S::as_mut_simd_f32s(self.out);
        let vectors = self.columns / S::F32_LANES;
        let a = &self.a[first * down..];
        let mut sums = [[simd.splat_f32s(0.0); W]; R];
        if self.accumulate {
            for r in 0..R {
                let at = (first + r) * vectors + begin;
                sums[r].copy_from_slice(&out[at..at + W]);
            }
        }
        for k in 0..self.inner {
            let at = k * vectors + begin;
            let row: &[S::f32s] = &b[at..at + W];
            for r in 0..R {
                let factor = simd.splat_f32s(a[r * down + k * across]);
                for w in 0..W {
                    sums[r][w] = simd.mul_add_e_f32s(factor, row[w], sums[r][w]);
                }
            }
        }
        for r in 0..R {
            let at = (first + r) * vectors + begin;
            out[at..at + W].copy_from_slice(&sums[r]);
        }
    }

    #[inline(always)]
    fn band<S: Simd, const R: usize>(&mut self, simd: S, first: usize) {
        let vectors = self.columns / S::F32_LANES;
        let even = vectors / 2 * 2;
        for begin in (0..even).step_by(2) {
            self.tile::<S, R, 2>(simd, first, begin);
        }
        if even < vectors {
            self.tile::<S, R, 1>(simd, first, even);
        }
    }
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        // Six rows of two vectors fill 12 of AVX2's 16 registers.
        let mut first = 0;
        while first + 6 <= self.rows {
            self.band::<S, 6>(simd, first);
            first += 6;
        }
        while first + 2 <= self.rows {
            self.band::<S, 2>(simd, first);
            first += 2;
        }
        if first < self.rows {
            self.band::<S, 1>(simd, first);
        }
    }
}

/// Returns `sum a b`, in an order that depends only on the length.
#[inline(always)]
pub(super) fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0.0_f32; LANES];
    for (a, b) in a.as_chunks::<LANES>().0.iter().zip(b.as_chunks::<LANES>().0) {
        for l in 0..LANES {
            sums[l] = a[l].mul_add(b[l], sums[l]);
        }
    }
    fold(sums)
}

/// Returns `sum f(a)`, in an order that depends only on the length.
#[inline(always)]
pub(super) fn total(a: &[f32], f: impl Fn(f32) -> f32) -> f32 {
    let mut sums = [0.0_f32; LANES];
    for a in a.as_chunks::<LANES>().0 {
        for l in 0..LANES {
            sums[l] += f(a[l]);
        }
    }
    fold(sums)
}

#[inline(always)]
fn fold(mut sums: [f32; LANES]) -> f32 {
    for half in [8, 4, 2, 1] {
        for l in 0..half {
            sums[l] += sums[l + half];
        }
    }
    sums[0]
}

/// Computes `out = f(a, b)`, value by value.
#[inline(always)]
pub(super) fn each(out: &mut [f32], a: &[f32], b: &[f32], f: impl Fn(f32, f32) -> f32) {
    let out = out.as_chunks_mut::<LANES>().0;
    let (a, b) = (a.as_chunks::<LANES>().0, b.as_chunks::<LANES>().0);
    for ((out, a), b) in out.iter_mut().zip(a).zip(b) {
        for l in 0..LANES {
            out[l] = f(a[l], b[l]);
        }
    }
}

/// Computes `out = f(out)`, value by value.
#[inline(always)]
pub(super) fn every(out: &mut [f32], f: impl Fn(f32) -> f32) {
    for out in out.as_chunks_mut::<LANES>().0 {
        for value in out {
            *value = f(*value);
        }
    }
}
