//! Random values that a body's looks are drawn from.

use point_skeleton::hash::{hash, unit};

use super::kind::BodyKind;

/// Random sequence of a seed, or the typical value of every draw.
#[derive(Clone, Debug)]
pub(super) enum Dice {
    /// Seed, and number of values drawn.
    Seed(u64, i64),
    /// Draws the middle of a range, the first item of a list, and `false` for optional features.
    Typical,
}

impl Dice {
    /// Creates the sequence of a body.
    pub(super) fn new(kind: BodyKind, seed: u64) -> Self {
        Self::Seed(hash(seed, &[0xb0d1e5, kind as i64]), 0)
    }

    /// Draws a value in a range.
    pub(super) fn between(&mut self, [low, high]: [f64; 2]) -> f64 {
        low + (high - low) * self.share().unwrap_or(0.5)
    }

    /// Draws an item of a list that is not empty.
    pub(super) fn pick<T: Copy, const N: usize>(&mut self, list: &[T; N]) -> T {
        list[self.share().map_or(0, |share| (share * N as f64) as usize)]
    }

    /// Draws `true` with this probability.
    pub(super) fn chance(&mut self, share: f64) -> bool {
        self.share().is_some_and(|drawn| drawn < share)
    }

    fn share(&mut self) -> Option<f64> {
        let Self::Seed(seed, drawn) = self else { return None };
        *drawn += 1;
        Some(unit(*seed, &[*drawn]))
    }
}
