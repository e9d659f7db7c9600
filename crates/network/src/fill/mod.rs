//! Filling of holes by pull–push: pyramids of weighted means. Source: Gortler et al., "The Lumigraph", 1996.

pub(super) mod filled;

use super::kernels::neighbors;

/// Value of images without any known pixel.
const UNKNOWN: f32 = 0.5;

/// Returns the pixels of a color image, with unknown ones filled from known ones; both have one entry per
/// pixel, row by row. Without any known pixel the result is gray.
pub fn fill_holes(color: &[[u8; 3]], known: &[bool], width: usize) -> Vec<[u8; 3]> {
    let values =
        color.iter().map(|pixel| pixel.map(f32::from)).map(|pixel| pixel.map(|c| c / 255.0)).collect();
    let byte = |level: f32| (level * 255.0).round() as u8; // saturates
    fill(values, known, width).into_iter().map(|pixel| pixel.map(byte)).collect()
}

/// One level of the pyramid.
struct Level<const C: usize> {
    width: usize,
    values: Vec<[f32; C]>,
    weights: Vec<f32>,
}

/// Returns an image whose unknown pixels are filled from known ones; `values` and `known` are `[H, W]`.
pub(super) fn fill<const C: usize>(values: Vec<[f32; C]>, known: &[bool], width: usize) -> Vec<[f32; C]> {
    let weights = known.iter().map(|known| if *known { 1.0 } else { 0.0 }).collect();
    let mut levels = vec![Level { width, values, weights }];
    while let Some(last) = levels.last().filter(|level| level.values.len() > 1) {
        levels.push(last.halved());
    }
    let mut filled: Option<(Vec<[f32; C]>, usize)> = None;
    for level in levels.into_iter().rev() {
        let behind = filled.take();
        let of = |i: usize| match &behind {
            Some((values, width)) => between(values, *width, [i / level.width, i % level.width]),
            None => [UNKNOWN; C],
        };
        let mixed = |i: usize| {
            let (own, weight, other) = (level.values[i], level.weights[i], of(i));
            std::array::from_fn(|c| weight * own[c] + (1.0 - weight) * other[c])
        };
        filled = Some(((0..level.values.len()).map(mixed).collect(), level.width));
    }
    filled.map_or_else(Vec::new, |(values, _)| values)
}

impl<const C: usize> Level<C> {
    /// Returns the level of half the size: means weighted by what is known; weights are sums, at most 1.
    fn halved(&self) -> Self {
        let height = self.values.len() / self.width;
        let (low, width) = (height.div_ceil(2), self.width.div_ceil(2));
        let (mut values, mut weights) = (Vec::with_capacity(low * width), Vec::with_capacity(low * width));
        for (y, x) in (0..low).flat_map(|y| (0..width).map(move |x| (y, x))) {
            let (mut sums, mut total) = ([0.0; C], 0.0);
            for (y, x) in [(2 * y, 2 * x), (2 * y, 2 * x + 1), (2 * y + 1, 2 * x), (2 * y + 1, 2 * x + 1)] {
                if y < height && x < self.width {
                    let weight = self.weights[y * self.width + x];
                    total += weight;
                    let value = &self.values[y * self.width + x];
                    sums.iter_mut().zip(value).for_each(|(sum, value)| *sum += weight * value);
                }
            }
            let scale = if total > 0.0 { 1.0 / total } else { 0.0 };
            values.push(sums.map(|sum| sum * scale));
            weights.push(total.min(1.0));
        }
        Self { width, values, weights }
    }
}

/// Returns the bilinear value of a pixel in the image at twice the size.
fn between<const C: usize>(values: &[[f32; C]], width: usize, [y, x]: [usize; 2]) -> [f32; C] {
    let height = values.len() / width;
    let mut sums = [0.0; C];
    for (y, down) in neighbors(y, height) {
        for (x, across) in neighbors(x, width) {
            let value = &values[y * width + x];
            sums.iter_mut().zip(value).for_each(|(sum, value)| *sum += down * across * value);
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn byte_fill_matches_float_fill() {
        let color: Vec<[u8; 3]> = (0..35).map(|i| [i * 7, 255 - i, 3]).collect();
        let all = vec![true; 35];
        assert_eq!(fill_holes(&color, &all, 7), color, "known pixels stay");
        let known: Vec<bool> = (0..35).map(|i| i % 5 == 0).collect();
        let levels = color.iter().map(|pixel| pixel.map(|c| f32::from(c) / 255.0)).collect();
        let expected = fill(levels, &known, 7);
        for ((filled, level), (pixel, known)) in
            fill_holes(&color, &known, 7).into_iter().zip(expected).zip(color.iter().zip(&known))
        {
            assert_eq!(filled, level.map(|c| (c * 255.0).round() as u8));
            assert!(!known || filled == *pixel);
        }
        assert_eq!(fill_holes(&color, &[false; 35], 7), vec![[128; 3]; 35]);
    }

    #[test]
    fn keeps_known_pixels_and_extends_constants() {
        let (width, height) = (7, 5);
        let known: Vec<bool> = (0..width * height).map(|i| i % 9 == 4).collect();
        let values = known.iter().map(|known| if *known { [0.3, 0.7] } else { [9.0, -9.0] }).collect();
        let filled = fill(values, &known, width);
        assert!(filled.iter().all(|[a, b]| (a - 0.3).abs() < 1e-6 && (b - 0.7).abs() < 1e-6), "{filled:?}");
        let steps: Vec<[f32; 1]> = (0..width * height).map(|i| [i as f32]).collect();
        let filled = fill(steps.clone(), &known, width);
        assert!(known.iter().zip(filled.iter().zip(&steps)).all(|(known, (a, b))| !known || a == b));
        // Holes are between their neighbors.
        assert!(filled.iter().flatten().all(|v| (4.0..=31.0).contains(v)), "{filled:?}");
        assert_eq!(fill(vec![[1.0]; 6], &[false; 6], 3), vec![[UNKNOWN]; 6]);
    }
}
