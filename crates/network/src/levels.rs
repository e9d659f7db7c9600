//! Preconditioning of the network: its input and output at a noise level.
//!
//! # How it works
//! A noisy latent is `x = (1-s) x0 + s e`. The conditions of a place give a guess `mu` of `x0`, whose error
//! has a standard deviation `p` per channel. With `y = x - (1-s) mu` and `D = (1-s)^2 p^2 + s^2`, the
//! variance of `y`, the best linear estimate (Wiener, 1949) of `x0` is `mu + a y` with `a = (1-s) p^2 / D`.
//! Its error has the variance `c^2 = s^2 p^2 / D`. The network's input is `y / sqrt D`, and its output `F` is
//! that error in units of `c`: `x0 = mu + a y + c F`. Source: Karras et al., "Elucidating the Design Space of
//! Diffusion-Based Generative Models", 2022, section 5, for `mu = 0` and a single `p`.

/// Minimum noise level in the computation of velocities; prevents division by 0.
const SIGMA_MIN: f64 = 0.005;

/// Preconditioning of frames at their noise levels. Latents are rows `[R, C]`; each frame has `R / F`
/// consecutive rows.
#[derive(Debug)]
pub(crate) struct Levels<'a> {
    /// Noise of each frame, `[F]`.
    pub(crate) sigmas: &'a [f32],
    /// Expected error of the guess, `[C]`.
    pub(crate) priors: &'a [f32],
}

/// Returns `D`, the variance of `y`.
fn variance(s: f64, p: f64) -> f64 {
    (1.0 - s).powi(2) * p * p + s * s
}

impl Levels<'_> {
    /// Returns `y / sqrt D`, the network's input.
    pub(crate) fn shown(&self, noisy: &[f32], guess: &[f32]) -> Vec<f32> {
        let [kept, scale] = [self.factors(|s, _| 1.0 - s), self.factors(|s, p| 1.0 / variance(s, p).sqrt())];
        self.each(noisy.len(), |at, i| scale[at] * (noisy[i] - kept[at] * guess[i]))
    }

    /// Returns `mu + a y + c F`, the clean latent.
    pub(crate) fn clean(&self, noisy: &[f32], guess: &[f32], answer: &[f32]) -> Vec<f32> {
        let kept = self.factors(|s, _| 1.0 - s);
        let known = self.factors(|s, p| (1.0 - s) * p * p / variance(s, p));
        let missing = self.factors(|s, p| s * p / variance(s, p).sqrt());
        let of = |at: usize, i: usize| {
            guess[i] + known[at] * (noisy[i] - kept[at] * guess[i]) + missing[at] * answer[i]
        };
        self.each(noisy.len(), of)
    }

    /// Returns the velocity `(x - x0) / s` that leads to a clean latent.
    pub(crate) fn velocity(&self, noisy: &[f32], clean: &[f32]) -> Vec<f32> {
        let scale = self.factors(|s, _| 1.0 / s.max(SIGMA_MIN));
        self.each(noisy.len(), |at, i| scale[at] * (noisy[i] - clean[i]))
    }

    /// Returns a factor per frame and channel, `[F, C]`.
    fn factors(&self, of: impl Fn(f64, f64) -> f64) -> Vec<f32> {
        let pairs = self.sigmas.iter().flat_map(|s| self.priors.iter().map(move |p| (*s, *p)));
        pairs.map(|(s, p)| of(f64::from(s), f64::from(p)) as f32).collect()
    }

    /// Returns `len` values, each from the place of its factor and its own.
    fn each(&self, len: usize, of: impl Fn(usize, usize) -> f32) -> Vec<f32> {
        let (channels, per_frame) = (self.priors.len(), (len / self.sigmas.len().max(1)).max(1));
        (0..len).map(|i| of(i / per_frame * channels + i % channels, i)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PRIORS: [f32; 3] = [0.05, 0.4, 1.0];
    const LEN: usize = 12;

    fn rows(of: impl Fn(f32) -> f32) -> Vec<f32> {
        (0..LEN).map(|i| of(i as f32)).collect()
    }

    fn off(a: &[f32], b: &[f32]) -> f32 {
        a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    }

    /// The answer `F` for which [`Levels::clean`] returns `x0`.
    fn answer(sigma: f32, clean: &[f32], guess: &[f32], noise: &[f32]) -> Vec<f32> {
        let of = |i: usize| {
            let (s, p) = (f64::from(sigma), f64::from(PRIORS[i % 3]));
            let [clean, guess, noise] = [clean, guess, noise].map(|values| f64::from(values[i]));
            ((s * (clean - guess) / p - (1.0 - s) * p * noise) / variance(s, p).sqrt()) as f32
        };
        (0..LEN).map(of).collect()
    }

    #[test]
    fn exact_answer_recovers_the_clean_latent() {
        let (clean, guess, noise) = (rows(f32::sin), rows(|i| 0.5 * i.cos()), rows(|i| (1.7 * i).cos()));
        for sigma in [0.0025_f32, 0.01, 0.3, 0.8, 0.97, 1.0] {
            let levels = Levels { sigmas: &[sigma, sigma], priors: &PRIORS };
            let mixed = |i: usize| (1.0 - sigma) * clean[i] + sigma * noise[i];
            let noisy: Vec<f32> = (0..LEN).map(mixed).collect();
            let found = levels.clean(&noisy, &guess, &answer(sigma, &clean, &guess, &noise));
            assert!(off(&found, &clean) < 2e-5, "{sigma}: {found:?}");
            let velocity = levels.velocity(&noisy, &clean);
            let expected: Vec<f32> = (0..LEN).map(|i| noise[i] - clean[i]).collect();
            assert_eq!(off(&velocity, &expected) < 1e-4, sigma > 0.005, "{sigma}");
        }
    }

    #[test]
    fn limits_at_no_noise_and_full_noise() {
        let (noisy, guess, answer) = (rows(f32::sin), rows(f32::cos), rows(|i| (2.0 * i).sin()));
        let clean = |sigmas: &[f32]| Levels { sigmas, priors: &PRIORS }.clean(&noisy, &guess, &answer);
        assert!(off(&clean(&[1e-5, 1e-5]), &noisy) < 1e-4);
        let noise: Vec<f32> = (0..LEN).map(|i| guess[i] + PRIORS[i % 3] * answer[i]).collect();
        assert!(off(&clean(&[1.0, 1.0]), &noise) < 1e-6);
        let levels = Levels { sigmas: &[1.0, 1.0], priors: &PRIORS };
        assert!(off(&levels.shown(&noisy, &guess), &noisy) < 1e-6);
        // Each frame's rows use the level of that frame.
        let both = clean(&[1.0, 1e-5]);
        assert!(off(&both[6..], &noisy[6..]) < 1e-4 && off(&both[..6], &noise[..6]) < 1e-6);
    }
}
