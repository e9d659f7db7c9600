//! `frames`: `LOG/FRAME/CAMERA/MAP.png` and `LOG/FRAME/meta.json`.

use point_skeleton::Maps;

use super::{LayoutWriter, Source, sizes};
use crate::ExportError;
use crate::files::{images_as_jpeg, maps_as_png};
use crate::samples::Sample;
use crate::shard::Shard;

pub(super) struct Frames<'a> {
    source: &'a Source<'a>,
}

impl<'a> Frames<'a> {
    pub(super) fn new(source: &'a Source<'a>) -> Self {
        Self { source }
    }
}

impl LayoutWriter for Frames<'_> {
    fn add(&mut self, shard: &mut Shard, sample: &Sample<'_>, maps: &Maps) -> Result<(), ExportError> {
        let folder = format!("{}/{}", self.source.listed.name, sample.state.name);
        let camera = |index: usize| &maps.cameras()[index].name;
        let bins = &self.source.options.conditions.depth_bins;
        let mut files = maps_as_png(maps.cameras(), bins, |index, kind| {
            Some(format!("{folder}/{}/{}.png", camera(index), kind.name()))
        })?;
        if self.source.options.images {
            let name = |index| format!("{folder}/{}/image.jpg", camera(index));
            files.extend(images_as_jpeg(shard, self.source.log, sample, &sizes(maps), name)?);
        }
        for file in files {
            shard.put(file.name, &file.bytes)?;
        }
        let meta = serde_json::json!(self.source.meta(maps));
        Ok(shard.put(format!("{folder}/meta.json"), format!("{meta:#}\n").as_bytes())?)
    }

    fn finish(self: Box<Self>, _: &mut Shard) -> Result<(), ExportError> {
        Ok(())
    }
}
