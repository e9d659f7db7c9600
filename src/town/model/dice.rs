//! Numbers that a body's looks are drawn from.

use crate::town::hash::{hash, unit};

/// Draws numbers one after the other, always the same of a seed, or none at all: the typical ones.
#[derive(Clone, Debug)]
pub(super) enum Dice {
    /// A seed and how many were drawn.
    Seed(u64, i64),
    /// The middle of a range, the first of a list, nothing that only some have.
    Typical,
}

impl Dice {
    /// The dice of a body.
    pub(super) fn new(kind: super::BodyKind, seed: u64) -> Self {
        Self::Seed(hash(seed, &[0xb0d1e5, kind as i64]), 0)
    }

    /// In a range.
    pub(super) fn between(&mut self, [low, high]: [f64; 2]) -> f64 {
        low + (high - low) * self.share().unwrap_or(0.5)
    }

    /// One of a list that is not empty.
    pub(super) fn pick<T: Copy, const N: usize>(&mut self, list: &[T; N]) -> T {
        list[self.share().map_or(0, |share| (share * N as f64) as usize)]
    }

    /// True in this share of cases.
    pub(super) fn chance(&mut self, share: f64) -> bool {
        self.share().is_some_and(|drawn| drawn < share)
    }

    fn share(&mut self) -> Option<f64> {
        let Self::Seed(seed, drawn) = self else { return None };
        *drawn += 1;
        Some(unit(*seed, &[*drawn]))
    }
}
