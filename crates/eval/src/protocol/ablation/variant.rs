use point_skeleton::named;
use pskel_generate::DroppedConditions;

/// A training of the paper's ablation, as `python -m pskel.train --variant` has them. Each adds something to
/// the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Variant {
    /// Boxes and map alone.
    Layout,
    /// The previous frame as it is.
    PreviousClean,
    /// The previous frame with noise.
    PreviousNoised,
    /// Color of the points.
    Color,
    /// Depth of the points.
    Depth,
    /// Degraded assets.
    Augmentation,
    /// Bins of depth that are finer near the camera.
    RelativeDepth,
    /// Bins of depth of equal width.
    MetricDepth,
}

named!(Variant, "variant of the training" {
    Layout => "layout", "Layout";
    PreviousClean => "previous_clean", "Layout and previous frame";
    PreviousNoised => "previous_noised", "Layout and noisy previous frame";
    Color => "color", "Layout, noisy previous frame and color";
    Depth => "depth", "Layout, noisy previous frame, color and depth";
    Augmentation => "augmentation", "The same with degraded assets";
    RelativeDepth => "relative_depth", "The same with finer bins of depth near the camera";
    MetricDepth => "metric_depth", "The same with bins of depth of equal width";
});

impl Variant {
    /// Conditions that the network was not trained with.
    pub(super) fn dropped(self) -> DroppedConditions {
        let none = DroppedConditions::default();
        match self {
            Self::Layout | Self::PreviousClean | Self::PreviousNoised => {
                DroppedConditions { color: true, depth: true, ..none }
            }
            Self::Color => DroppedConditions { depth: true, ..none },
            Self::Depth | Self::Augmentation | Self::RelativeDepth | Self::MetricDepth => none,
        }
    }
}
