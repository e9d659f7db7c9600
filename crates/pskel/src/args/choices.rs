//! Values of options that name a variant of a library type.

use std::ffi::OsStr;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use point_skeleton::cloud::PointFormat;
use point_skeleton::conditions::{BinScale, ColorFilter, DepthEmbedding, LayoutLayers, LineWidth, MapFormat};
use point_skeleton::dataset::{ImageDistortion, MissingData, RingMeaning};
use point_skeleton::raster::Occlusion;
use point_skeleton::scene::TemplateFit;
use point_skeleton::skeleton::Coloring;
use pskel_export::Layout;

/// Parser of an option: the name, value and help (may be empty) of each choice.
#[derive(Clone, Copy)]
pub(crate) struct Choices<T: 'static>(pub(crate) &'static [(&'static str, T, &'static str)]);

pub(crate) const MAP_FORMAT: Choices<MapFormat> = Choices(&[
    ("png", MapFormat::Png, "A PNG per map"),
    ("exr", MapFormat::Exr, "An OpenEXR file per map"),
    ("npz", MapFormat::Npz, "One NumPy archive per frame"),
    ("safetensors", MapFormat::Safetensors, "One safetensors file per frame"),
]);

pub(crate) const MISSING_DATA: Choices<MissingData> = Choices(&[
    ("skip", MissingData::Skip, "Skip and count them"),
    ("error", MissingData::Error, "Fail with the first"),
]);

pub(crate) const LAYOUT: Choices<Layout> = Choices(&[
    ("frames", Layout::Frames, "A folder per frame, with a PNG per map"),
    (
        "pas-cache",
        Layout::PasCache,
        "Cache of the training code of Point as Skeleton: files by token of the image",
    ),
    ("opendwm-preview", Layout::OpendwmPreview, "Packages of OpenDWM's PreviewDataset"),
    ("webdataset", Layout::Webdataset, "Tar shards of WebDataset"),
    #[cfg(feature = "mcap")]
    ("mcap", Layout::Mcap, "An MCAP log with Foxglove schemas per shard"),
    #[cfg(feature = "parquet")]
    ("world-scenario", Layout::WorldScenario, "Annotations for Cosmos-Transfer2.5 as Parquet files; no maps"),
    #[cfg(feature = "video")]
    ("cosmos-video", Layout::CosmosVideo, "Videos for post-training Cosmos-Transfer2.5"),
]);

pub(crate) const RING_MEANING: Choices<RingMeaning> = Choices(&[
    ("auto", RingMeaning::Auto, "Merged LiDARs if the directions of their points prove it, otherwise beams"),
    ("device", RingMeaning::Device, "A LiDAR of a merged sweep; LiDAR 0 matches the boxes of moving actors"),
    ("beam", RingMeaning::Beam, "A beam of one LiDAR"),
]);

pub(crate) const IMAGE_DISTORTION: Choices<ImageDistortion> = Choices(&[
    ("usual", ImageDistortion::Usual, "Applied in nuPlan, ignored in other layouts"),
    ("apply", ImageDistortion::Apply, "Images are as the lens recorded them"),
    ("ignore", ImageDistortion::Ignore, "Images are rectified, although coefficients are given"),
]);

pub(crate) const POINT_FORMAT: Choices<PointFormat> =
    Choices(&[("npy", PointFormat::Npy, ""), ("ply", PointFormat::Ply, "")]);

pub(crate) const BIN_SCALE: Choices<BinScale> = Choices(&[
    ("linear", BinScale::Linear, "Bins of equal width"),
    (
        "log",
        BinScale::Log,
        "Finer near the camera: 85 % of the bins for the nearest 60 % of the range, logarithmic in both \
            parts",
    ),
]);

pub(crate) const DEPTH_EMBEDDING: Choices<DepthEmbedding> = Choices(&[
    ("continuous", DepthEmbedding::Continuous, "Depth only; sines and cosines are 0"),
    ("discrete", DepthEmbedding::Discrete, "Sines and cosines only; the depth is -1 everywhere"),
    ("both", DepthEmbedding::Both, "Depth, sines and cosines"),
]);

pub(crate) const COLOR_FILTER: Choices<ColorFilter> = Choices(&[
    ("bilinear", ColorFilter::Bilinear, "OpenCV's INTER_LINEAR; empty pixels count as black"),
    ("valid-area", ColorFilter::ValidArea, "Area-weighted mean of the pixels that are not empty"),
    (
        "visible-area",
        ColorFilter::VisibleArea,
        "The same without pixels that show a surface through the gaps between the points of a nearer one",
    ),
]);

pub(crate) const COLORING: Choices<Coloring> = Choices(&[
    (
        "agreed",
        Coloring::Agreed,
        "One color, on which the images that see the point agree: the robust mean of the views that pass an \
         occlusion test",
    ),
    (
        "every-camera",
        Coloring::EveryCamera,
        "One copy of the point for every camera of its frame that it projects into, occluded or not. For \
         comparison: the behavior of existing scripts",
    ),
]);

pub(crate) const TEMPLATE_FIT: Choices<TemplateFit> = Choices(&[
    ("box", TemplateFit::Box, "Scales the template along each axis to the actor's box"),
    ("none", TemplateFit::None, "Leaves the template at its own size"),
]);

pub(crate) const LINE_WIDTH: Choices<LineWidth> = Choices(&[
    ("scaled", LineWidth::Scaled, "8 pixels at the camera's own size, scaled with --size"),
    ("fixed", LineWidth::Fixed, "8 pixels at --size"),
]);

pub(crate) const MAP_LAYERS: Choices<LayoutLayers> = Choices(&[
    ("lanes", LayoutLayers::Lanes, "Lanes, drivable area, crossings"),
    (
        "dividers",
        LayoutLayers::Dividers,
        "Drivable area and walkways (nuPlan), dividers at half the width, crossings",
    ),
]);

pub(crate) const OCCLUSION: Choices<Occlusion> = Choices(&[
    ("scene", Occlusion::Scene, "All points in front of it"),
    ("actors", Occlusion::Actors, "Only points of other actors"),
]);

impl<T: Copy + Send + Sync> TypedValueParser for Choices<T> {
    type Value = T;

    fn parse_ref(
        &self,
        command: &clap::Command,
        arg: Option<&clap::Arg>,
        value: &OsStr,
    ) -> Result<T, clap::Error> {
        let name = PossibleValuesParser::new(self.values()).parse_ref(command, arg, value)?;
        let found = self.0.iter().find(|choice| choice.0 == name);
        Ok(found.ok_or_else(|| clap::Error::new(clap::error::ErrorKind::InvalidValue))?.1)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(self.values()))
    }
}

impl<T> Choices<T> {
    fn values(self) -> impl Iterator<Item = PossibleValue> {
        self.0
            .iter()
            .map(|(name, _, help)| PossibleValue::new(*name).help((!help.is_empty()).then_some(*help)))
    }
}
