use image::RgbImage;

/// Returns the luma of an image, levels of 255, row by row: ITU-R BT.601, 0.299 R + 0.587 G + 0.114 B.
pub(crate) fn luma(image: &RgbImage) -> Vec<f64> {
    let of = |pixel: &image::Rgb<u8>| {
        let [r, g, b] = pixel.0.map(f64::from);
        0.299 * r + 0.587 * g + 0.114 * b
    };
    image.pixels().map(of).collect()
}
