use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rand_seeder::Seeder;

use crate::{Latent, LatentShape};

/// Source of the noise that new frames start from.
pub trait NoiseSource {
    /// Returns unit-variance noise for draw number `draw` of frame `frame`. Repeated calls return the same
    /// noise.
    fn noise(&mut self, shape: LatentShape, frame: usize, draw: usize) -> Latent;
}

/// Gaussian noise, determined by a seed, the frame number and the draw number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GaussianNoise {
    /// Random seed.
    pub seed: u64,
}

impl NoiseSource for GaussianNoise {
    fn noise(&mut self, shape: LatentShape, frame: usize, draw: usize) -> Latent {
        let mut random: ChaCha8Rng = Seeder::from((self.seed, frame as u64, draw as u64)).into_rng();
        let mut latent = Latent::filled(shape, 0.0);
        latent.values_mut().fill_with(|| StandardNormal.sample(&mut random));
        latent
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_normal_and_reproducible() {
        let shape = LatentShape { views: 2, channels: 48, height: 16, width: 28 };
        let mut source = GaussianNoise { seed: 5 };
        let noise = source.noise(shape, 3, 1);
        assert_eq!(noise, source.noise(shape, 3, 1));
        for other in [
            source.noise(shape, 3, 2),
            source.noise(shape, 1, 3),
            GaussianNoise { seed: 6 }.noise(shape, 3, 1),
        ] {
            let product: f64 = noise.values().iter().zip(other.values()).map(|(a, b)| f64::from(a * b)).sum();
            assert!((product / shape.len() as f64).abs() < 0.02);
        }
        let moment =
            |n: i32| noise.values().iter().map(|v| f64::from(*v).powi(n)).sum::<f64>() / shape.len() as f64;
        // With 43 008 values, these bounds are five standard errors.
        assert!(moment(1).abs() < 0.025 && (moment(2) - 1.0).abs() < 0.035 && (moment(4) - 3.0).abs() < 0.24);
    }
}
