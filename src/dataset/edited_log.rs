use std::sync::Arc;

use super::{
    ActorEdits, DatasetError, EditError, ImageRecord, LogReader, PosedActor, Recording, Sweep, SweepRecord,
    VectorMap, ViewRenderer,
};
use crate::geometry::View;

/// A log with edited actors. Sweeps and images stay as they were recorded.
pub(crate) struct EditedLog {
    log: Recording,
    reader: Arc<dyn LogReader>,
}

impl EditedLog {
    /// Edits the actors of a log.
    ///
    /// # Errors
    /// Fails if the log does not have a track at its time.
    pub(crate) fn new(reader: Arc<dyn LogReader>, edits: &ActorEdits) -> Result<Self, EditError> {
        let log = edits.apply(reader.recording())?;
        Ok(Self { log, reader })
    }
}

impl LogReader for EditedLog {
    fn recording(&self) -> &Recording {
        &self.log
    }

    fn read_sweep(&self, record: &SweepRecord) -> Result<Sweep, DatasetError> {
        self.reader.read_sweep(record)
    }

    fn check_sweep(&self, record: &SweepRecord) -> Result<Option<u64>, DatasetError> {
        self.reader.check_sweep(record)
    }

    fn read_image(&self, record: &ImageRecord) -> Result<image::RgbImage, DatasetError> {
        self.reader.read_image(record)
    }

    fn check_image(&self, record: &ImageRecord) -> Result<(), DatasetError> {
        self.reader.check_image(record)
    }

    fn read_map(&self) -> Result<Option<VectorMap>, DatasetError> {
        self.reader.read_map()
    }

    /// Templates cannot be rendered: what they show is unknown.
    fn view_renderer(&self) -> Option<&dyn ViewRenderer> {
        let is_known = self.log.edits.replace.keys().all(|track| self.log.edits.asset(track).is_some());
        self.reader.view_renderer().filter(|_| is_known).map(|_| self as &dyn ViewRenderer)
    }
}

impl ViewRenderer for EditedLog {
    fn render_views(
        &self,
        t_us: i64,
        actors: Option<&[PosedActor<'_>]>,
        views: &[View],
    ) -> Result<Vec<image::RgbImage>, DatasetError> {
        let Some(renderer) = self.reader.view_renderer() else { return Ok(Vec::new()) };
        let own: Vec<PosedActor<'_>> = match actors {
            Some(actors) => actors.to_vec(),
            None => {
                let boxes = self.log.boxes_at(t_us).into_iter();
                let posed = |cuboid, track: usize| PosedActor { track: &self.log.tracks[track].id, cuboid };
                boxes.map(|item| posed(item.cuboid, item.track)).collect()
            }
        };
        let shown = own.iter().filter_map(|actor| {
            let track = self.log.edits.asset(actor.track)?;
            Some(PosedActor { track, cuboid: actor.cuboid })
        });
        renderer.render_views(t_us, Some(&shown.collect::<Vec<_>>()), views)
    }
}
