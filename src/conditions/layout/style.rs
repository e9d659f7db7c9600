use serde::Serialize;

use super::LINE_WIDTH_PX;
use crate::scene::MapLayer;
use crate::{named, named_in_files};

/// How layouts are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct LayoutStyle {
    /// Width of the lines.
    pub line_width: LineWidth,
    /// Outlines of the HD map.
    pub map_layers: LayoutLayers,
}

/// Line width of layouts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineWidth {
    /// 8 pixels at the camera's own size, scaled with the width at which the layout is drawn; from 1 to 16
    /// pixels.
    Scaled,
    /// 8 pixels at the size at which the layout is drawn.
    Fixed,
}

named!(LineWidth, "line width" {
    Scaled => "scaled", "8 pixels at the camera's own size, scaled with --size";
    Fixed => "fixed", "8 pixels at --size";
});
named_in_files!(LineWidth);

/// Outlines of the HD map in a layout, in drawing order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LayoutLayers {
    /// Lanes, drivable area, crossings.
    Lanes,
    /// Drivable area and walkways, dividers at half the width, crossings.
    Dividers,
}

named!(LayoutLayers, "map layers" {
    Lanes => "lanes", "Lanes, drivable area, crossings";
    Dividers => "dividers", "Drivable area and walkways (nuPlan), dividers at half the width, crossings";
});
named_in_files!(LayoutLayers);

impl Default for LayoutStyle {
    fn default() -> Self {
        Self { line_width: LineWidth::Scaled, map_layers: LayoutLayers::Lanes }
    }
}

impl LayoutStyle {
    /// Returns the width of wide lines, pixels, in a layout that is drawn at this scale of the camera's own
    /// size.
    pub(super) fn width_px(self, scale: f32) -> f32 {
        match self.line_width {
            LineWidth::Fixed => LINE_WIDTH_PX,
            LineWidth::Scaled => (LINE_WIDTH_PX * scale).clamp(1.0, 2.0 * LINE_WIDTH_PX),
        }
    }
}

impl LayoutLayers {
    /// Returns a layer's line width relative to wide lines; `None` if it is not drawn.
    pub(super) fn relative_width(self, layer: MapLayer) -> Option<f32> {
        match (self, layer) {
            (Self::Lanes, MapLayer::Lane | MapLayer::DrivableArea | MapLayer::Crossing)
            | (Self::Dividers, MapLayer::DrivableArea | MapLayer::Walkway | MapLayer::Crossing) => Some(1.0),
            (Self::Dividers, MapLayer::Divider) => Some(0.5),
            (Self::Lanes, MapLayer::Walkway | MapLayer::Divider) | (Self::Dividers, MapLayer::Lane) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn widths_follow_the_drawn_size() {
        let scaled = LayoutStyle::default();
        let fixed = LayoutStyle { line_width: LineWidth::Fixed, ..scaled };
        for (scale, width_px) in [(1.0, 8.0), (0.5, 4.0), (0.07, 1.0), (4.0, 16.0)] {
            assert_eq!(scaled.width_px(scale), width_px);
            assert_eq!(fixed.width_px(scale), 8.0);
        }
    }
}
