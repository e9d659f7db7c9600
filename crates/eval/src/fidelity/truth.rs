use point_skeleton::conditions::{ImageSize, reduce};
use pskel_town::view::GroundTruthView;

/// Ground truth at the size of the maps.
pub(super) struct TrueMaps {
    pub(super) width: usize,
    /// Width of the maps relative to the rendered ones.
    pub(super) scale: f64,
    pub(super) color: Vec<[u8; 3]>,
    pub(super) depth_m: Vec<f32>,
    pub(super) class: Vec<u8>,
    pub(super) instance: Vec<u32>,
}

impl TrueMaps {
    /// Reduces ground truth like the maps.
    pub(super) fn new(seen: &GroundTruthView, to: ImageSize) -> Self {
        let from = ImageSize { height: seen.image.height(), width: seen.image.width() };
        let color: Vec<[u8; 3]> = seen.image.pixels().map(|p| p.0).collect();
        Self {
            width: to.width as usize,
            scale: f64::from(to.width) / f64::from(from.width),
            color: reduce::bilinear(&color, from, to),
            depth_m: reduce::nearest(&seen.depth_m, from, to),
            class: reduce::nearest(&seen.class, from, to),
            instance: reduce::nearest(&seen.instance, from, to),
        }
    }
}
