use super::encoder::Features;
use super::images::{Images, Stage, Weights3x3};
use super::parameters::{Arrays, Module};
use crate::NetworkConfig;
use crate::inputs::{FullInputs, PLANES};
use crate::kernels::LANES;
use crate::weights::config::LATENT_CHANNELS;

/// Decoder of latents into images, with the conditions at full size.
#[derive(Clone, Debug)]
pub(super) struct Decoder {
    down2: Stage,
    down4: Stage,
    down8: Stage,
    middle: Stage,
    up8: Stage,
    up4: Stage,
    up2: Stage,
    out: Weights3x3,
}

impl Decoder {
    pub(super) fn read<A: Arrays>(
        config: &NetworkConfig,
        mut module: Module<'_, A>,
    ) -> Result<Self, A::Error> {
        let ([c2, c4, c8, c16], [f4, f8, f16, _]) = (config.decoder, config.encoder);
        Ok(Self {
            down2: module.stage("down2", 4 * PLANES, c2)?,
            down4: module.stage("down4", c2 + f4, c4)?,
            down8: module.stage("down8", c4 + f8, c8)?,
            middle: module.stage("middle", c8 + f16 + LANES, c16)?,
            up8: module.stage("up8", c16 + c8, c8)?,
            up4: module.stage("up4", c8 + c4, c4)?,
            up2: module.stage("up2", c4 + c2, c2)?,
            out: module.convolution("out", c2, LANES)?,
        })
    }

    /// Returns the images of a finished latent, `[V H W]`.
    pub(super) fn decode(&self, inputs: &FullInputs, features: &Features, latent: &[f32]) -> Vec<[f32; 3]> {
        let at2 = self.down2.of(&inputs.planes);
        let at4 = self.down4.of(&Images::joined(&[&at2.halved(), &features.at4]));
        let at8 = self.down8.of(&Images::joined(&[&at4.halved(), &features.at8]));
        let latent = padded(&features.at16, latent);
        let x = self.middle.of(&Images::joined(&[&at8.halved(), &features.at16, &latent]));
        let x = self.up8.of(&Images::joined(&[&x.doubled(), &at8]));
        let x = self.up4.of(&Images::joined(&[&x.doubled(), &at4]));
        let x = self.up2.of(&Images::joined(&[&x.doubled(), &at2]));
        colors(&x.convolved(&self.out, false), &inputs.color)
    }
}

/// Returns a latent `[V h w, 3]` with zeros behind its channels.
fn padded(like: &Images, latent: &[f32]) -> Images {
    let mut values = vec![0.0; like.pixels() * LANES];
    for (row, latent) in values.chunks_mut(LANES).zip(latent.chunks(LATENT_CHANNELS)) {
        row[..LATENT_CHANNELS].copy_from_slice(latent);
    }
    like.with(LANES, values)
}

/// Returns the colors of pixels `[V H W]`: the filled ones plus what is added to 2x2 pixels, channel `4 c + 2
/// y + x`.
fn colors(added: &Images, filled: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let width = 2 * added.width;
    let of = |(i, filled): (usize, &[f32; 3])| {
        let (y, x) = (i / width, i % width);
        let block = &added.values[(y / 2 * added.width + x / 2) * added.channels..];
        std::array::from_fn(|c| filled[c] + block[4 * c + 2 * (y % 2) + x % 2])
    };
    filled.iter().enumerate().map(of).collect()
}
