//! Point skeleton of a recording: static background, one asset per tracked actor, category templates.
//!
//! # How it works
//! [`build()`] reads the sweeps and separates actors from background with the boxes ([`Splitter`]). It
//! computes occlusion in every image (`occlusion`), assigns each point one color on which the images agree
//! (`colorize`) and merges the points of each voxel. The background is stored in chunks with an origin each,
//! so that global coordinates stay `f64` and points are `f32`. [`Skeleton`] is the result on disk,
//! memory-mapped.

mod augment;
mod entry;
mod export;
mod from_points;
mod ingest;
mod manifest;
mod options;
mod store;
mod templates;
mod trajectory;

pub use augment::{AugmentOptions, Augmentation, augment};
pub use from_points::{AssetPoints, GlobalPoint};
pub use ingest::projector::Projector;
pub use ingest::split::{Part, SplitOptions, Splitter};
pub use ingest::{
    BuildError, BuildInput, BuildNeeds, BuildRun, Progress, build, open_or_build, unfinished_frames,
};
pub use manifest::{Asset, BuildReport, CategoryCounts, Chunk, Manifest, PageChecksums, Source, Template};
pub use options::{BuildOptions, Coloring};
pub use store::{GenerateTemplates, Skeleton, SkeletonWriter};
pub use templates::{
    ClusterReport, Instances, LibraryManifest, LogSource, TemplateCloud, TemplateKind, TemplateLibrary,
    TemplateOptions, TemplateReport, TemplateSources, TemplateSummary, default_templates, poisson_thin,
    read_template,
};
pub use trajectory::Trajectories;

/// Side of a background chunk, meters: `f32` offsets within it are exact to a few micrometers.
pub const CHUNK_M: f64 = 32.0;
