//! Layouts: the files that each kind of reader expects. One module each.

#[cfg(feature = "video")]
mod cosmos_video;
mod frames;
#[cfg(feature = "mcap")]
mod mcap;
mod opendwm_preview;
mod pas_cache;
#[cfg(any(feature = "video", feature = "parquet"))]
mod slots;
mod webdataset;
#[cfg(feature = "parquet")]
mod world_scenario;

use point_skeleton::Maps;
use point_skeleton::conditions::meta::FrameMeta;
use point_skeleton::conditions::{ImageSize, MapKind, MapSet};
use point_skeleton::dataset::{Dataset, Recording};
use point_skeleton::scene::frame_rate_hz;
use serde::Serialize;
use serde_json::Value;

use crate::samples::Sample;
use crate::shard::{Shard, ShardRecord};
use crate::{ExportError, ExportOptions, ListedLog, SampleTimes};

/// Layout of the files of an export.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Layout {
    /// A folder per frame, as written by the command `render`.
    Frames,
    /// Cache of the training code of the paper: files by token of the image.
    PasCache,
    /// Package of OpenDWM's `PreviewDataset`.
    OpendwmPreview,
    /// Tar shards of WebDataset.
    Webdataset,
    /// MCAP files with the schemas of Foxglove.
    #[cfg(feature = "mcap")]
    Mcap,
    /// Annotations for the world scenario renderer of Cosmos-Transfer2.5, as Parquet files; no maps.
    #[cfg(feature = "parquet")]
    WorldScenario,
    /// Videos for post-training Cosmos-Transfer2.5.
    #[cfg(feature = "video")]
    CosmosVideo,
}

impl Layout {
    /// Returns the maps to render for the requested ones.
    pub(crate) fn rendered(self, asked: MapSet) -> MapSet {
        match self {
            Self::Frames | Self::Webdataset => asked,
            // Layouts have another size than the rest, and are drawn by the writer.
            Self::PasCache => MapSet::of(&[MapKind::Color, MapKind::Depth]),
            Self::OpendwmPreview => asked.without(MapKind::Tensor),
            #[cfg(feature = "mcap")]
            Self::Mcap => asked.without(MapKind::Tensor),
            #[cfg(feature = "parquet")]
            Self::WorldScenario => MapSet::NONE,
            #[cfg(feature = "video")]
            Self::CosmosVideo => {
                let shown = [MapKind::Color, MapKind::Boxes, MapKind::Map];
                MapSet::of(&shown.into_iter().filter(|kind| asked.contains(*kind)).collect::<Vec<_>>())
            }
        }
    }

    /// Returns whether the layout has maps, so that a skeleton is needed.
    pub(crate) fn has_maps(self) -> bool {
        self.rendered(MapSet::of(&MapKind::ALL)) != MapSet::NONE
    }

    /// Returns a writer of a shard.
    pub(crate) fn writer<'a>(
        self,
        shard: &Shard,
        source: &'a Source<'a>,
    ) -> Result<Box<dyn LayoutWriter + 'a>, ExportError> {
        Ok(match self {
            Self::Frames => Box::new(frames::Frames::new(source)),
            Self::PasCache => Box::new(pas_cache::PasCache::new(source)),
            Self::OpendwmPreview => Box::new(opendwm_preview::Package::new(source, shard.name())),
            Self::Webdataset => Box::new(webdataset::Tar::begin(shard, source)?),
            #[cfg(feature = "mcap")]
            Self::Mcap => Box::new(mcap::Mcap::begin(shard, source)?),
            #[cfg(feature = "parquet")]
            Self::WorldScenario => Box::new(world_scenario::WorldScenario::new(source)),
            #[cfg(feature = "video")]
            Self::CosmosVideo => Box::new(cosmos_video::Videos::new(source, shard.name())),
        })
    }

    /// Returns the entry of a shard in `index.json`.
    pub(crate) fn index_entry(self, record: &ShardRecord) -> Value {
        match (self, record.files.first()) {
            // The keys of wids, the index format of the package webdataset.
            (Self::Webdataset, Some(file)) => serde_json::json!({
                "url": file.path, "nsamples": record.samples, "filesize": file.bytes, "sha256": file.sha256,
            }),
            _ => {
                serde_json::json!({ "name": record.name, "nsamples": record.samples, "files": record.files.len() })
            }
        }
    }
}

/// Log of a shard.
pub(crate) struct Source<'a> {
    pub(crate) listed: &'a ListedLog,
    pub(crate) dataset: &'a dyn Dataset,
    pub(crate) options: &'a ExportOptions,
}

impl Source<'_> {
    pub(crate) fn log(&self) -> &Recording {
        self.dataset.log()
    }

    /// Returns the frame rate of the samples, per second; `None` if their times are uneven.
    pub(crate) fn fps(&self) -> Option<f64> {
        match self.options.times {
            SampleTimes::KeyFrames => frame_rate_hz(&self.log().frames),
            SampleTimes::Images => None,
            SampleTimes::Rate { hz } => Some(hz),
        }
    }

    pub(crate) fn meta(&self, maps: &Maps) -> FrameMeta {
        maps.meta(&self.options.prompt, self.fps())
    }

    /// Returns the caption of a camera's image.
    pub(crate) fn caption(&self, sample: &Sample<'_>, camera: usize) -> String {
        let token = sample.images.get(camera).copied().flatten().map(|image| image.token.as_str());
        self.options.captions.of(token, self.log(), &self.options.prompt)
    }
}

/// Writes the samples of a shard.
pub(crate) trait LayoutWriter {
    /// Adds a sample; samples arrive in order.
    fn add(&mut self, shard: &mut Shard, sample: &Sample<'_>, maps: &Maps) -> Result<(), ExportError>;

    /// Writes what belongs to the shard as a whole.
    fn finish(self: Box<Self>, shard: &mut Shard) -> Result<(), ExportError>;
}

/// Returns the sizes of the maps of all cameras.
pub(crate) fn sizes(maps: &Maps) -> Vec<ImageSize> {
    maps.cameras().iter().map(|camera| camera.size()).collect()
}
