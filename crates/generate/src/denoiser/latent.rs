use serde::{Deserialize, Serialize};

/// Latent shape of a frame, `[V, C, h, w]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LatentShape {
    /// Number of cameras, V.
    pub views: usize,
    /// Number of channels, C.
    pub channels: usize,
    /// Number of rows, h.
    pub height: usize,
    /// Number of columns, w.
    pub width: usize,
}

/// Latents of one frame, `[V, C, h, w]`, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Latent {
    shape: LatentShape,
    values: Vec<f32>,
}

impl LatentShape {
    /// Number of values in a frame.
    pub fn len(&self) -> usize {
        self.views * self.channels * self.height * self.width
    }

    /// Returns whether a frame has no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the shape as `[V, C, h, w]`.
    pub fn to_array(self) -> [usize; 4] {
        [self.views, self.channels, self.height, self.width]
    }
}

impl std::fmt::Display for LatentShape {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { views, channels, height, width } = self;
        write!(f, "{views}x{channels}x{height}x{width}")
    }
}

impl Latent {
    /// Creates a latent from its values; `None` if their number does not match the shape.
    pub fn new(shape: LatentShape, values: Vec<f32>) -> Option<Self> {
        (values.len() == shape.len()).then_some(Self { shape, values })
    }

    /// Creates a latent with all values equal.
    pub fn filled(shape: LatentShape, value: f32) -> Self {
        Self { shape, values: vec![value; shape.len()] }
    }

    /// Shape of the latent.
    pub fn shape(&self) -> LatentShape {
        self.shape
    }

    /// All values, `[V, C, h, w]`.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// All values, `[V, C, h, w]`, mutable.
    pub fn values_mut(&mut self) -> &mut [f32] {
        &mut self.values
    }

    /// Combines two latents of the same shape value by value.
    pub(crate) fn zip(&self, other: &Self, f: impl Fn(f32, f32) -> f32) -> Self {
        debug_assert_eq!(self.shape, other.shape);
        let values = self.values.iter().zip(&other.values).map(|(a, b)| f(*a, *b)).collect();
        Self { shape: self.shape, values }
    }
}
