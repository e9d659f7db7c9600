use std::hash::{Hash, Hasher};

/// Source of the random numbers of one draw.
#[derive(Clone, Copy, Debug)]
pub(super) struct Draw {
    pub(super) family: &'static str,
    pub(super) seed: u64,
    pub(super) number: u64,
}

impl Draw {
    /// Returns the number of a purpose: uniform in a range, by family, seed and number of the draw alone.
    pub(super) fn uniform(self, purpose: &str, min: f64, max: f64) -> f64 {
        let mut hasher = rand_seeder::SipHasher::new();
        (self.family, self.seed, self.number, purpose).hash(&mut hasher);
        // 53 bits, all of which a number can hold.
        min + (max - min) * ((hasher.finish() >> 11) as f64 / (1_u64 << 53) as f64)
    }

    /// Returns 1 or -1.
    pub(super) fn sign(self, purpose: &str) -> f64 {
        if self.uniform(purpose, 0.0, 1.0) < 0.5 { -1.0 } else { 1.0 }
    }

    /// Returns one of some items; `None` if there are none.
    pub(super) fn of<T: Copy>(self, purpose: &str, items: &[T]) -> Option<T> {
        items.get(self.uniform(purpose, 0.0, items.len() as f64) as usize).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_depend_on_seed_and_purpose_alone() {
        let draw = |seed: u64| Draw { family: "side", seed, number: 3 };
        let numbers: Vec<f64> = (0..1000).map(|seed| draw(seed).uniform("a", 2.0, 4.0)).collect();
        assert!(numbers.iter().all(|number| (2.0..4.0).contains(number)));
        let mean = numbers.iter().sum::<f64>() / 1000.0;
        assert!((mean - 3.0).abs() < 0.06, "{mean}"); // 3 standard deviations
        assert_eq!(draw(7).uniform("a", 0.0, 1.0), draw(7).uniform("a", 0.0, 1.0));
        assert_ne!(draw(7).uniform("a", 0.0, 1.0), draw(7).uniform("b", 0.0, 1.0));
        assert_eq!(draw(1).of::<u8>("x", &[]), None);
    }
}
