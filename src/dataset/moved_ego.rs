use std::sync::Arc;

use super::{DatasetError, ImageRecord, LogReader, Recording, Sweep, SweepRecord, VectorMap, ViewRenderer};
use crate::scene::EgoOffset;

/// A synthetic log with the ego and its cameras displaced at all times. Actors and LiDAR sweeps stay where
/// they are, and images are rendered where the cameras are then.
pub struct MovedEgo {
    log: Recording,
    reader: Arc<dyn LogReader>,
}

impl MovedEgo {
    /// Displaces the ego of a log; `None` if the log is recorded, since its images exist at the recorded
    /// poses alone.
    pub fn new(reader: Arc<dyn LogReader>, offset: EgoOffset) -> Option<Self> {
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
}

impl LogReader for MovedEgo {
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

    fn box_points(&self) -> Option<&[Vec<Option<u32>>]> {
        self.reader.box_points()
    }

    fn read_map(&self) -> Result<Option<VectorMap>, DatasetError> {
        self.reader.read_map()
    }

    fn view_renderer(&self) -> Option<&dyn ViewRenderer> {
        self.reader.view_renderer()
    }
}
