use image::RgbImage;

/// Side of the Gaussian window, pixels.
const SIDE: usize = 11;
/// Standard deviation of the Gaussian window, pixels.
const SIGMA: f64 = 1.5;
/// `(K1·L)²` and `(K2·L)²` for K1 = 0.01, K2 = 0.03 and levels up to L = 255.
const C1: f64 = 2.55 * 2.55;
const C2: f64 = 7.65 * 7.65;

/// Computes the structural similarity of two RGB images of one size, at most 1 (equal). `None` if the sizes
/// differ, or if the images are smaller than the window.
///
/// Z. Wang et al., *Image quality assessment: from error visibility to structural similarity*, 2004, equation
/// 13, with a Gaussian window of 11x11 pixels and a standard deviation of 1.5, K1 = 0.01, K2 = 0.03, and a
/// range of 255 levels. The similarity is averaged over all positions where the window lies within the image
/// (no padding), for each of R, G and B, and then over the three. The images are not downsampled first.
pub fn ssim(image: &RgbImage, truth: &RgbImage) -> Option<f64> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    if image.dimensions() != truth.dimensions() || width < SIDE || height < SIDE {
        return None;
    }
    let channel = |c: usize| {
        let plane = |image: &RgbImage| image.pixels().map(|p| f64::from(p.0[c])).collect::<Vec<f64>>();
        similarity(&plane(image), &plane(truth), width)
    };
    Some((0..3).map(channel).sum::<f64>() / 3.0)
}

/// Returns the mean similarity of two planes `[H, W]` of levels.
fn similarity(x: &[f64], y: &[f64], width: usize) -> f64 {
    let weights = weights();
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<f64>>();
    let blur = |plane: &[f64]| blurred(plane, width, &weights);
    let (mean_x, mean_y) = (blur(x), blur(y));
    let (xx, yy, xy) = (blur(&product(x, x)), blur(&product(y, y)), blur(&product(x, y)));
    let at = |i: usize| {
        let (mx, my) = (mean_x[i], mean_y[i]);
        let (var_x, var_y, covariance) = (xx[i] - mx * mx, yy[i] - my * my, xy[i] - mx * my);
        ((2.0 * mx * my + C1) * (2.0 * covariance + C2)) / ((mx * mx + my * my + C1) * (var_x + var_y + C2))
    };
    (0..mean_x.len()).map(at).sum::<f64>() / mean_x.len() as f64
}

/// Returns the weights of the window along one axis, with sum 1.
fn weights() -> [f64; SIDE] {
    let raw: [f64; SIDE] = std::array::from_fn(|i| {
        let off = i as f64 - (SIDE / 2) as f64;
        (-off * off / (2.0 * SIGMA * SIGMA)).exp()
    });
    let sum: f64 = raw.iter().sum();
    raw.map(|w| w / sum)
}

/// Blurs along both axes, only where the window lies within the plane: `[H-10, W-10]`.
fn blurred(plane: &[f64], width: usize, weights: &[f64; SIDE]) -> Vec<f64> {
    let across: Vec<f64> = plane
        .chunks_exact(width)
        .flat_map(|row| row.windows(SIDE).map(|w| w.iter().zip(weights).map(|(v, w)| v * w).sum()))
        .collect();
    let narrow = width - SIDE + 1;
    let rows = across.len() / narrow;
    let value = |row: usize, column: usize| -> f64 {
        weights.iter().enumerate().map(|(k, w)| w * across[(row + k) * narrow + column]).sum()
    };
    (0..=rows - SIDE)
        .flat_map(|row| (0..narrow).map(move |column| (row, column)))
        .map(|(r, c)| value(r, c))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_images_have_ssim_1_and_small_images_have_none() {
        let image = RgbImage::from_fn(16, 12, |x, y| image::Rgb([7 * x as u8, 9 * y as u8, (x * y) as u8]));
        assert!((ssim(&image, &image).unwrap() - 1.0).abs() < 1e-12);
        assert_eq!(ssim(&image, &RgbImage::new(12, 16)), None);
        assert_eq!(ssim(&RgbImage::new(10, 40), &RgbImage::new(10, 40)), None);
        assert!(ssim(&RgbImage::new(11, 11), &RgbImage::new(11, 11)).is_some());
    }

    #[test]
    fn flat_images_differ_only_in_their_means() {
        let flat = |level: u8| RgbImage::from_pixel(20, 20, image::Rgb([level; 3]));
        let (a, b) = (40.0, 90.0);
        let expected = (2.0 * a * b + C1) / (a * a + b * b + C1);
        assert!((ssim(&flat(40), &flat(90)).unwrap() - expected).abs() < 1e-9);
    }
}
