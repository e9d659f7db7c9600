//! Preconditioning of the network: its input and output at a noise level.
//!
//! # How it works
//! A noisy latent is `x = (1-s) x0 + s e`. The conditions of a patch give a guess `mu` of `x0`, whose error
//! has a standard deviation `p` per channel. With `y = x - (1-s) mu` and `D = (1-s)^2 p^2 + s^2`, the
//! variance of `y`, the best linear estimate (Wiener, 1949) of `x0` is `mu + a y` with `a = (1-s) p^2 / D`.
//! Its error has the variance `c^2 = s^2 p^2 / D`. The network's input is `y / sqrt D`, and its output `F` is
//! that error in units of `c`: `x0 = mu + a y + c F`. Input and target output therefore have unit variance at
//! all levels and in all channels where the error of the guess is `p`. `p` is set to the expected error of
//! the trained network, so the variance is larger at the beginning of training. Source: Karras et al.,
//! "Elucidating the Design Space of Diffusion-Based Generative Models", 2022, section 5, for `mu = 0` and a
//! single `p`.

use candle_core::{Device, Result, Tensor};

/// Minimum noise level in the computation of velocities; prevents division by 0.
const SIGMA_MIN: f32 = 0.005;

/// Preconditioning factors of frames (F) and channels (C). Latents are rows `[R, C]`; each frame has `R / F`
/// consecutive rows.
#[derive(Debug)]
pub(crate) struct Levels<'a> {
    sigmas: &'a [f32],
    priors: &'a [f32],
}

/// Returns `D`, the variance of `y`.
fn variance(s: f64, p: f64) -> f64 {
    (1.0 - s).powi(2) * p * p + s * s
}

impl<'a> Levels<'a> {
    /// Creates the factors for frames with noise `sigmas [F]` and channels whose guess has errors `priors
    /// [C]`.
    pub(crate) fn new(sigmas: &'a [f32], priors: &'a [f32]) -> Self {
        Self { sigmas, priors }
    }

    /// Returns a factor per frame and channel, `[F, 1, C]`.
    fn factors(&self, of: impl Fn(f64, f64) -> f64) -> Result<Tensor> {
        let of = |s: &f32, p: &f32| of(f64::from(*s), f64::from(*p)) as f32;
        let values: Vec<f32> = self
            .sigmas
            .iter()
            .flat_map(|s| self.priors.iter().map(move |p| (s, p)))
            .map(|(s, p)| of(s, p))
            .collect();
        Tensor::from_vec(values, (self.sigmas.len(), 1, self.priors.len()), &Device::Cpu)
    }

    /// Multiplies rows by a factor per frame and channel.
    fn times(&self, rows: &Tensor, of: impl Fn(f64, f64) -> f64) -> Result<Tensor> {
        let (count, channels) = rows.dims2()?;
        let frames = self.sigmas.len();
        let scaled = rows.reshape((frames, count / frames, channels))?.broadcast_mul(&self.factors(of)?)?;
        scaled.reshape((count, channels))
    }

    /// Returns `y` of rows `x` and `mu`.
    fn residual(&self, noisy: &Tensor, guess: &Tensor) -> Result<Tensor> {
        noisy - self.times(guess, |s, _| 1.0 - s)?
    }

    /// Returns `y / sqrt D`, the network's input.
    pub(crate) fn shown(&self, noisy: &Tensor, guess: &Tensor) -> Result<Tensor> {
        self.times(&self.residual(noisy, guess)?, |s, p| 1.0 / variance(s, p).sqrt())
    }

    /// Returns `mu + a y + c F`, the clean latent.
    pub(crate) fn clean(&self, noisy: &Tensor, guess: &Tensor, answer: &Tensor) -> Result<Tensor> {
        let known = self.times(&self.residual(noisy, guess)?, |s, p| (1.0 - s) * p * p / variance(s, p))?;
        let missing = self.times(answer, |s, p| s * p / variance(s, p).sqrt())?;
        (guess + known)? + missing
    }

    /// Returns the target `F`, for which [`Levels::clean`] is `x0` if `x = (1-s) x0 + s e`. `F` is
    /// `(s (x0 - mu) / p - (1-s) p e) / sqrt D`, which equals `(x0 - mu - a y) / c` without the cancellation
    /// of nearly equal terms.
    pub(crate) fn answer(&self, clean: &Tensor, guess: &Tensor, noise: &Tensor) -> Result<Tensor> {
        let off = self.times(&(clean - guess)?, |s, p| s / (p * variance(s, p).sqrt()))?;
        let noise = self.times(noise, |s, p| (1.0 - s) * p / variance(s, p).sqrt())?;
        off - noise
    }

    /// Returns the velocity `(x - x0) / s` that leads to a clean latent.
    pub(crate) fn velocity(&self, noisy: &Tensor, clean: &Tensor) -> Result<Tensor> {
        self.times(&(noisy - clean)?, |s, _| 1.0 / s.max(f64::from(SIGMA_MIN)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PRIORS: [f32; 3] = [0.05, 0.4, 1.0];
    const ROWS: usize = 4;

    fn rows(values: impl Fn(usize) -> f32) -> Tensor {
        let values: Vec<f32> = (0..ROWS * 3).map(values).collect();
        Tensor::from_vec(values, (ROWS, 3), &Device::Cpu).unwrap()
    }

    fn off(a: &Tensor, b: &Tensor) -> f32 {
        (a - b).unwrap().abs().unwrap().max_all().unwrap().to_scalar().unwrap()
    }

    fn mixed(clean: &Tensor, noise: &Tensor, s: f64) -> Tensor {
        ((clean * (1.0 - s)).unwrap() + (noise * s).unwrap()).unwrap()
    }

    #[test]
    fn exact_answer_recovers_the_clean_latent() {
        let (clean, guess) = (rows(|i| (i as f32).sin()), rows(|i| 0.5 * (i as f32).cos()));
        let noise = rows(|i| (1.7 * i as f32).cos());
        for sigma in [0.0025_f32, 0.01, 0.3, 0.8, 0.97, 1.0] {
            let sigmas = [sigma, sigma];
            let levels = Levels::new(&sigmas, &PRIORS);
            let noisy = mixed(&clean, &noise, f64::from(sigma));
            let answer = levels.answer(&clean, &guess, &noise).unwrap();
            let found = levels.clean(&noisy, &guess, &answer).unwrap();
            assert!(off(&found, &clean) < 2e-5, "{sigma}: {found}");
            let velocity = levels.velocity(&noisy, &clean).unwrap();
            let (expected, within) = ((&noise - &clean).unwrap(), 1e-4);
            assert_eq!(off(&velocity, &expected) < within, sigma > 0.005, "{sigma}");
        }
    }

    #[test]
    fn limits_at_no_noise_and_full_noise() {
        let (noisy, guess, answer) =
            (rows(|i| (i as f32).sin()), rows(|i| (i as f32).cos()), rows(|i| (2.0 * i as f32).sin()));
        let faint = Levels::new(&[1e-5, 1e-5], &PRIORS).clean(&noisy, &guess, &answer).unwrap();
        assert!(off(&faint, &noisy) < 1e-4);
        let noise = Levels::new(&[1.0, 1.0], &PRIORS);
        let scaled = rows(|i| PRIORS[i % 3] * (2.0 * i as f32).sin());
        assert!(off(&noise.clean(&noisy, &guess, &answer).unwrap(), &(&guess + scaled).unwrap()) < 1e-6);
        assert!(off(&noise.shown(&noisy, &guess).unwrap(), &noisy) < 1e-6);
        // Each frame's rows use the level of that frame.
        let both = Levels::new(&[1.0, 1e-5], &PRIORS).clean(&noisy, &guess, &answer).unwrap();
        assert!(off(&both.narrow(0, 2, 2).unwrap(), &noisy.narrow(0, 2, 2).unwrap()) < 1e-4);
        assert!(off(&both, &noisy) > 0.1);
    }

    /// If the error of the guess is `p`, input and target have unit variance and are not correlated: no
    /// linear relation is left to learn.
    #[test]
    fn input_and_answer_have_unit_variance() {
        use pskel_generate::{GaussianNoise, LatentShape, NoiseSource};
        let (count, p) = (40_000, 0.3_f32);
        let shape = LatentShape { views: 1, channels: 1, height: 1, width: count };
        let normal = |draw| {
            let values = GaussianNoise { seed: 4 }.noise(shape, 0, draw).values().to_vec();
            Tensor::from_vec(values, (count, 1), &Device::Cpu).unwrap()
        };
        let (guess, noise) = (normal(0), normal(1));
        let clean = (&guess + (normal(2) * f64::from(p)).unwrap()).unwrap();
        let mean = |a: &Tensor, b: &Tensor| (a * b).unwrap().mean_all().unwrap().to_scalar::<f32>().unwrap();
        for sigma in [0.01_f32, 0.2, 0.5, 0.9, 1.0] {
            let (sigmas, priors) = ([sigma], [p]);
            let levels = Levels::new(&sigmas, &priors);
            let noisy = mixed(&clean, &noise, f64::from(sigma));
            let shown = levels.shown(&noisy, &guess).unwrap();
            let answer = levels.answer(&clean, &guess, &noise).unwrap();
            let found = [mean(&shown, &shown), mean(&answer, &answer), mean(&shown, &answer)];
            assert!(
                found.iter().zip([1.0, 1.0, 0.0]).all(|(a, b)| (a - b).abs() < 0.04),
                "{sigma}: {found:?}"
            );
        }
    }
}
