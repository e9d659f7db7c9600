use std::collections::{BTreeMap, BTreeSet};

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use super::{BuildOptions, Checksum};
use crate::cloud::Bounds;
use crate::dataset::{Class, Recording};

/// Contents of `skeleton.json`: description of the point files. Each file stores the clouds of its list
/// consecutively, in the list's order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`Manifest::FORMAT`].
    pub format: String,
    /// [`Manifest::VERSION`].
    pub version: u32,
    /// Source logs.
    pub sources: Vec<Source>,
    /// Build options.
    pub options: BuildOptions,
    /// Counts of the build: points used and dropped.
    pub report: BuildReport,
    /// Chunks of the static background, in `background.points`.
    pub background: Vec<Chunk>,
    /// Assets, one per track, sorted by track, then log, in `actors.points`.
    pub actors: Vec<Asset>,
    /// Category templates, one cloud each, in `templates.points`.
    pub templates: Vec<Template>,
}

impl Manifest {
    /// Returns the number of points in all clouds.
    pub fn points(&self) -> usize {
        let templates: usize = self.templates.iter().map(|t| t.points).sum();
        self.background_points() + self.actor_points() + templates
    }

    /// Returns the number of points of the background.
    pub fn background_points(&self) -> usize {
        self.background.iter().map(|c| c.points).sum()
    }

    /// Returns the number of points of all assets.
    pub fn actor_points(&self) -> usize {
        self.actors.iter().map(|a| a.points).sum()
    }

    /// Returns minimum and maximum of the background, global meters; `None` without points.
    pub fn background_bounds(&self) -> Option<[DVec3; 2]> {
        let global = |origin: [f64; 3], local: [f32; 3]| DVec3::from(origin) + Vec3::from(local).as_dvec3();
        let all =
            self.background.iter().map(|c| [c.bounds.min, c.bounds.max].map(|local| global(c.origin, local)));
        all.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])
    }

    /// Counts assets and their points by category.
    pub fn categories(&self) -> BTreeMap<&str, CategoryCounts> {
        let mut categories: BTreeMap<&str, CategoryCounts> = BTreeMap::new();
        for asset in &self.actors {
            let counts = categories.entry(&asset.category).or_default();
            counts.actors += 1;
            counts.points += asset.points;
            counts.sweeps += asset.sweeps;
        }
        categories
    }

    /// Format identifier in the manifest.
    pub const FORMAT: &'static str = "point-skeleton";
    /// Format version; incremented when older readers would misread a skeleton.
    pub const VERSION: u32 = 3;

    /// Returns the first and last time used of a log, absolute microseconds; `None` if the skeleton was not built
    /// from it.
    pub fn times_us(&self, log: &str) -> Option<[i64; 2]> {
        self.sources.iter().find(|source| source.log == log).map(|source| source.t_us)
    }

    /// Returns whether a log has the place, the times and the tracks of the source with its name.
    pub(super) fn resembles(&self, log: &Recording) -> bool {
        let Some(source) = self.sources.iter().find(|source| source.log == log.name) else { return false };
        let has_time = |t_us: &i64| log.frames.iter().any(|frame| frame.t_us == *t_us);
        let tracks: BTreeSet<&str> = log.tracks.iter().map(|track| track.id.as_str()).collect();
        let mut assets = self.actors.iter().filter(|asset| asset.log == log.name);
        source.location == log.location
            && source.frames <= log.frames.len()
            && source.t_us.iter().all(has_time)
            && assets.all(|asset| tracks.contains(asset.track.as_str()))
    }
}

/// Counts of the assets of a category.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct CategoryCounts {
    /// Number of assets.
    pub actors: usize,
    /// Number of their points.
    pub points: usize,
    /// Number of sweeps that contributed points, summed over the assets.
    pub sweeps: usize,
}

/// Returns a manifest without clouds.
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

/// Source log of a skeleton.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Source {
    /// Scene or log name.
    pub log: String,
    /// Map location.
    pub location: String,
    /// Number of annotated frames used.
    pub frames: usize,
    /// Times of the first and last frame used, absolute microseconds.
    pub t_us: [i64; 2],
}

/// Cube of the background.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Chunk {
    /// Global position that the points are relative to, meters.
    pub origin: [f64; 3],
    /// Number of points.
    pub points: usize,
    /// Bounds of the points, relative to the origin.
    pub bounds: Bounds,
    /// Checksum of the points.
    pub xxh3: Checksum,
}

/// Points of one track in its box frame: the origin is the center of the box, x points forward.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Asset {
    /// Log of the track.
    pub log: String,
    /// Track id.
    pub track: String,
    /// Category name in the data set.
    pub category: String,
    /// Coarse class.
    pub class: Class,
    /// Median length, width, height of the track's boxes, meters.
    pub size: [f64; 3],
    /// Number of sweeps that contributed points.
    pub sweeps: usize,
    /// Number of points.
    pub points: usize,
    /// Bounds of the points.
    pub bounds: Bounds,
    /// Checksum of the points.
    pub xxh3: Checksum,
}

/// Substitute cloud for actors of a kind.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Template {
    /// Kind of the represented actors.
    pub kind: super::TemplateKind,
    /// Coarse class.
    pub class: Class,
    /// Length, width, height of the template's box, meters.
    pub size: [f64; 3],
    /// Number of points.
    pub points: usize,
    /// Bounds of the points, relative to the box center.
    pub bounds: Bounds,
    /// Checksum of the points.
    pub xxh3: Checksum,
}

/// Point counts of a build. Every point read is either dropped for one of the reasons below or retained in background
/// or actors. With [`Coloring::EveryCamera`](super::Coloring::EveryCamera) it is retained once per camera that sees
/// it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct BuildReport {
    /// Points read from sweeps, including those that are not finite.
    pub points_read: usize,
    /// Points with NaN or infinite coordinates.
    pub dropped_not_finite: usize,
    /// Points on a moving actor or in its path, measured at another time than its box.
    pub dropped_ghost: usize,
    /// LiDAR returns from the ego vehicle itself.
    pub dropped_ego: usize,
    /// Points without a color from any image.
    pub dropped_uncolored: usize,
    /// Retained background points, before voxels are merged.
    pub background_points: usize,
    /// Retained actor points, before voxels are merged.
    pub actor_points: usize,
    /// Number of sweeps read.
    pub sweeps: usize,
    /// Number of images read.
    pub images: usize,
    /// Items skipped by the log's reader: kinds with counts.
    pub notes: BTreeMap<String, usize>,
}

impl BuildReport {
    /// Returns the numbers of dropped points, by reason.
    pub fn dropped(&self) -> [(&'static str, usize); 4] {
        [
            ("ego", self.dropped_ego),
            ("ghost", self.dropped_ghost),
            ("not finite", self.dropped_not_finite),
            ("uncolored", self.dropped_uncolored),
        ]
    }
}
