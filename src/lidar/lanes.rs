//! Numbers that are calculated together, by vector instructions.
//!
//! Loops rather than `array::map` and `array::from_fn`, which are not inlined into the functions of
//! [`crate::vectors`].

use std::ops::{Add, Div, Mul, Sub};

/// Lanes of the vectors.
pub(super) const LANES: usize = 8;

/// Several numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lanes<const N: usize>(pub(super) [f32; N]);

impl<const N: usize> Lanes<N> {
    #[inline(always)]
    pub(super) fn all(value: f32) -> Self {
        Self([value; N])
    }

    /// Returns values from a first one on.
    #[inline(always)]
    pub(super) fn at(values: &[f32], first: usize) -> Self {
        let mut result = [0.0; N];
        result.copy_from_slice(&values[first..first + N]);
        Self(result)
    }

    #[inline(always)]
    fn map(self, each: impl Fn(f32) -> f32) -> Self {
        let mut result = self;
        for value in &mut result.0 {
            *value = each(*value);
        }
        result
    }

    #[inline(always)]
    fn zip(self, other: Self, each: impl Fn(f32, f32) -> f32) -> Self {
        let mut result = self;
        for (value, other) in result.0.iter_mut().zip(&other.0) {
            *value = each(*value, *other);
        }
        result
    }

    #[inline(always)]
    pub(super) fn abs(self) -> Self {
        self.map(f32::abs)
    }

    #[inline(always)]
    pub(super) fn sqrt(self) -> Self {
        self.map(f32::sqrt)
    }

    #[inline(always)]
    pub(super) fn min(self, other: Self) -> Self {
        self.zip(other, |a, b| if a < b { a } else { b })
    }

    #[inline(always)]
    pub(super) fn max(self, other: Self) -> Self {
        self.zip(other, |a, b| if a > b { a } else { b })
    }

    /// Returns the numbers without their fractions.
    #[inline(always)]
    pub(super) fn truncated(self) -> [i32; N] {
        let mut result = [0; N];
        for (whole, value) in result.iter_mut().zip(&self.0) {
            *whole = *value as i32;
        }
        result
    }

    /// Returns one's lanes where these are negative, and another's elsewhere.
    #[inline(always)]
    pub(super) fn negative(self, negative: Self, other: Self) -> Self {
        let mut result = other;
        for ((result, value), negative) in result.0.iter_mut().zip(&self.0).zip(&negative.0) {
            *result = if *value < 0.0 { *negative } else { *result };
        }
        result
    }

    /// Returns the lanes that are set, and infinity elsewhere.
    #[inline(always)]
    pub(super) fn only(self, is_set: [bool; N]) -> Self {
        let mut result = self;
        for (value, is_set) in result.0.iter_mut().zip(is_set) {
            *value = if is_set { *value } else { f32::INFINITY };
        }
        result
    }

    #[inline(always)]
    pub(super) fn at_most(self, other: Self) -> [bool; N] {
        let mut result = [false; N];
        for ((is_at_most, a), b) in result.iter_mut().zip(&self.0).zip(&other.0) {
            *is_at_most = a <= b;
        }
        result
    }
}

/// Returns which lanes are set in both.
#[inline(always)]
pub(super) fn and<const N: usize>(a: [bool; N], b: [bool; N]) -> [bool; N] {
    let mut result = a;
    for (result, b) in result.iter_mut().zip(b) {
        *result &= b;
    }
    result
}

/// Returns the dot products with a vector, lane by lane.
#[inline(always)]
pub(super) fn dot<const N: usize>([x, y, z]: [f32; 3], other: [Lanes<N>; 3]) -> Lanes<N> {
    other[0] * x + other[1] * y + other[2] * z
}

/// Returns the squared lengths, lane by lane.
#[inline(always)]
pub(super) fn squared<const N: usize>([x, y, z]: [Lanes<N>; 3]) -> Lanes<N> {
    x * x + y * y + z * z
}

macro_rules! operators {
    ($($trait:ident $name:ident $operator:tt),*) => { $(
        impl<const N: usize> $trait for Lanes<N> {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                self.zip(other, |a, b| a $operator b)
            }
        }

        impl<const N: usize> $trait<f32> for Lanes<N> {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: f32) -> Self {
                self.map(|a| a $operator other)
            }
        }
    )* };
}

operators! { Add add +, Sub sub -, Mul mul *, Div div / }
