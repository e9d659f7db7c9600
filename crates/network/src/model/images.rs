use crate::kernels::{Convolution, Resize};

/// Images of numbers, `[N, H, W, C]`.
#[derive(Clone, Debug, Default)]
pub(crate) struct Images {
    pub(crate) count: usize,
    pub(crate) height: usize,
    pub(crate) width: usize,
    pub(crate) channels: usize,
    pub(crate) values: Vec<f32>,
}

impl Images {
    /// Number of pixels in all images.
    pub(crate) fn pixels(&self) -> usize {
        self.count * self.height * self.width
    }

    /// Returns images of the same size with other values.
    pub(crate) fn with(&self, channels: usize, values: Vec<f32>) -> Self {
        debug_assert_eq!(values.len(), self.pixels() * channels);
        Self { channels, values, ..*self }
    }

    /// Returns the means of 2x2 pixels.
    pub(crate) fn halved(&self) -> Self {
        let Self { count, height, width, channels, .. } = *self;
        let values = Resize { height, width, channels }.downsample(&self.values);
        Self { count, height: height / 2, width: width / 2, channels, values }
    }

    /// Returns the images at twice the size, bilinear.
    pub(crate) fn doubled(&self) -> Self {
        let Self { count, channels, .. } = *self;
        let (height, width) = (2 * self.height, 2 * self.width);
        let values = Resize { height, width, channels }.upsample(&self.values);
        Self { count, height, width, channels, values }
    }

    /// Returns the channels of several images of the same size, one behind the other.
    pub(crate) fn joined(parts: &[&Self]) -> Self {
        let channels = parts.iter().map(|part| part.channels).sum();
        let pixels = parts.first().map_or(0, |part| part.pixels());
        let mut values = Vec::with_capacity(pixels * channels);
        for pixel in 0..pixels {
            for part in parts {
                values.extend_from_slice(&part.values[pixel * part.channels..][..part.channels]);
            }
        }
        parts.first().map_or_else(Self::default, |first| first.with(channels, values))
    }

    /// Returns the convolution by 3x3 pixels, rectified or not.
    pub(crate) fn convolved(&self, by: &Weights3x3, rectified: bool) -> Self {
        let Self { height, width, channels, .. } = *self;
        debug_assert_eq!(channels, by.channels);
        let shape = Convolution { height, width, channels, outputs: by.outputs, rectified };
        self.with(by.outputs, shape.forward(&self.values, &by.weights, &by.bias))
    }
}

/// Weights of a convolution by 3x3 pixels.
#[derive(Clone, Debug)]
pub(crate) struct Weights3x3 {
    pub(crate) channels: usize,
    pub(crate) outputs: usize,
    /// `[9 C, D]`: a row per (y, x, input channel), a column per output channel.
    pub(crate) weights: Vec<f32>,
    pub(crate) bias: Vec<f32>,
}

/// Weights of two rectified convolutions.
#[derive(Clone, Debug)]
pub(crate) struct Stage {
    pub(crate) a: Weights3x3,
    pub(crate) b: Weights3x3,
}

impl Stage {
    pub(crate) fn of(&self, images: &Images) -> Images {
        images.convolved(&self.a, true).convolved(&self.b, true)
    }
}
