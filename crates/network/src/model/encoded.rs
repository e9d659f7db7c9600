use super::encoder::Features;

/// Encoded conditions of a frame.
#[derive(Clone, Debug)]
pub(crate) struct Encoded {
    /// Number of cameras, V.
    pub(super) views: usize,
    pub(super) features: Features,
    /// First guess of the latents, the filled color, `[V h w, 3]`.
    pub(super) guess: Vec<f32>,
    /// Embedded rays of tokens, `[V R, d]`.
    pub(super) rays: Vec<f32>,
    /// Embedded ego motion, `[d]`.
    pub(super) ego: Vec<f32>,
}
