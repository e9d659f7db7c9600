use point_skeleton::hash::{between, hash, unit};

/// Pseudo-random sequence that depends only on a seed.
#[derive(Clone, Debug)]
pub(super) struct Draw {
    seed: u64,
    count: i64,
}

impl Draw {
    /// Creates the sequence of an object from a seed and numbers that identify the object.
    pub(super) fn new(seed: u64, parts: &[i64]) -> Self {
        Self { seed: hash(seed, parts), count: 0 }
    }

    fn next(&mut self) -> [i64; 1] {
        self.count += 1;
        [self.count]
    }

    /// Draws a uniform value in `[low, high)`.
    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        between(self.seed, &self.next(), low, high)
    }

    /// Draws `true` with this probability.
    pub(super) fn chance(&mut self, share: f64) -> bool {
        unit(self.seed, &self.next()) < share
    }

    /// Draws an index below `count`, which is at least 1.
    pub(super) fn below(&mut self, count: usize) -> usize {
        ((unit(self.seed, &self.next()) * count as f64) as usize).min(count.saturating_sub(1))
    }

    /// Draws an item of a list that is not empty.
    pub(super) fn pick<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.below(of.len())]
    }

    /// Draws a seed for a pattern or another sequence.
    pub(super) fn seed(&mut self) -> u64 {
        hash(self.seed, &self.next())
    }

    /// Returns a color with its brightness changed by at most the share `by`, the same for all channels.
    pub(super) fn shade(&mut self, rgb: [u8; 3], by: f64) -> [u8; 3] {
        let factor = 1.0 + self.between(-by, by);
        rgb.map(|c| (f64::from(c) * factor).clamp(0.0, 255.0) as u8)
    }
}
