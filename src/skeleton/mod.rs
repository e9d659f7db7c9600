//! The point skeleton of a drive: static background, one asset per tracked actor, category templates.
//!
//! # How it works
//! [`build()`] reads the sweeps, tells background from actors by the boxes ([`Splitter`]), finds what hides what in
//! every image ([`OcclusionGrid`]), gives every point one color from the camera with the best view ([`ColorView`]),
//! merges voxels, and keeps the background in chunks with an origin each, so that global coordinates stay `f64` and
//! points are `f32`. [`Skeleton`] is the result on disk, memory-mapped.

mod augment;
mod build;
mod checksum;
mod colorize;
mod manifest;
mod occlusion;
mod options;
mod split;
mod store;
mod sweep;
mod templates;
mod trajectory;

pub use augment::{AugmentOptions, Augmentation, augment};
pub use build::{BuildError, BuildInput, BuildRun, MakeTemplates, Progress, build, unfinished_frames};
pub use checksum::Checksum;
pub use colorize::{Candidate, ColorView, Look, Projector, agreed_color};
pub use manifest::{Asset, BuildReport, Chunk, Manifest, Source, Template};
pub use occlusion::{CELL_PX, OcclusionGrid, OcclusionMap};
pub use options::{BuildOptions, Coloring};
pub use split::{Part, SplitOptions, Splitter};
pub use store::{Skeleton, SkeletonWriter};
pub use templates::{
    ClusterReport, Instances, LibraryManifest, LogSource, TemplateCloud, TemplateKind, TemplateLibrary,
    TemplateOptions, TemplateReport, TemplateSummary, default_template, default_templates,
};
pub use trajectory::Trajectories;

/// Side of a background chunk, metres: `f32` offsets within it are exact to a few micrometres.
pub const CHUNK_M: f64 = 32.0;
