use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use super::BuildOptions;
use crate::cloud::Bounds;
use crate::dataset::{Class, Recording};
use crate::error::FileError;
use crate::files::Checksum;
use crate::geometry::{MAX_COORDINATE_M, MAX_SIDE_M, MIN_SIDE_M, is_position, is_size};

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
    /// Checksums of the page tables.
    pub pages: PageChecksums,
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

    /// Returns the point count of the background.
    pub fn background_points(&self) -> usize {
        self.background.iter().map(|c| c.points).sum()
    }

    /// Returns the point count of all assets.
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

    /// Checks that positions, bounds and sizes are within the limits of all files.
    ///
    /// # Errors
    /// Returns an error that names the first cloud beyond them; `path` is the manifest.
    pub(super) fn check(&self, path: &Path) -> Result<(), FileError> {
        for (index, chunk) in self.background.iter().enumerate() {
            let of = || format!("chunk {index}");
            check_position("an origin", chunk.origin, of, path)?;
            check_bounds(&chunk.bounds, of, path)?;
        }
        for asset in &self.actors {
            let of = || format!("track {:?} of log {:?}", asset.track, asset.log);
            check_size(asset.size, of, path)?;
            check_bounds(&asset.bounds, of, path)?;
        }
        self.templates.iter().try_for_each(|template| template.check_limits(path))
    }

    /// Format identifier in the manifest.
    pub const FORMAT: &'static str = "point-skeleton";
    /// Format version; incremented when older readers would misread a skeleton.
    pub const VERSION: u32 = 4;

    /// Returns the first and last time used of a log, absolute microseconds; `None` if the skeleton was not
    /// built from it.
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

/// Asset counts of a category.
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
            pages: PageChecksums::default(),
            background: Vec::new(),
            actors: Vec::new(),
            templates: Vec::new(),
        }
    }
}

/// Checksums of the page tables (see [`paged`](crate::cloud::paged)), by the file of their points.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PageChecksums {
    /// Of `background.pages`.
    pub background: Checksum,
    /// Of `actors.pages`.
    pub actors: Checksum,
    /// Of `templates.pages`.
    pub templates: Checksum,
}

/// Returns the checksums of empty tables.
impl Default for PageChecksums {
    fn default() -> Self {
        let empty = Checksum::of::<u8>(&[]);
        Self { background: empty, actors: empty, templates: empty }
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

impl Template {
    /// Checks that size and bounds are within the limits of all files.
    ///
    /// # Errors
    /// Returns an error that names the template; `path` is the manifest.
    pub(super) fn check_limits(&self, path: &Path) -> Result<(), FileError> {
        let of = || format!("template {}", self.kind.name());
        check_size(self.size, of, path)?;
        check_bounds(&self.bounds, of, path)
    }
}

/// Checks a box size, meters. `of` names the cloud.
///
/// # Errors
/// Fails if a side is outside the limits.
pub(super) fn check_size(size: [f64; 3], of: impl Fn() -> String, path: &Path) -> Result<(), FileError> {
    if is_size(DVec3::from(size)) {
        return Ok(());
    }
    let expected = format!("a box with sides of {MIN_SIDE_M} to {MAX_SIDE_M} m");
    Err(FileError::content(expected, format!("{size:?} in {}", of()), path))
}

/// Checks a position, meters. `what` and `of` name it.
///
/// # Errors
/// Fails if a coordinate is beyond the limit.
pub(super) fn check_position(
    what: &str,
    position: [f64; 3],
    of: impl Fn() -> String,
    path: &Path,
) -> Result<(), FileError> {
    if is_position(DVec3::from(position)) {
        return Ok(());
    }
    let expected = format!("{what} within {MAX_COORDINATE_M} m of zero");
    Err(FileError::content(expected, format!("{position:?} in {}", of()), path))
}

fn check_bounds(bounds: &Bounds, of: impl Fn() -> String, path: &Path) -> Result<(), FileError> {
    [bounds.min, bounds.max]
        .into_iter()
        .try_for_each(|corner| check_position("bounds", corner.map(f64::from), &of, path))
}

/// Point counts of a build. Every point read is either dropped for one of the reasons below or retained in
/// background or actors. With [`Coloring::EveryCamera`](super::Coloring::EveryCamera) it is retained once per
/// camera that sees it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct BuildReport {
    /// Points read from sweeps, including those that are not finite.
    pub points_read: usize,
    /// Points with NaN or infinite coordinates, or coordinates beyond [`MAX_COORDINATE_M`].
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forged_coordinates_and_sizes_name_their_cloud() {
        let bounds = Bounds { min: [0.0; 3], max: [1.0; 3] };
        let far = Bounds { max: [3e38; 3], ..bounds };
        let chunk = |origin, bounds| Chunk { origin, points: 1, bounds, xxh3: Checksum::of::<u8>(&[]) };
        let asset = |size, bounds| Asset {
            log: "log".into(),
            track: "car".into(),
            category: "vehicle.car".into(),
            class: Class::MotorVehicle,
            size,
            sweeps: 0,
            points: 1,
            bounds,
            xxh3: Checksum::of::<u8>(&[]),
        };
        let template = |size, bounds| {
            let (kind, class) = (super::super::TemplateKind::Sedan, Class::MotorVehicle);
            Template { kind, class, size, points: 1, bounds, xxh3: Checksum::of::<u8>(&[]) }
        };
        let message =
            |manifest: Manifest| manifest.check(Path::new("skeleton.json")).unwrap_err().to_string();
        let background = |chunk| Manifest { background: vec![chunk], ..Manifest::default() };
        let actors = |asset| Manifest { actors: vec![asset], ..Manifest::default() };
        let templates = |template| Manifest { templates: vec![template], ..Manifest::default() };
        for (manifest, found) in [
            (
                background(chunk([1e9, 0.0, 0.0], bounds)),
                "an origin within 100000000 m of zero, found [1000000000.0",
            ),
            (background(chunk([0.0; 3], far)), "bounds within 100000000 m of zero, found [3"),
            (actors(asset([4.0, 1e308, 1.0], bounds)), "1e308, 1.0] in track \"car\" of log \"log\""),
            (actors(asset([4.0, 2.0, 1.0], far)), "bounds within"),
            (templates(template([0.0, 2.0, 1.0], bounds)), "[0.0, 2.0, 1.0] in template sedan"),
            (templates(template([4.0, 2.0, 1.0], far)), "bounds within"),
        ] {
            let message = message(manifest);
            assert!(message.contains(found) && message.ends_with("skeleton.json"), "{message}");
        }
        let good = Manifest {
            background: vec![chunk([-4e6, 0.0, 0.0], bounds)],
            actors: vec![asset([4.0, 2.0, 1.5], bounds)],
            templates: vec![template([4.0, 2.0, 1.5], bounds)],
            ..Manifest::default()
        };
        good.check(Path::new("skeleton.json")).unwrap();
    }
}
