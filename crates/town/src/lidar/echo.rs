//! Return of a LiDAR beam.

use std::f64::consts::TAU;

use point_skeleton::hash::unit;

use super::solid::Hit;
use crate::mesh::Surface;

/// Standard deviation of a range, meters.
pub(super) const NOISE_M: f64 = 0.015;
/// Share of beams that are lost on any surface.
pub(super) const LOST: f64 = 0.015;

/// Noise model of beams.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Noise {
    /// Every beam returns its exact range.
    None,
    /// Range noise and losses as in real sensors, derived from the seed.
    Seeded(u64),
}

/// Returns the range in meters and the intensity, 0 to 255, of a beam; `None` if it is lost. `facing` is the
/// cosine of the angle between beam and normal, `beam` is the beam's index, unique within a sweep.
pub(super) fn echo(hit: &Hit, facing: f64, noise: Noise, beam: i64) -> Option<(f64, f32)> {
    let facing = facing.abs();
    let intensity = (255.0 * reflectance(hit) * facing.sqrt()).clamp(0.0, 255.0).round() as f32;
    let Noise::Seeded(seed) = noise else { return Some((hit.t, intensity)) };
    let lost = unit(seed, &[beam, 0]) < LOST || unit(seed, &[beam, 1]) < vanishing(hit, facing);
    (!lost).then(|| (hit.t + NOISE_M * normal(seed, beam), intensity))
}

/// Returns whether a surface is a window of a house or of a car.
pub(super) fn is_glass(hit: &Hit) -> bool {
    [Surface::Window, Surface::CarGlass].iter().any(|surface| hit.surface == *surface as u8)
}

/// Returns the share of light that is reflected, 0 to 1.
fn reflectance(hit: &Hit) -> f64 {
    const MIRRORS_BACK: [Surface; 2] = [Surface::Paint, Surface::Sign];
    let is = |surface: &Surface| hit.surface == *surface as u8;
    if MIRRORS_BACK.iter().any(is) {
        return 0.8;
    }
    if is_glass(hit) {
        return 0.05;
    }
    0.05 + 0.55 * brightness(hit)
}

/// Returns the approximate linear brightness of the sRGB color, 0 to 1.
fn brightness(hit: &Hit) -> f64 {
    let [r, g, b] = hit.rgb.map(|level| (f64::from(level) / 255.0).powi(2));
    0.3 * r + 0.6 * g + 0.1 * b
}

/// Returns the share of beams lost on this surface: glass transmits or mirrors them, dark paint mirrors them
/// at grazing angles.
fn vanishing(hit: &Hit, facing: f64) -> f64 {
    let is = |surface: Surface| hit.surface == surface as u8;
    if is_glass(hit) {
        return 1.0 - 0.3 * facing.powi(2);
    }
    if is(Surface::CarPaint) {
        return (1.0 - brightness(hit)).powi(2) * (1.0 - facing).powi(3) * 0.9;
    }
    0.0
}

/// Returns a normally distributed value with variance 1 (Box and Muller).
fn normal(seed: u64, beam: i64) -> f64 {
    let radius = (-2.0 * (1.0 - unit(seed, &[beam, 2])).ln()).sqrt();
    radius * (TAU * unit(seed, &[beam, 3])).cos()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn hit(rgb: [u8; 3], surface: Surface) -> Hit {
        Hit { t: 20.0, normal: DVec3::NEG_X, rgb, surface: surface as u8 }
    }

    #[test]
    fn noiseless_beams_return_exact_ranges() {
        let grey = hit([128; 3], Surface::Plaster);
        let (range_m, intensity) = echo(&grey, -0.25, Noise::None, 3).unwrap();
        let expected = 255.0 * (0.05 + 0.55 * (128.0_f64 / 255.0).powi(2)) * 0.5;
        assert_eq!((range_m, intensity), (20.0, expected.round() as f32));
    }

    /// Uses 20000 beams; bounds are five standard deviations of the measured quantities.
    #[test]
    fn noise_has_expected_spread_and_losses() {
        const BEAMS: i64 = 20_000;
        let n = BEAMS as f64;
        let all = |hit: &Hit, facing: f64| -> Vec<f64> {
            (0..BEAMS).filter_map(|i| Some(echo(hit, facing, Noise::Seeded(9), i)?.0 - 20.0)).collect()
        };
        let errors = all(&hit([200; 3], Surface::Plaster), -1.0);
        let lost = 1.0 - errors.len() as f64 / n;
        assert!((lost - LOST).abs() < 5.0 * (LOST / n).sqrt(), "{lost}");
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        assert!(mean.abs() < 5.0 * NOISE_M / n.sqrt(), "{mean}");
        let deviation = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        assert!((deviation - NOISE_M).abs() < 5.0 * NOISE_M / (2.0 * n).sqrt(), "{deviation}");
        let within = errors.iter().filter(|e| e.abs() < NOISE_M).count() as f64 / errors.len() as f64;
        assert!((within - 0.6827).abs() < 5.0 * (0.6827 * 0.3173 / n).sqrt(), "{within}");
        let retained = |surface, rgb, facing| all(&hit(rgb, surface), facing).len() as f64 / n;
        let glass = retained(Surface::CarGlass, [40; 3], -1.0);
        assert!((glass - 0.3 * (1.0 - LOST)).abs() < 5.0 * (0.21 / n).sqrt(), "{glass}");
        assert!(retained(Surface::CarPaint, [0; 3], -0.05) < 0.3);
        assert!(
            retained(Surface::CarPaint, [255; 3], -0.05) > 0.97
                && retained(Surface::CarPaint, [0; 3], -1.0) > 0.97
        );
    }
}
