use serde::{Deserialize, Serialize};

/// Size of a frame's latents.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LatentShape {
    /// Cameras, V.
    pub views: usize,
    /// Channels, C.
    pub channels: usize,
    /// Rows, h.
    pub height: usize,
    /// Columns, w.
    pub width: usize,
}

/// Latents of one frame, `[V, C, h, w]`, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Latent {
    shape: LatentShape,
    values: Vec<f32>,
}

impl LatentShape {
    /// Values of a frame.
    pub fn len(&self) -> usize {
        self.views * self.channels * self.height * self.width
    }

    /// Whether a frame has none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// `[V, C, h, w]`.
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
    /// Values of a shape; `None` if there are more or fewer of them.
    pub fn new(shape: LatentShape, values: Vec<f32>) -> Option<Self> {
        (values.len() == shape.len()).then_some(Self { shape, values })
    }

    /// The same value everywhere.
    pub fn filled(shape: LatentShape, value: f32) -> Self {
        Self { shape, values: vec![value; shape.len()] }
    }

    /// Its size.
    pub fn shape(&self) -> LatentShape {
        self.shape
    }

    /// All values, `[V, C, h, w]`.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// All values, `[V, C, h, w]`, to change.
    pub fn values_mut(&mut self) -> &mut [f32] {
        &mut self.values
    }

    /// Value by value of two of one shape.
    pub(super) fn zip(&self, other: &Self, f: impl Fn(f32, f32) -> f32) -> Self {
        debug_assert_eq!(self.shape, other.shape);
        let values = self.values.iter().zip(&other.values).map(|(a, b)| f(*a, *b)).collect();
        Self { shape: self.shape, values }
    }
}
