use image::RgbImage;

/// Error of a color map against a ground-truth image, over the pixels that are filled (not black).
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct FilledError {
    /// Peak signal-to-noise ratio over all channels of filled pixels, dB: `10·log10(255² / mean squared
    /// error)`. Infinite for equal images, NaN if no pixel is filled.
    pub psnr_db: f64,
    /// Mean absolute error, levels.
    pub mean_abs: f64,
    /// Median absolute error, levels.
    pub median_abs: f64,
    /// Share of pixels filled, 0 to 1.
    pub filled: f64,
}

/// Compares a color map with a ground-truth image of the same size.
pub fn compare_filled(map: &[[u8; 3]], truth: &[[u8; 3]]) -> FilledError {
    let mut histogram = [0_u64; 256];
    let mut pixels = 0_u64;
    for (a, b) in map.iter().zip(truth).filter(|(a, _)| **a != [0; 3]) {
        pixels += 1;
        (0..3).for_each(|c| histogram[usize::from(a[c].abs_diff(b[c]))] += 1);
    }
    let count = pixels as f64 * 3.0;
    let mean = |power: i32| -> f64 {
        histogram.iter().enumerate().map(|(d, n)| (d as f64).powi(power) * *n as f64).sum::<f64>() / count
    };
    FilledError {
        psnr_db: 10.0 * (255.0_f64.powi(2) / mean(2)).log10(),
        mean_abs: mean(1),
        median_abs: median(&histogram, pixels * 3),
        filled: pixels as f64 / map.len() as f64,
    }
}

/// Computes the peak signal-to-noise ratio of two RGB images over all pixels and channels, dB: `10·log10(255²
/// / mean squared error)`. Infinite for equal images. `None` if the sizes differ, or if there are no pixels.
pub fn psnr_db(image: &RgbImage, truth: &RgbImage) -> Option<f64> {
    let (a, b) = (image.as_raw(), truth.as_raw());
    if image.dimensions() != truth.dimensions() || a.is_empty() {
        return None;
    }
    let squares: u64 = a.iter().zip(b).map(|(a, b)| u64::from(a.abs_diff(*b)).pow(2)).sum();
    Some(10.0 * (255.0_f64.powi(2) * a.len() as f64 / squares as f64).log10())
}

/// Returns the lower median of a level histogram.
fn median(histogram: &[u64; 256], count: u64) -> f64 {
    let mut below = 0;
    for (level, n) in histogram.iter().enumerate() {
        below += n;
        if below * 2 >= count && count > 0 {
            return level as f64;
        }
    }
    f64::NAN
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn computes_error_on_filled_pixels() {
        let map = [[0, 0, 0], [10, 10, 10], [20, 20, 26]];
        let truth = [[9, 9, 9], [10, 10, 10], [20, 24, 20]];
        let error = compare_filled(&map, &truth);
        assert!((error.filled - 2.0 / 3.0).abs() < 1e-12);
        assert!((error.mean_abs - 10.0 / 6.0).abs() < 1e-12);
        assert_eq!(error.median_abs, 0.0);
        assert!((error.psnr_db - 10.0 * (65025.0_f64 / (52.0 / 6.0)).log10()).abs() < 1e-12);
    }

    #[test]
    fn computes_psnr() {
        let image = |level: u8| RgbImage::from_pixel(3, 2, image::Rgb([level, 7, 9]));
        // One of three channels has an error of 6, so the mean squared error is 12.
        let expected = 10.0 * (65025.0_f64 / 12.0).log10();
        assert!((psnr_db(&image(20), &image(26)).unwrap() - expected).abs() < 1e-12);
        assert_eq!(psnr_db(&image(20), &image(20)), Some(f64::INFINITY));
        assert_eq!(psnr_db(&image(20), &RgbImage::new(2, 3)), None);
        assert_eq!(psnr_db(&RgbImage::new(0, 0), &RgbImage::new(0, 0)), None);
    }

    #[test]
    fn errors_are_nan_without_filled_pixels() {
        let error = compare_filled(&[[0; 3]], &[[1; 3]]);
        assert!(error.psnr_db.is_nan() && error.median_abs.is_nan());
        assert_eq!(error.filled, 0.0);
    }
}
