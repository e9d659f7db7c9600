use std::collections::BTreeSet;

use point_skeleton::conditions::write::meta::PromptParts;
use point_skeleton::conditions::{Captions, ConditionOptions, MapFormat, MapKind, MapSet};
use point_skeleton::scene::{SelectionOptions, SubstituteOptions};
use point_skeleton::{named, named_in_files};
use serde::Serialize;

use crate::ExportError;
use crate::rules::{self, ClipRules};

/// File layout of an export.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// A folder per frame, as written by the command `render`.
    Frames,
    /// Cache of the training code of the paper: files by token of the image.
    PasCache,
    /// Package of OpenDWM's `PreviewDataset`.
    OpendwmPreview,
    /// Tar shards of WebDataset.
    Webdataset,
    /// Clips of points and images for StreetCrafter.
    Streetcrafter,
    /// Clips of points and images for FreeVS.
    Freevs,
    /// MCAP files with the schemas of Foxglove.
    #[cfg(feature = "mcap")]
    Mcap,
    /// Scenes for the runtime of AlpaSim, a USDZ per log; no maps.
    #[cfg(feature = "parquet")]
    Alpasim,
    /// Annotations for the world scenario renderer of Cosmos-Transfer2.5, as Parquet files; no maps.
    #[cfg(feature = "parquet")]
    WorldScenario,
    /// Videos for post-training Cosmos-Transfer2.5.
    #[cfg(feature = "video")]
    CosmosVideo,
}

named!(Layout, "layout" {
    Frames => "frames", "A folder per frame, with a PNG per map";
    PasCache => "pas-cache",
        "Cache of the training code of Point as Skeleton: files by token of the image";
    OpendwmPreview => "opendwm-preview", "Packages of OpenDWM's PreviewDataset";
    Webdataset => "webdataset", "Tar shards of WebDataset";
    Streetcrafter => "streetcrafter", "Clips of points and images for StreetCrafter, at 10 Hz";
    Freevs => "freevs", "Clips of points and images for FreeVS, at 5 Hz";
    #[cfg(feature = "mcap")]
    Mcap => "mcap", "An MCAP log with Foxglove schemas per shard";
    #[cfg(feature = "parquet")]
    Alpasim => "alpasim", "A scene for AlpaSim's runtime per recording, as USDZ; no maps";
    #[cfg(feature = "parquet")]
    WorldScenario => "world-scenario",
        "Annotations for Cosmos-Transfer2.5 as Parquet files; no maps";
    #[cfg(feature = "video")]
    CosmosVideo => "cosmos-video", "Videos for post-training Cosmos-Transfer2.5";
});
named_in_files!(Layout);

impl Layout {
    /// Returns the maps to render for the requested ones.
    pub(crate) fn rendered(self, asked: MapSet) -> MapSet {
        match self {
            Self::Frames | Self::Webdataset => asked,
            // Layouts have another size than the rest, and are drawn by the writer.
            Self::PasCache | Self::Streetcrafter => MapSet::of(&[MapKind::Color, MapKind::Depth]),
            Self::Freevs => MapSet::of(&[MapKind::Color]),
            Self::OpendwmPreview => asked.without(MapKind::Tensor),
            #[cfg(feature = "mcap")]
            Self::Mcap => asked.without(MapKind::Tensor),
            #[cfg(feature = "parquet")]
            Self::Alpasim | Self::WorldScenario => MapSet::NONE,
            #[cfg(feature = "video")]
            Self::CosmosVideo => {
                let shown = [MapKind::Color, MapKind::Boxes, MapKind::Map];
                MapSet::of(&shown.into_iter().filter(|kind| asked.contains(*kind)).collect::<Vec<_>>())
            }
        }
    }

    /// Returns the rules of a layout that consists of clips.
    pub(crate) fn clip_rules(self) -> Option<&'static ClipRules> {
        match self {
            Self::Streetcrafter => Some(&rules::STREETCRAFTER),
            Self::Freevs => Some(&rules::FREEVS),
            _ => None,
        }
    }

    /// Returns whether depth is the color cloud's, for masks of the color map.
    pub(crate) fn has_color_masks(self) -> bool {
        self == Self::Streetcrafter
    }

    /// Returns whether a shard is a whole log, whatever its length.
    pub(crate) fn has_whole_logs(self) -> bool {
        #[cfg(feature = "parquet")]
        if self == Self::Alpasim {
            return true;
        }
        false
    }

    /// Returns whether the layout has maps, so that a skeleton is needed.
    pub(crate) fn has_maps(self) -> bool {
        self.rendered(MapSet::of(&MapKind::ALL)) != MapSet::NONE
    }
}

/// Form of the maps in tar shards.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SampleFormat {
    /// One PNG per map and camera; depth as 16-bit bins.
    #[default]
    Png,
    /// One safetensors file per sample; depth in meters.
    Safetensors,
}

impl SampleFormat {
    /// Returns the form for a format of maps.
    ///
    /// # Errors
    /// Fails if the layout does not support the format.
    pub fn of(format: MapFormat, layout: Layout) -> Result<Self, ExportError> {
        let found = match format {
            MapFormat::Png => return Ok(Self::Png),
            MapFormat::Safetensors if layout == Layout::Webdataset => return Ok(Self::Safetensors),
            other => other.name(),
        };
        let expected = "the format png, or safetensors with the layout webdataset";
        Err(ExportError::Options { expected, found })
    }
}

/// Times of the samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SampleTimes {
    /// The key frames.
    #[default]
    KeyFrames,
    /// The key frames, and the images between them at their own times.
    Images,
    /// A rate from the first key frame of the log on; ego and actors are interpolated.
    Rate {
        /// Samples per second.
        hz: f64,
    },
}

/// Options of an export. Together with the logs they determine its bytes.
#[derive(Clone, Debug, Serialize)]
pub struct ExportOptions {
    /// Layout of the files. In `conditions`, `layout` is the style of boxes and lanes.
    #[serde(rename = "export_layout")]
    pub layout: Layout,
    /// Maps, sizes and splat radii.
    #[serde(flatten)]
    pub conditions: ConditionOptions,
    /// Choice between an actor's own points and a template.
    #[serde(flatten)]
    pub selection: SelectionOptions,
    /// Templates and degraded assets.
    #[serde(flatten)]
    pub substitutes: SubstituteOptions,
    /// Form of the maps in tar shards.
    pub format: SampleFormat,
    /// Range of key frames of each log; `None` for all.
    pub frames: Option<[usize; 2]>,
    /// Maximum number of key frames in a shard. The layout `alpasim` has whole logs.
    pub shard_frames: usize,
    /// Whether recorded images, without lens distortion and at the size of the maps, are exported too.
    pub images: bool,
    /// Times of the samples.
    pub times: SampleTimes,
    /// Folder of the color maps in the layout [`Layout::PasCache`].
    pub color_folder: String,
    /// Logs in the validation split of [`Layout::Streetcrafter`], by name. Without any, both splits have all
    /// logs.
    #[serde(skip_serializing_if = "BTreeSet::is_empty")]
    pub validation_logs: BTreeSet<String>,
    /// Prompt parts for all logs.
    pub prompt: PromptParts,
    /// Captions of logs and images.
    pub captions: Captions,
}

impl ExportOptions {
    /// Checks that the options fit together.
    ///
    /// # Errors
    /// Fails if the layout cannot have samples at these times, maps of this size or a validation split, or
    /// if the format cannot store tensors.
    pub fn check(&self) -> Result<(), ExportError> {
        let wrong = |expected, found| Err(ExportError::Options { expected, found });
        if self.layout == Layout::PasCache && matches!(self.times, SampleTimes::Rate { .. }) {
            return wrong("no rate with the layout pas-cache, whose files are named after images", "one");
        }
        if let Some(rules) = self.layout.clip_rules() {
            match self.times {
                SampleTimes::KeyFrames => {}
                SampleTimes::Images => rules.check_hz(None)?,
                SampleTimes::Rate { hz } => rules.check_hz(Some(hz))?,
            }
            rules.check_size(&self.conditions)?;
        }
        if self.layout != Layout::Streetcrafter && !self.validation_logs.is_empty() {
            return wrong("the layout streetcrafter with validation logs", "another layout");
        }
        if self.format == SampleFormat::Png && self.conditions.maps.contains(MapKind::Tensor) {
            return wrong("the format safetensors, and the layout webdataset, for the map tensor", "png");
        }
        Ok(())
    }

    /// Returns whether the HD map is drawn or written.
    pub(crate) fn uses_map(&self) -> bool {
        #[cfg(feature = "parquet")]
        if matches!(self.layout, Layout::Alpasim | Layout::WorldScenario) {
            return true;
        }
        let maps = self.conditions.maps;
        if self.layout.clip_rules().is_some() {
            return false;
        }
        maps.contains(MapKind::Map) || maps.contains(MapKind::Tensor)
    }

    /// Returns the maps to render of a log with or without an HD map.
    pub(crate) fn rendered(&self, has_map: bool) -> MapSet {
        let asked = if has_map { self.conditions.maps } else { self.conditions.maps.without(MapKind::Map) };
        self.layout.rendered(asked)
    }
}
