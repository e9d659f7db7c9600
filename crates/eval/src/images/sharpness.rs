use image::RgbImage;

use super::luma::luma;

/// Computes the mean gradient magnitude of luma, levels per pixel: `sqrt(dx² + dy²)` of the differences to
/// the next column and the next row, over all pixels that have both. `None` for images of a single row or
/// column.
pub fn sharpness(image: &RgbImage) -> Option<f64> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    if width < 2 || height < 2 {
        return None;
    }
    let luma = luma(image);
    let row = |y: usize| -> f64 {
        let (here, below) = (&luma[y * width..][..width], &luma[(y + 1) * width..][..width]);
        (0..width - 1).map(|x| (here[x + 1] - here[x]).hypot(below[x] - here[x])).sum()
    };
    Some((0..height - 1).map(row).sum::<f64>() / ((width - 1) * (height - 1)) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sharpness_of_a_ramp_is_its_slope() {
        let ramp = RgbImage::from_fn(9, 7, |x, y| image::Rgb([(3 * x + 4 * y) as u8; 3]));
        assert!((sharpness(&ramp).unwrap() - 5.0).abs() < 1e-12);
        let green = RgbImage::from_fn(9, 7, |x, _| image::Rgb([0, 10 * x as u8, 0]));
        assert!((sharpness(&green).unwrap() - 5.87).abs() < 1e-12);
        assert_eq!(sharpness(&RgbImage::new(5, 5)), Some(0.0));
        assert_eq!(sharpness(&RgbImage::new(5, 1)), None);
    }
}
