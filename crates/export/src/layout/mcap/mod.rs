//! `mcap`: `SHARD.mcap` with protobuf messages in the schemas of Foxglove, for Foxglove, Lichtblick and Rerun.
//!
//! Topics are `/camera/CAM/calibration`, `/camera/CAM/MAP` and `/camera/CAM/image` (the recorded image) of each camera, `/tf`,
//! `/actors` and `/log`. All messages of a sample have its time. The frame `map` has the axes of the global frame and its origin
//! at the ego's position in the first frame of the log, since viewers draw in single precision. The metadata record `log` states
//! the origin.

mod file;
mod messages;

use foxglove::messages::Timestamp;
use glam::DVec3;
use point_skeleton::Maps;

use self::file::LogFile;
use super::{LayoutWriter, Source, sizes};
use crate::ExportError;
use crate::files::{Encoded, images_as_jpeg, maps_as_png};
use crate::samples::Sample;
use crate::shard::Shard;

pub(super) struct Mcap<'a> {
    source: &'a Source<'a>,
    file: LogFile,
    /// Origin of the frame `map`, global coordinates.
    origin: DVec3,
    /// Whether `/log` has its message.
    is_described: bool,
}

impl<'a> Mcap<'a> {
    pub(super) fn begin(shard: &Shard, source: &'a Source<'a>) -> Result<Self, ExportError> {
        let log = source.log();
        let origin = log.frames.first().map_or(DVec3::ZERO, |frame| frame.global_from_ego.translation);
        let mut file = LogFile::begin(shard.create(format!("{}.mcap", shard.name()))?)?;
        let metadata = [
            ("name", log.name.clone()),
            ("location", log.location.clone()),
            ("map_origin", serde_json::json!(origin.to_array()).to_string()),
        ];
        file.describe("log", metadata.map(|(key, value)| (key.to_owned(), value)).into())?;
        Ok(Self { source, file, origin, is_described: false })
    }

    /// Returns the time of messages of a sample.
    fn time(&self, t_us: i64) -> Result<Timestamp, ExportError> {
        messages::timestamp(t_us).ok_or_else(|| ExportError::Lacks {
            expected: "times from 1970 to 2106",
            found: format!("{t_us} microseconds after 1970"),
            log: self.source.log().name.clone(),
        })
    }

    /// Writes the name of the log and its caption, once per file.
    fn describe(&mut self, time: Timestamp) -> Result<(), ExportError> {
        if !std::mem::replace(&mut self.is_described, true) {
            let log = self.source.log();
            let caption = self.source.log_caption();
            self.file.write("/log", time, &messages::text(&log.name, caption, time))?;
        }
        Ok(())
    }

    fn write_images(&mut self, sample: &Sample<'_>, maps: &Maps, time: Timestamp) -> Result<(), ExportError> {
        let options = self.source.options;
        let frame = |index: usize| messages::camera_frame(&maps.cameras()[index].name);
        let topic = |index: usize, kind: &str| format!("/{}/{kind}", frame(index));
        let pngs = maps_as_png(maps.cameras(), &options.conditions.depth_bins, |index, kind| {
            Some(topic(index, kind.name()))
        })?;
        let mut jpegs = Vec::new();
        if options.images {
            jpegs = images_as_jpeg(self.source.dataset, sample, &sizes(maps), |index| topic(index, "image"))?;
        }
        for (format, files) in [("png", pngs), ("jpeg", jpegs)] {
            for Encoded { name, bytes } in files {
                self.file.write(&name, time, &messages::image(&name, format, bytes, time))?;
            }
        }
        Ok(())
    }
}

impl LayoutWriter for Mcap<'_> {
    fn add(&mut self, _: &mut Shard, sample: &Sample<'_>, maps: &Maps) -> Result<(), ExportError> {
        let state = &sample.state;
        let time = self.time(state.t_us)?;
        self.describe(time)?;
        self.file.write("/tf", time, &messages::transforms(state, self.origin, time))?;
        self.file.write("/actors", time, &messages::actors(&state.actors, self.origin, time))?;
        for (camera, size) in state.cameras.iter().zip(sizes(maps)) {
            let calibration = messages::calibration(&camera.view.camera, size, time);
            self.file.write(&format!("/{}/calibration", calibration.frame_id), time, &calibration)?;
        }
        self.write_images(sample, maps, time)
    }

    fn finish(self: Box<Self>, shard: &mut Shard) -> Result<(), ExportError> {
        Ok(shard.close(self.file.finish()?)?)
    }
}
