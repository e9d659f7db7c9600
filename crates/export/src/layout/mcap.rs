//! `mcap`: `SHARD.mcap`, a file of `pskel-mcap` with the topics `/camera/CAM/MAP` and `/camera/CAM/image`
//! (the recorded image).

use point_skeleton::Maps;
use pskel_mcap::{Level, SceneFile, Timestamp, camera_topic};

use super::{LayoutWriter, Source, sizes};
use crate::ExportError;
use crate::files::{Encoded, images_as_jpeg, maps_as_png};
use crate::samples::Sample;
use crate::shard::{HashedFile, Shard};

pub(super) struct Mcap<'a> {
    source: &'a Source<'a>,
    file: SceneFile<HashedFile>,
    /// Whether `/log` has its message.
    is_described: bool,
}

impl<'a> Mcap<'a> {
    pub(super) fn begin(shard: &Shard, source: &'a Source<'a>) -> Result<Self, ExportError> {
        let file = shard.create(format!("{}.mcap", shard.name()))?;
        let shown = file.shown.clone();
        Ok(Self { source, file: SceneFile::begin(file, &shown, source.recording())?, is_described: false })
    }

    /// Writes the name of the log and its caption, once per file.
    fn describe(&mut self, time: Timestamp) -> Result<(), ExportError> {
        if !std::mem::replace(&mut self.is_described, true) {
            let caption = self.source.log_caption();
            self.file.write_text(Level::Info, &self.source.recording().name, caption, time)?;
        }
        Ok(())
    }

    fn write_images(
        &mut self,
        shard: &mut Shard,
        sample: &Sample<'_>,
        maps: &Maps,
        time: Timestamp,
    ) -> Result<(), ExportError> {
        let options = self.source.options;
        let topic = |index: usize, kind: &str| camera_topic(&maps.cameras()[index].name, kind);
        let pngs = maps_as_png(maps.cameras(), &options.conditions.depth_bins, |index, kind| {
            Some(topic(index, kind.name()))
        })?;
        let mut jpegs = Vec::new();
        if options.images {
            jpegs =
                images_as_jpeg(shard, self.source.log, sample, &sizes(maps), |index| topic(index, "image"))?;
        }
        for (format, files) in [("png", pngs), ("jpeg", jpegs)] {
            for Encoded { name, bytes } in files {
                self.file.write_image(&name, format, bytes, time)?;
            }
        }
        Ok(())
    }
}

impl LayoutWriter for Mcap<'_> {
    fn add(&mut self, shard: &mut Shard, sample: &Sample<'_>, maps: &Maps) -> Result<(), ExportError> {
        let time = self.file.time(sample.state.t_us)?;
        self.describe(time)?;
        self.file.write_state(&sample.state, &sizes(maps), time)?;
        self.write_images(shard, sample, maps, time)
    }

    fn finish(self: Box<Self>, shard: &mut Shard) -> Result<(), ExportError> {
        Ok(shard.close(self.file.finish()?)?)
    }
}
