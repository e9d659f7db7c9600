//! Recording of a training clip: conditions as the network receives them, and ground-truth images.

use point_skeleton::dataset::{DatasetError, Recording};
use point_skeleton::error::FileError;
use point_skeleton::geometry::View;
use point_skeleton::raster::RasterizerDesc;
use point_skeleton::scene::{
    EgoOffset, GroundTruthError, GroundTruthImages, SceneState, SubstituteOptions, frame_rate_hz,
    state_of_frame,
};
use point_skeleton::skeleton::{BuildError, Skeleton};
use point_skeleton::{Log, RenderOptions, Renderer};
use pskel_generate::{DenoiserError, DriveFrame, DriveInfo, Recipe, TrainingClip};

/// A log to record, and the skeleton that was built from it.
pub(super) struct Source<'a> {
    pub(super) log: &'a Log,
    /// Fingerprints of recording and HD map.
    pub(super) fingerprint: &'a str,
    pub(super) skeleton: &'a Skeleton,
    pub(super) recipe: &'a Recipe,
    pub(super) rasterizer: &'a RasterizerDesc,
}

/// Difference between a clip and the recorded drive.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Variant {
    /// Offset from the recorded ego pose.
    pub(super) offset: EgoOffset,
    /// Seed of the asset augmentation.
    pub(super) augment: Option<u64>,
}

/// Error of recording or opening training clips.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The network does not support the log's camera count.
    #[error("expected 1 to 8 cameras, found {found} in log {log}")]
    Cameras {
        /// Camera count of the log.
        found: usize,
        /// Name of the log.
        log: String,
    },
    /// The log has no state for a frame.
    #[error("expected frame {frame} in log {log}")]
    Frame {
        /// Number of the frame.
        frame: usize,
        /// Name of the log.
        log: String,
    },
    /// The log cannot be read.
    #[error("{0}")]
    Log(#[from] DatasetError),
    /// The skeleton cannot be built.
    #[error("{0}")]
    Skeleton(#[from] BuildError),
    /// The conditions cannot be rendered.
    #[error("{0}")]
    Render(#[from] point_skeleton::Error),
    /// The ground-truth images cannot be rendered or read.
    #[error("{0}")]
    GroundTruth(#[from] GroundTruthError),
    /// The conditions do not have the form that the recipe requires.
    #[error("{0}")]
    Conditions(#[from] DenoiserError),
    /// A clip, the skeleton or a template cannot be read or written.
    #[error("{0}")]
    File(#[from] FileError),
}

impl Source<'_> {
    /// Records all frames.
    pub(super) fn record(&self, variant: Variant) -> Result<TrainingClip, RecordError> {
        let log = self.log.recording();
        let (substitutes, _) =
            SubstituteOptions::augmented(variant.augment).make(self.skeleton, &log.name)?;
        let map = self.log.require_map()?;
        let conditions = self.recipe.options(map.is_some());
        let options = RenderOptions {
            conditions: conditions.clone(),
            selection: self.recipe.selection(),
            rasterizer: self.rasterizer.clone(),
            substitutes: &substitutes,
            log: Some(&log.name),
            ..RenderOptions::default()
        };
        let mut renderer = Renderer::new(self.skeleton, options)?;
        let about = self.about(log);
        let (mut frames, mut before) = (Vec::new(), None);
        for frame in 0..log.frames.len() {
            let state = state_of_frame(log, frame, variant.offset);
            let state = state.ok_or_else(|| RecordError::Frame { frame, log: log.name.clone() })?;
            let state = SceneState { map: map.clone(), ..state };
            let set = renderer.render(&state)?.set;
            let drawn = |view: &View| conditions.drawn_view(view);
            let images =
                GroundTruthImages::new(self.log.reader()).of(&state, drawn, self.recipe.size, true)?;
            frames.push(DriveFrame::new(&about, &set, &state, before, &images)?);
            before = Some(state.global_from_ego);
        }
        Ok(TrainingClip { about, frames })
    }

    fn about(&self, log: &Recording) -> DriveInfo {
        DriveInfo {
            log: log.name.clone(),
            source: self.fingerprint.to_owned(),
            hz: frame_rate_hz(&log.frames).unwrap_or(0.0),
            cameras: log.cameras.iter().map(ToString::to_string).collect(),
            recipe: self.recipe.clone(),
        }
    }
}
