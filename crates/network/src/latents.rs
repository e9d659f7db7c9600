//! Conversion of images to latents, and between the orders of latents: rows `[V h w, C]` and planes `[V, C,
//! h, w]`.

use pskel_generate::{Latent, LatentShape};

use super::inputs::means;
use super::{NetworkConfig, Statistics};
use crate::weights::config::CELL;

/// Returns the latents of a frame's pixels `[V, H, W]`, RGB, as rows `[V h w, 3]`: mean colors of 16x16
/// pixels, normalized.
pub(crate) fn latent_rows(config: &NetworkConfig, statistics: &Statistics, pixels: &[[u8; 3]]) -> Vec<f32> {
    let [height, width] = config.divided(1);
    let levels: Vec<[f32; 3]> =
        pixels.iter().map(|pixel| pixel.map(|level| f32::from(level) / 255.0)).collect();
    let mut rows: Vec<f32> =
        levels.chunks((height * width).max(1)).flat_map(|image| means(image, width, CELL)).collect();
    for row in rows.chunks_mut(statistics.means.len()) {
        let of = row.iter_mut().zip(statistics.means.iter().zip(&statistics.scales));
        of.for_each(|(value, (mean, scale))| *value = (*value - mean) / scale);
    }
    rows
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
