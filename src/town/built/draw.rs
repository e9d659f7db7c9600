use crate::town::hash::{between, hash, unit};

/// Draws one after the other that look random and follow from a seed.
#[derive(Clone, Debug)]
pub(super) struct Draw {
    seed: u64,
    count: i64,
}

impl Draw {
    /// The draws of one thing: a seed, and numbers that tell it from others.
    pub(super) fn new(seed: u64, parts: &[i64]) -> Self {
        Self { seed: hash(seed, parts), count: 0 }
    }

    fn next(&mut self) -> [i64; 1] {
        self.count += 1;
        [self.count]
    }

    /// Uniform in `[low, high)`.
    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        between(self.seed, &self.next(), low, high)
    }

    /// True so often out of one.
    pub(super) fn chance(&mut self, share: f64) -> bool {
        unit(self.seed, &self.next()) < share
    }

    /// An index below `count`, which is at least 1.
    pub(super) fn below(&mut self, count: usize) -> usize {
        ((unit(self.seed, &self.next()) * count as f64) as usize).min(count.saturating_sub(1))
    }

    /// One of several; there is at least one.
    pub(super) fn pick<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.below(of.len())]
    }

    /// Seed of a pattern or of other draws.
    pub(super) fn seed(&mut self) -> u64 {
        hash(self.seed, &self.next())
    }

    /// A color with its brightness off by at most so much, all channels alike.
    pub(super) fn shade(&mut self, rgb: [u8; 3], by: f64) -> [u8; 3] {
        let factor = 1.0 + self.between(-by, by);
        rgb.map(|c| (f64::from(c) * factor).clamp(0.0, 255.0) as u8)
    }
}
