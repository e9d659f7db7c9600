use point_skeleton::conditions::meta::PromptParts;
use point_skeleton::conditions::{ConditionOptions, MapKind, MapSet};
use point_skeleton::scene::{SelectionOptions, SubstituteOptions};
use serde::Serialize;

use crate::{Captions, Layout};

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
    /// Layout of the files.
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
    /// Whether recorded images, without lens distortion and at the size of the maps, are exported too.
    pub images: bool,
    /// Times of the samples.
    pub times: SampleTimes,
    /// Folder of the color maps in the layout [`Layout::PasCache`].
    pub color_folder: String,
    /// Parts of the prompt of all logs.
    pub prompt: PromptParts,
    /// Captions of logs and images.
    pub captions: Captions,
}

impl ExportOptions {
    /// Returns the maps to render of a log with or without an HD map.
    pub(crate) fn rendered(&self, has_map: bool) -> MapSet {
        let asked = if has_map { self.conditions.maps } else { self.conditions.maps.without(MapKind::Map) };
        self.layout.rendered(asked)
    }
}
