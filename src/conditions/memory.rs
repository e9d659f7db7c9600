//! Memory of a step's maps, reserved before they are rendered.

use super::tensor::{LAYOUT_CHANNELS, POINT_CHANNELS};
use super::{ConditionOptions, MapKind, MapSet};
use crate::geometry::{ImageSize, View};
use crate::memory::{MemoryError, Need, Reservation, reserve};
use crate::raster::{PixelType, frame_bytes, need_of_views};

/// Memory of a color map that is rendered at full size, per pixel: the rasterizer's maps, the map itself, and
/// what its filter needs.
const FULL_COLOR_BYTES: u64 = 8 + 3 + 8;

/// Maps that are being encoded take up to two thirds more (measured: EXR a byte more per 1.6 bytes, PNG and
/// NPZ less).
fn with_encoded(bytes: u64) -> u64 {
    bytes + (2 * bytes).div_ceil(3)
}

/// Returns the memory of a map per pixel, bytes.
fn pixel_bytes(kind: MapKind) -> u64 {
    match kind.description().pixels {
        PixelType::Rgb => 3,
        PixelType::Class => 1,
        PixelType::Depth | PixelType::Number => 4,
        PixelType::Channels => 4 * (POINT_CHANNELS + LAYOUT_CHANNELS) as u64,
    }
}

/// Estimates the memory for the maps of a step, bytes, without the rasterizer's.
fn step_bytes(views: &[View], options: &ConditionOptions) -> u64 {
    let each: u64 = options.maps.iter().map(pixel_bytes).sum();
    let filters = options.color_filter.needs_depth() && options.out_size.is_some();
    let filters = filters && options.maps.contains(MapKind::Color);
    let (mut written, mut largest) = (0, 0);
    for view in views {
        written += options.written_size(view).pixels() as u64;
        largest = largest.max(drawn_size(view, options).pixels() as u64);
    }
    each * written + if filters { FULL_COLOR_BYTES * largest } else { 0 }
}

/// Reserves memory for the maps of a step.
pub(super) fn reserve_step(views: &[View], options: &ConditionOptions) -> Result<Reservation, MemoryError> {
    let bytes = step_bytes(views, options);
    reserve(bytes, || need(views, options, bytes))
}

/// Checks that the maps of some views and a rasterizer's memory for them fit into the budget together, before
/// anything is taken. `has_map`: whether there is an HD map. Renderers check each step themselves, but only
/// when it begins.
///
/// # Errors
/// Fails if they do not.
pub fn check_memory(views: &[View], options: &ConditionOptions, has_map: bool) -> Result<(), MemoryError> {
    let options = ConditionOptions { maps: options.maps.with_parts(has_map), ..options.clone() };
    let drawn: Vec<View> = views.iter().map(|view| options.drawn_view(view)).collect();
    let splatted = options.maps & MapSet::SPLATTED;
    let step = step_bytes(views, &options);
    let bytes = with_encoded(step) + frame_bytes(&drawn, options.out_size, splatted, false);
    reserve(bytes, || need(views, &options, bytes)).map(drop)
}

/// Describes the memory of views, with the size of the maps if that is the larger one.
fn need(views: &[View], options: &ConditionOptions, bytes: u64) -> Need {
    let sizes = || views.iter().map(|view| drawn_size(view, options));
    let need = need_of_views(sizes(), bytes);
    match options.out_size {
        Some(out) if sizes().all(|size| size.pixels() < out.pixels()) => {
            Need { what: format!("{} for maps of {out}", need.what), ..need }
        }
        _ => need,
    }
}

fn drawn_size(view: &View, options: &ConditionOptions) -> ImageSize {
    options.size.unwrap_or_else(|| ImageSize::of(&view.camera))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conditions::ColorFilter;
    use crate::geometry::Camera;

    #[test]
    fn encoder_memory_covers_measurements() {
        for bytes in [0, 1, 7, 16, 1000, 1 << 40] {
            assert!((with_encoded(bytes) - bytes) as f64 >= bytes as f64 / 1.6, "{bytes}");
        }
    }

    #[test]
    fn step_memory_is_the_size_of_its_maps() {
        let rows = [[100.0, 0.0, 50.0], [0.0, 100.0, 50.0], [0.0, 0.0, 1.0]];
        let view = |side| View {
            camera: Camera::new("c", side, 10, rows).unwrap(),
            camera_from_world: Default::default(),
        };
        let views = [view(10), view(20)];
        let maps = MapSet::of(&[MapKind::Color, MapKind::Depth]);
        let mut options = ConditionOptions { maps, ..ConditionOptions::default() };
        assert_eq!(step_bytes(&views, &options), 300 * 7);
        options.out_size = Some(ImageSize { height: 2, width: 5 });
        assert_eq!(step_bytes(&views, &options), 20 * 7);
        options.color_filter = ColorFilter::ValidArea;
        assert_eq!(step_bytes(&views, &options), 20 * 7 + 200 * FULL_COLOR_BYTES);
        options.maps = MapSet::of(&[MapKind::Tensor]);
        assert_eq!(step_bytes(&views, &options), 20 * 104);
    }
}
