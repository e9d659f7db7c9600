use image::RgbImage;
use pskel_generate::{Codec, DenoiserError, Latent, LatentShape};
use rayon::prelude::*;

use super::{NetworkConfig, NetworkError, Statistics};

/// Returns an orthonormal transform of patches, `[C, C]`: the DCT along y, along x and over the three colors, of
/// levels from 0 to 1. Row `(a p + ky) p + kx` is coefficient (ky, kx) of color axis `a` (0 is gray), column
/// `(c p + y) p + x` is a pixel. Source: Ahmed, Natarajan and Rao, "Discrete Cosine Transform", 1974 (DCT-II).
fn transform(patch: usize) -> Vec<f32> {
    let (space, color) = (cosines(patch), cosines(3));
    let channels = 3 * patch * patch;
    let parts = |i: usize| [i / (patch * patch), i / patch % patch, i % patch];
    let value = |i: usize| {
        let ([a, ky, kx], [c, y, x]) = (parts(i / channels), parts(i % channels));
        (color[a * 3 + c] * space[ky * patch + y] * space[kx * patch + x]) as f32
    };
    (0..channels * channels).map(value).collect()
}

/// Returns the orthonormal DCT of `n` values, `[n, n]`.
fn cosines(n: usize) -> Vec<f64> {
    let value = |i: usize| {
        let (k, x) = ((i / n) as f64, (i % n) as f64);
        let scale = if i / n == 0 { 1.0 } else { 2.0 } / n as f64;
        scale.sqrt() * (std::f64::consts::PI * (x + 0.5) * k / n as f64).cos()
    };
    (0..n * n).map(value).collect()
}

/// Linear codec whose latents are normalized DCT coefficients of patches.
#[derive(Clone, Debug)]
pub struct PatchCodec {
    shape: LatentShape,
    patch: usize,
    /// Transform of a patch, `[C, C]`.
    transform: Vec<f32>,
    means: Vec<f32>,
    scales: Vec<f32>,
}

impl PatchCodec {
    /// Creates the codec of a network.
    ///
    /// # Errors
    /// Returns an error if the configuration is inconsistent, or if the statistics have another number of channels.
    pub fn new(config: &NetworkConfig, statistics: &Statistics) -> Result<Self, NetworkError> {
        config.check_with(statistics)?;
        Ok(Self {
            shape: config.shape(),
            patch: config.patch,
            transform: transform(config.patch),
            means: statistics.means.clone(),
            scales: statistics.scales.clone(),
        })
    }

    /// Encodes a frame's pixels `[V, H, W]`, RGB, as rows `[V h w, C]`.
    pub(crate) fn encode_rows(&self, pixels: &[[u8; 3]]) -> Vec<f32> {
        let LatentShape { channels, height, width, .. } = self.shape;
        let p = self.patch;
        let mut rows = vec![0.0; self.shape.len()];
        rows.par_chunks_mut(channels).enumerate().for_each(|(row, out)| {
            let (x, line) = (row % width * p, row / width * p);
            debug_assert!(line / p < self.shape.views * height);
            let level = |i: usize| {
                let (color, dy, dx) = (i / (p * p), i / p % p, i % p);
                f32::from(pixels[(line + dy) * width * p + x + dx][color]) / 255.0
            };
            let levels: Vec<f32> = (0..channels).map(level).collect();
            for (channel, (out, axis)) in out.iter_mut().zip(self.transform.chunks(channels)).enumerate() {
                let coefficient: f32 = axis.iter().zip(&levels).map(|(a, b)| a * b).sum();
                *out = (coefficient - self.means[channel]) / self.scales[channel];
            }
        });
        rows
    }

    /// Decodes the image of a camera from rows of patches `[h w, C]`.
    fn image(&self, rows: &[f32]) -> RgbImage {
        let LatentShape { channels, height, width, .. } = self.shape;
        let p = self.patch;
        let mut image = RgbImage::new((width * p) as u32, (height * p) as u32);
        for (row, latent) in rows.chunks(channels).enumerate() {
            let mut levels = vec![0.0_f32; channels];
            for (channel, axis) in self.transform.chunks(channels).enumerate() {
                let coefficient = latent[channel] * self.scales[channel] + self.means[channel];
                levels.iter_mut().zip(axis).for_each(|(level, a)| *level += a * coefficient);
            }
            for (i, level) in levels.into_iter().enumerate() {
                let (color, y, x) = (i / (p * p), row / width * p + i / p % p, row % width * p + i % p);
                image.get_pixel_mut(x as u32, y as u32)[color] = (level * 255.0).round() as u8;
            }
        }
        image
    }
}

impl Codec for PatchCodec {
    fn shape(&self) -> LatentShape {
        self.shape
    }

    fn encode(&self, images: &[RgbImage]) -> Result<Latent, DenoiserError> {
        let LatentShape { views, height, width, .. } = self.shape;
        let size = ((width * self.patch) as u32, (height * self.patch) as u32);
        if images.len() != views {
            return Err(DenoiserError::input(format!("{views} images"), images.len().to_string()));
        }
        if let Some(other) = images.iter().find(|image| image.dimensions() != size) {
            let expected = format!("images of {}x{}", size.1, size.0);
            return Err(DenoiserError::input(expected, format!("{}x{}", other.height(), other.width())));
        }
        let pixels: Vec<[u8; 3]> = images.iter().flat_map(RgbImage::pixels).map(|pixel| pixel.0).collect();
        Ok(latent_of_rows(self.shape, &self.encode_rows(&pixels)))
    }

    fn decode(&self, latent: &Latent) -> Result<Vec<RgbImage>, DenoiserError> {
        if latent.shape() != self.shape {
            return Err(DenoiserError::input(
                format!("latents of {}", self.shape),
                latent.shape().to_string(),
            ));
        }
        let rows = rows_of_latent(latent);
        let per_camera = self.shape.len() / self.shape.views;
        Ok(rows.par_chunks(per_camera).map(|rows| self.image(rows)).collect())
    }
}

/// Reorders `[V, C, h, w]` into rows `[V h w, C]`.
pub(super) fn rows_of_latent(latent: &Latent) -> Vec<f32> {
    let LatentShape { channels, height, width, .. } = latent.shape();
    let places = height * width;
    let mut rows = vec![0.0; latent.shape().len()];
    let views = rows.chunks_mut(channels * places).zip(latent.values().chunks(channels * places));
    for (rows, planes) in views {
        for (channel, plane) in planes.chunks(places).enumerate() {
            plane.iter().enumerate().for_each(|(place, value)| rows[place * channels + channel] = *value);
        }
    }
    rows
}

/// Reorders rows `[V h w, C]` into `[V, C, h, w]`.
pub(super) fn latent_of_rows(shape: LatentShape, rows: &[f32]) -> Latent {
    let LatentShape { channels, height, width, .. } = shape;
    let places = height * width;
    let mut latent = Latent::filled(shape, 0.0);
    let views = rows.chunks(channels * places).zip(latent.values_mut().chunks_mut(channels * places));
    for (rows, planes) in views {
        for (channel, plane) in planes.chunks_mut(places).enumerate() {
            plane.iter_mut().enumerate().for_each(|(place, value)| *value = rows[place * channels + channel]);
        }
    }
    latent
}
