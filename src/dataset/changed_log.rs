use std::sync::Arc;

use super::edited::apply;
use super::{
    Action, ActorEdits, Appearance, Change, DatasetError, EditError, ImageRecord, LogReader, PosedActor,
    Recording, Sweep, SweepRecord, VectorMap, ViewRenderer,
};
use crate::geometry::View;
use crate::scene::EgoOffset;

/// A log with another ego or other actors than it was recorded with. Sweeps and images stay as they were
/// recorded.
pub struct ChangedLog {
    log: Recording,
    reader: Arc<dyn LogReader>,
}

impl ChangedLog {
    /// Displaces the ego of a synthetic log and its cameras at all times: actors and LiDAR sweeps stay where
    /// they are, and images are rendered where the cameras are then. `None` if the log is recorded, since its
    /// images exist at the recorded poses alone.
    pub fn with_moved_ego(reader: Arc<dyn LogReader>, offset: EgoOffset) -> Option<Self> {
        reader.view_renderer()?;
        let mut log = reader.recording().clone();
        let (ego_from_moved, moved_from_ego) = (offset.pose(), offset.pose().inverse());
        for frame in &mut log.frames {
            frame.global_from_ego = frame.global_from_ego * ego_from_moved;
            for image in frame.images.iter_mut().chain(&mut frame.between_images) {
                image.global_from_ego = image.global_from_ego * ego_from_moved;
            }
            for sweep in &mut frame.sweeps {
                sweep.global_from_ego = sweep.global_from_ego * ego_from_moved;
                sweep.ego_from_lidar = moved_from_ego * sweep.ego_from_lidar;
            }
        }
        Some(Self { log, reader })
    }

    /// Edits the actors of a log that has no edits.
    ///
    /// # Errors
    /// Fails if the log does not have a track at its time.
    pub(crate) fn with_edits(reader: Arc<dyn LogReader>, edits: &ActorEdits) -> Result<Self, EditError> {
        let log = apply(edits, reader.recording())?;
        Ok(Self { log, reader })
    }

    /// Returns the track that an actor looks like at a time, absolute microseconds; `None` for a template.
    fn asset_at<'a>(&'a self, track: &'a str, t_us: i64) -> Option<&'a str> {
        let index = self.log.tracks.iter().position(|known| known.id == track);
        let look = index.and_then(|index| self.log.script.look_at(index, t_us));
        look.map_or_else(|| self.log.edits.asset(track), |look| Appearance::asset(Some(look), track))
    }
}

impl LogReader for ChangedLog {
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

    /// The counts are by the boxes of a frame, which edits add to.
    fn box_points(&self) -> Option<&[Vec<Option<u32>>]> {
        self.reader.box_points().filter(|_| self.log.edits.is_empty())
    }

    fn read_map(&self) -> Result<Option<VectorMap>, DatasetError> {
        self.reader.read_map()
    }

    /// Templates cannot be rendered: what they show is unknown.
    fn view_renderer(&self) -> Option<&dyn ViewRenderer> {
        if self.log.edits.is_empty() {
            return self.reader.view_renderer();
        }
        let edits = &self.log.edits;
        let is_of_log = |track: &&str| self.reader.recording().tracks.iter().any(|known| known.id == **track);
        let is_drawn = |change: &Change| change.action != Action::Replace(Appearance::Template);
        let changed = edits.changes.iter().map(|change| &change.track).chain(edits.replace.keys());
        let is_known = changed.into_iter().all(|track| {
            let has_file =
                matches!(edits.replace.get(track), Some(Appearance::File(_) | Appearance::Skeleton { .. }));
            !has_file && edits.asset(track).as_ref().is_some_and(is_of_log)
        });
        let is_known = is_known && edits.changes.iter().all(is_drawn);
        self.reader.view_renderer().filter(|_| is_known).map(|_| self as &dyn ViewRenderer)
    }
}

/// Renders the edited actors.
impl ViewRenderer for ChangedLog {
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
            let track = self.asset_at(actor.track, t_us)?;
            Some(PosedActor { track, cuboid: actor.cuboid })
        });
        renderer.render_views(t_us, Some(&shown.collect::<Vec<_>>()), views)
    }
}
