//! Recording of training clips from logs: conditions as the network receives them, and ground-truth images.

use std::sync::Arc;

use point_skeleton::conditions;
use point_skeleton::dataset::{Dataset, Log};
use point_skeleton::geometry::View;
use point_skeleton::scene::{
    EgoOffset, SceneClouds, SceneMap, SceneState, SelectionOptions, SubstituteOptions, frame_rate_hz,
    state_of_frame,
};
use point_skeleton::skeleton::Skeleton;
use pskel_generate::{DriveFrame, DriveInfo, GroundTruthImages, Recipe, TrainingClip};
use pskel_town::Town;

use crate::rasterizer::RasterizerArgs;

/// A town to record, and the skeleton that was built from it.
pub(super) struct Source<'a> {
    /// Renders ground truth from any pose.
    pub(super) town: &'a Town,
    pub(super) skeleton: &'a Skeleton,
    pub(super) recipe: &'a Recipe,
    pub(super) rasterizer: &'a RasterizerArgs,
}

/// Difference between a clip and the recorded drive.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Variant {
    /// Offset from the recorded ego pose.
    pub(super) offset: EgoOffset,
    /// Seed of the asset augmentation.
    pub(super) augment: Option<u64>,
}

impl Source<'_> {
    /// Records all frames.
    pub(super) fn record(&self, variant: Variant) -> anyhow::Result<TrainingClip> {
        let log = self.town.log();
        let (stand_ins, _) = SubstituteOptions::augmented(variant.augment).make(self.skeleton, &log.name)?;
        let stage = SceneClouds::with(self.skeleton, &log.name, &stand_ins)?;
        let mut rasterizer = self.rasterizer.create(stage.cloud_set())?;
        let map = self.town.read_map()?.map(|map| Arc::new(SceneMap::new(map, log)));
        let options = self.recipe.options(map.is_some());
        let about = self.about(log);
        let (mut frames, mut before) = (Vec::new(), None);
        for index in 0..log.frames.len() {
            let state = state_of_frame(log, index, variant.offset);
            let state = state.ok_or_else(|| anyhow::anyhow!("expected frame {index} in log {}", log.name))?;
            let state = SceneState { map: map.clone(), ..state };
            let instances = stage.instances(&state, &SelectionOptions::default());
            let set = conditions::render(rasterizer.as_mut(), &instances, &state, &options)?;
            let drawn = |view: &View| options.drawn_view(view);
            let images = GroundTruthImages::new(self.town).of(&state, drawn, self.recipe.size, true)?;
            frames.push(DriveFrame::new(&about, &set, &state, before, &images)?);
            before = Some(state.global_from_ego);
        }
        Ok(TrainingClip { about, frames })
    }

    fn about(&self, log: &Log) -> DriveInfo {
        DriveInfo {
            log: log.name.clone(),
            hz: frame_rate_hz(&log.frames).unwrap_or(0.0),
            cameras: log.cameras.iter().map(ToString::to_string).collect(),
            recipe: self.recipe.clone(),
        }
    }
}
