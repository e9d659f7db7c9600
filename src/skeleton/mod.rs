//! The point skeleton of a drive: static background, one asset per tracked actor, category templates.
//!
//! # How it works
//! [`build()`] reads the sweeps, tells background from actors by the boxes ([`Splitter`]), finds what hides what in
//! every image ([`OcclusionGrid`]), gives every point one color from the camera with the best view ([`ColorView`]),
//! merges voxels, and keeps the background in chunks with an origin each, so that global coordinates stay `f64` and
//! points are `f32`. [`Skeleton`] is the result on disk, memory-mapped.

mod augment;
mod build;
mod chunks;
mod colorize;
mod manifest;
mod occlusion;
mod options;
mod split;
mod store;
mod sweep;
mod templates;
mod trajectory;
mod voxel;

pub use augment::{AugmentOptions, Augmentation, augment};
pub use build::{BuildError, Progress, build};
pub use chunks::{CHUNK_M, chunks_from_points};
pub use colorize::{Candidate, ColorView, Look, Projector, agreed_color};
pub use manifest::{Asset, BuildReport, Chunk, Manifest, Source, Template};
pub use occlusion::{CELL_PX, OcclusionGrid, OcclusionMap};
pub use options::{BuildOptions, Coloring};
pub use split::{Part, SplitOptions, Splitter};
pub use store::{BuiltSkeleton, Skeleton};
pub use templates::{
    ClusterReport, Instances, LibraryManifest, LogSource, TemplateCloud, TemplateKind, TemplateLibrary,
    TemplateOptions, TemplateReport, TemplateSummary, default_template, default_templates,
};
pub use trajectory::Trajectories;
pub use voxel::{ColoredPoint, merge_voxels};
