//! Layouts: the files that each kind of reader expects. One module each.

#[cfg(feature = "parquet")]
mod alpasim;
mod clips;
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

use std::path::Path;
#[cfg(feature = "parquet")]
use std::sync::Arc;

use point_skeleton::Log;
use point_skeleton::Maps;
use point_skeleton::conditions::write::meta::FrameMeta;
use point_skeleton::conditions::{ConditionOptions, ImageSize};
use point_skeleton::dataset::Recording;
use point_skeleton::error::FileError;
#[cfg(feature = "parquet")]
use point_skeleton::scene::SceneMap;
use point_skeleton::scene::frame_rate_hz;
use serde_json::Value;

use crate::samples::Sample;
use crate::shard::{Shard, ShardInput, ShardRecord};
use crate::{ExportError, ExportOptions, Layout, ListedLog, SampleTimes, WorkList};

/// Returns a writer of a shard.
pub(crate) fn writer<'a>(
    layout: Layout,
    shard: &Shard,
    source: &'a Source<'a>,
) -> Result<Box<dyn LayoutWriter + 'a>, ExportError> {
    Ok(match layout {
        Layout::Frames => Box::new(frames::Frames::new(source)),
        Layout::PasCache => Box::new(pas_cache::PasCache::new(source)),
        Layout::OpendwmPreview => Box::new(opendwm_preview::Package::new(source, shard.name())),
        Layout::Webdataset => Box::new(webdataset::Tar::begin(shard, source)?),
        Layout::Streetcrafter => Box::new(clips::streetcrafter::Scene::new(source)),
        Layout::Freevs => Box::new(clips::freevs::Segment::new(source)),
        #[cfg(feature = "mcap")]
        Layout::Mcap => Box::new(mcap::Mcap::begin(shard, source)?),
        #[cfg(feature = "parquet")]
        Layout::Alpasim => Box::new(alpasim::Scene::new(source)),
        #[cfg(feature = "parquet")]
        Layout::WorldScenario => Box::new(world_scenario::WorldScenario::new(source)),
        #[cfg(feature = "video")]
        Layout::CosmosVideo => Box::new(cosmos_video::Videos::new(source, shard.name())),
    })
}

/// Checks, before any work, that a layout can hold the maps of a log.
///
/// # Errors
/// Fails if the encoder of the layout cannot encode the sizes of the maps, or if the log has another rate,
/// more cameras or fewer frames than the layout.
pub(crate) fn check(options: &ExportOptions, log: &Recording) -> Result<(), ExportError> {
    if let Some(rules) = options.layout.clip_rules() {
        clips::check(rules, options, log)?;
    }
    match options.layout {
        Layout::Streetcrafter => clips::streetcrafter::check(log),
        #[cfg(feature = "parquet")]
        Layout::Alpasim => alpasim::check(options, log),
        #[cfg(feature = "video")]
        Layout::CosmosVideo => cosmos_video::check(options, log),
        _ => Ok(()),
    }
}

/// Checks, before any work, the names of an export's logs.
///
/// # Errors
/// Fails if the layout cannot have logs of these names, or if a named log does not exist.
pub(crate) fn check_logs(options: &ExportOptions, list: &WorkList) -> Result<(), ExportError> {
    match options.layout {
        Layout::Streetcrafter => clips::streetcrafter::check_logs(options, list),
        _ => Ok(()),
    }
}

/// Returns the options for rendering a log: if no size is requested, with the layout's own.
///
/// # Errors
/// Fails if the layout has no size for the cameras of the log.
pub(crate) fn conditions(options: &ExportOptions, log: &Recording) -> Result<ConditionOptions, ExportError> {
    match options.layout.clip_rules() {
        Some(rules) => clips::sized(rules, &options.conditions, log),
        None => Ok(options.conditions.clone()),
    }
}

/// Returns the layout's lists of clips; `None` for layouts without clips.
pub(crate) fn clip_lists(layout: Layout) -> Option<Box<dyn ClipLists>> {
    match layout {
        Layout::Streetcrafter => Some(Box::new(clips::streetcrafter::Lists::default())),
        Layout::Freevs => Some(Box::new(clips::freevs::Lists::default())),
        _ => None,
    }
}

/// Returns the entry of a shard in `index.json`.
pub(crate) fn index_entry(layout: Layout, record: &ShardRecord) -> Value {
    match (layout, record.files.first()) {
        // The keys of wids, the index format of the package webdataset.
        (Layout::Webdataset, Some(file)) => serde_json::json!({
            "url": file.path, "nsamples": record.samples, "filesize": file.bytes, "sha256": file.sha256,
        }),
        _ => {
            serde_json::json!({ "name": record.name, "nsamples": record.samples,
            "files": record.files.len() })
        }
    }
}

/// Log of a shard.
pub(crate) struct Source<'a> {
    pub(crate) listed: &'a ListedLog,
    pub(crate) log: &'a Log,
    pub(crate) options: &'a ExportOptions,
    /// Fingerprints of log, skeleton, HD map and templates.
    pub(crate) input: ShardInput,
    #[cfg(feature = "parquet")]
    pub(crate) map: Option<Arc<SceneMap>>,
}

impl Source<'_> {
    pub(crate) fn recording(&self) -> &Recording {
        self.log.recording()
    }

    /// Returns the frame rate of the samples, per second; `None` if their times are uneven.
    pub(crate) fn fps(&self) -> Option<f64> {
        match self.options.times {
            SampleTimes::KeyFrames => frame_rate_hz(&self.recording().frames),
            SampleTimes::Images => None,
            SampleTimes::Rate { hz } => Some(hz),
        }
    }

    pub(crate) fn meta(&self, maps: &Maps) -> FrameMeta {
        maps.meta(&self.options.prompt, self.fps())
    }

    /// Returns the caption of the log.
    pub(crate) fn log_caption(&self) -> String {
        self.options.captions.of_log(self.recording(), &self.options.prompt)
    }

    /// Returns the captions of the cameras' images.
    pub(crate) fn captions(&self, sample: &Sample<'_>) -> Vec<String> {
        let names = sample.state.cameras.iter().map(|camera| &camera.view.camera.name);
        let cameras: Vec<_> = names.zip(sample.images.iter().copied()).collect();
        let (captions, prompt) = (&self.options.captions, &self.options.prompt);
        captions.of_cameras(self.recording(), sample.state.t_us, &cameras, prompt)
    }
}

/// Writes the samples of a shard.
pub(crate) trait LayoutWriter {
    /// Adds a sample; samples arrive in order.
    fn add(&mut self, shard: &mut Shard, sample: &Sample<'_>, maps: &Maps) -> Result<(), ExportError>;

    /// Writes what belongs to the shard as a whole.
    fn finish(self: Box<Self>, shard: &mut Shard) -> Result<(), ExportError>;
}

/// Lists of an export's clips, written when all shards exist.
pub(crate) trait ClipLists {
    /// Adds the views of a shard. Shards arrive in order.
    fn add(&mut self, record: &ShardRecord);

    /// Writes the lists into the folder of the export, and returns the numbers of clips and views.
    ///
    /// # Errors
    /// Fails if there are not enough samples for a clip, or if a file cannot be written.
    fn write(&self, out: &Path) -> Result<Value, FileError>;
}

/// Returns the map sizes of all cameras.
pub(crate) fn sizes(maps: &Maps) -> Vec<ImageSize> {
    maps.cameras().iter().map(|camera| camera.size()).collect()
}
