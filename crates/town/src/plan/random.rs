use rand_chacha::ChaCha8Rng;
use rand_core::Rng as _;
use rand_seeder::Seeder;

/// Random number generator with the same sequence on every machine.
#[derive(Clone, Debug)]
pub(super) struct Random(ChaCha8Rng);

impl Random {
    /// Creates a generator from the town's seed, a purpose and a number.
    pub(super) fn new(seed: u64, purpose: &str, number: u64) -> Self {
        Self(Seeder::from((seed, purpose, number)).into_rng())
    }

    /// Returns 64 random bits.
    pub(super) fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// Returns a uniform value in `[low, high)`.
    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * ((self.bits() >> 11) as f64 / (1_u64 << 53) as f64)
    }

    /// Returns `true` with the given probability.
    pub(super) fn chance(&mut self, probability: f64) -> bool {
        self.between(0.0, 1.0) < probability
    }

    /// Returns a uniform index below `count`, which must not be 0.
    pub(super) fn index(&mut self, count: usize) -> usize {
        ((self.between(0.0, 1.0) * count as f64) as usize).min(count.saturating_sub(1))
    }

    /// Picks an item by weight; the last if all weights are 0, `None` if there are no items.
    pub(super) fn weighted<T: Copy>(&mut self, choices: &[(T, f64)]) -> Option<T> {
        let mut left = self.between(0.0, 1.0) * choices.iter().map(|c| c.1).sum::<f64>();
        for (choice, weight) in choices {
            left -= weight;
            if left < 0.0 {
                return Some(*choice);
            }
        }
        choices.last().map(|c| c.0)
    }

    /// Shuffles items in place.
    pub(super) fn shuffle<T>(&mut self, items: &mut [T]) {
        for i in (1..items.len()).rev() {
            items.swap(i, self.index(i + 1));
        }
    }
}
