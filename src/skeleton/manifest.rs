use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{BuildOptions, Checksum};
use crate::cloud::Bounds;
use crate::dataset::Class;

/// `skeleton.json`: what the point files hold. Points of the listed clouds follow each other in the order of the
/// lists.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`Manifest::FORMAT`].
    pub format: String,
    /// [`Manifest::VERSION`].
    pub version: u32,
    /// Where it comes from: one entry a log.
    pub sources: Vec<Source>,
    /// How it was made.
    pub options: BuildOptions,
    /// What went in and what was left out.
    pub report: BuildReport,
    /// `background.points`: chunks of the static background.
    pub background: Vec<Chunk>,
    /// `actors.points`: one asset a track, sorted by track, then log.
    pub actors: Vec<Asset>,
    /// `templates.points`: one cloud a category template.
    pub templates: Vec<Template>,
}

impl Manifest {
    /// Points of all clouds.
    pub fn points(&self) -> usize {
        let background = self.background.iter().map(|c| c.points);
        background
            .chain(self.actors.iter().map(|a| a.points))
            .chain(self.templates.iter().map(|t| t.points))
            .sum()
    }

    /// Marks the folder.
    pub const FORMAT: &'static str = "point-skeleton";
    /// Changes whenever older readers would misread a skeleton.
    pub const VERSION: u32 = 3;

    /// First and last time of what it was built from of a log, absolute microseconds; `None` for another log.
    pub fn times_us(&self, log: &str) -> Option<[i64; 2]> {
        self.sources.iter().find(|source| source.log == log).map(|source| source.t_us)
    }
}

/// Without clouds.
impl Default for Manifest {
    fn default() -> Self {
        Self {
            format: Self::FORMAT.into(),
            version: Self::VERSION,
            sources: Vec::new(),
            options: BuildOptions::default(),
            report: BuildReport::default(),
            background: Vec::new(),
            actors: Vec::new(),
            templates: Vec::new(),
        }
    }
}

/// The log that a skeleton was built from.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Source {
    /// Scene or log name.
    pub log: String,
    /// Map location.
    pub location: String,
    /// Annotated frames used.
    pub frames: usize,
    /// First and last time, absolute microseconds.
    pub t_us: [i64; 2],
}

/// A cube of the background.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Chunk {
    /// Global position that its points are relative to, metres.
    pub origin: [f64; 3],
    /// How many.
    pub points: usize,
    /// Of the points, relative to the origin.
    pub bounds: Bounds,
    /// Of the points.
    pub xxh3: Checksum,
}

/// The points of one track in its box frame: the origin is the centre of the box, x forward.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Asset {
    /// Log that the track is in.
    pub log: String,
    /// Track id.
    pub track: String,
    /// The data set's category name.
    pub category: String,
    /// Coarse class.
    pub class: Class,
    /// Median length, width, height of the track's boxes, metres.
    pub size: [f64; 3],
    /// Sweeps that gave points.
    pub sweeps: usize,
    /// How many.
    pub points: usize,
    /// Of the points.
    pub bounds: Bounds,
    /// Of the points.
    pub xxh3: Checksum,
}

/// Points that stand in for actors of a kind.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Template {
    /// Kind: see [`TemplateKind`](super::TemplateKind).
    pub kind: super::TemplateKind,
    /// Coarse class.
    pub class: Class,
    /// Length, width, height of its points, metres.
    pub size: [f64; 3],
    /// How many.
    pub points: usize,
    /// Of the points, centred on the box.
    pub bounds: Bounds,
    /// Of the points.
    pub xxh3: Checksum,
}

/// Counts of a build. Every point read is dropped for one of the reasons below or kept in background or actors (once
/// for every camera that sees it where copies are wanted).
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct BuildReport {
    /// Read from sweeps, the not finite ones included.
    pub points_read: usize,
    /// NaN or infinite coordinates.
    pub dropped_not_finite: usize,
    /// On or in the way of a moving actor, seen at another time than its box stands for.
    pub dropped_ghost: usize,
    /// Returns from the ego vehicle itself.
    pub dropped_ego: usize,
    /// No image colors them.
    pub dropped_uncolored: usize,
    /// Kept, before voxels are merged: background, ...
    pub background_points: usize,
    /// ... and actors.
    pub actor_points: usize,
    /// Sweeps read.
    pub sweeps: usize,
    /// Images read.
    pub images: usize,
    /// What the reader of the log left out.
    pub notes: BTreeMap<String, usize>,
}
