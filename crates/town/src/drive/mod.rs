//! The town as a recorded log: a [`LogReader`] whose sweeps and images are generated when they are read.
//!
//! # How it works
//! `record` converts the plan to a log: poses of all actors at the times of frames, sweeps and images. The
//! LiDAR simulation generates sweeps (`town`), the triangle renderer images (`truth`), both from the same
//! `meshes` and only on request. One pose transforms the town's frame to the global frame so that the whole
//! map has positive coordinates, on z = 0, as in nuScenes.

mod error;
mod format;
mod map;
mod meshes;
mod record;
mod renderer;
mod rig;
mod town;
mod truth;
mod write;

pub use error::TownError;
pub use format::FORMAT;
pub use town::{Town, TownRay};
pub use write::WriteError;

use image::RgbImage;
use point_skeleton::dataset::{
    DatasetError, ImageRecord, LogReader, PosedActor, Recording, Sweep, SweepRecord, VectorMap, ViewRenderer,
};
use point_skeleton::geometry::View;

use self::town::LOCATION;

impl LogReader for Town {
    fn recording(&self) -> &Recording {
        &self.log
    }

    fn read_sweep(&self, record: &SweepRecord) -> Result<Sweep, DatasetError> {
        Ok(self.sweep(record))
    }

    fn read_image(&self, record: &ImageRecord) -> Result<RgbImage, DatasetError> {
        Ok(self.image(record)?)
    }

    fn check_sweep(&self, _: &SweepRecord) -> Result<Option<u64>, DatasetError> {
        Ok(None)
    }

    fn check_image(&self, _: &ImageRecord) -> Result<(), DatasetError> {
        Ok(())
    }

    fn read_map(&self) -> Result<Option<VectorMap>, DatasetError> {
        Ok(Some(map::vector_map(&self.plan.network, LOCATION, &self.global_from_town).0))
    }

    fn view_renderer(&self) -> Option<&dyn ViewRenderer> {
        Some(self)
    }
}

impl ViewRenderer for Town {
    fn render_views(
        &self,
        t_us: i64,
        actors: Option<&[PosedActor<'_>]>,
        views: &[View],
    ) -> Result<Vec<RgbImage>, DatasetError> {
        let rendered = match actors {
            Some(actors) => self.truth_of(t_us, actors, views)?,
            None => self.truth(t_us, views)?,
        };
        Ok(rendered.into_iter().map(|view| view.image).collect())
    }
}
