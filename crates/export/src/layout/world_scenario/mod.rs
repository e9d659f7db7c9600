//! `world-scenario`: annotations of a clip for the world scenario renderer of Cosmos-Transfer2.5, and for
//! `clipgt/` of AlpaSim: a folder per shard with `CLIP.KIND.parquet` for obstacle, calibration_estimate,
//! egomotion_estimate, and, with an HD map, lane_line, road_boundary, crosswalk and wait_line.
//!
//! The origin of coordinates is the ego's pose at the first frame of the clip that is near most others.
//! Schemas follow NVIDIA's page *World Scenario Parquet File Structure*.

mod lanes;
mod parquet;
mod rails;
mod rig;
mod tables;

use point_skeleton::Maps;
use point_skeleton::scene::SceneMap;

pub(super) use self::tables::{Clip, category};
use super::{LayoutWriter, Source};
use crate::ExportError;
use crate::samples::Sample;
use crate::shard::Shard;

pub(super) struct WorldScenario<'a> {
    source: &'a Source<'a>,
}

impl<'a> WorldScenario<'a> {
    pub(super) fn new(source: &'a Source<'a>) -> Self {
        Self { source }
    }
}

impl LayoutWriter for WorldScenario<'_> {
    fn add(&mut self, _: &mut Shard, _: &Sample<'_>, _: &Maps) -> Result<(), ExportError> {
        Ok(())
    }

    fn finish(self: Box<Self>, shard: &mut Shard) -> Result<(), ExportError> {
        let name = shard.name().to_owned();
        let clip = Clip::new(self.source.recording(), shard.frames(), &name);
        for table in clip.tables(self.source.map.as_deref().map(SceneMap::vector_map)) {
            shard.put(format!("{name}/{name}.{}.parquet", table.kind), &table.encode()?)?;
        }
        Ok(())
    }
}
