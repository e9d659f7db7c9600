use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::LazyLock;

use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;

use crate::cloud::{self, Point};
use crate::dataset::{Appearance, Class, Recording, Track};
use crate::error::FileError;
use crate::files::Checksum;
use crate::skeleton::{
    AugmentOptions, Augmentation, Skeleton, TemplateCloud, TemplateKind, TemplateLibrary, augment,
    default_templates,
};

/// Substitute clouds that supplement or replace a skeleton's own.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Substitutes {
    /// Templates of kinds that the skeleton lacks. If a kind occurs several times, the first is used.
    pub templates: Vec<TemplateCloud>,
    /// Points that replace an asset's, by track.
    pub assets: BTreeMap<String, Vec<Point>>,
    /// Points that replace an asset's in color maps only, by track.
    pub color_assets: BTreeMap<String, Vec<Point>>,
}

/// Options of substitute clouds: templates and augmented assets.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SubstituteOptions {
    /// Folder of a template library, used for kinds without a template in the skeleton.
    pub library: Option<PathBuf>,
    /// Whether the built-in templates are used for the kinds that then lack one.
    pub use_default: bool,
    /// Degradation of assets; `None` for unchanged assets.
    pub augment: Option<AugmentOptions>,
    /// Classes of edited tracks, and what they look like; only those with points of files are used.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub looks: BTreeMap<String, (Class, Appearance)>,
}

/// Substitute clouds in use, for `index.json`.
#[derive(Clone, Debug, Default, Serialize)]
pub struct SubstituteReport {
    /// Origin of each kind's template.
    pub templates: BTreeMap<&'static str, TemplateOrigin>,
    /// Fingerprint of the template library; `None` without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub library: Option<String>,
    /// `None` for unchanged assets.
    pub augment: Option<AugmentReport>,
    /// Checksums of point files, by track.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub looks: BTreeMap<String, Checksum>,
}

/// Origin of a template.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum TemplateOrigin {
    /// The skeleton.
    Skeleton,
    /// The template library.
    Library,
    /// The built-in templates.
    Default,
}

/// Degradation of a log's assets.
#[derive(Clone, Debug, Serialize)]
pub struct AugmentReport {
    /// Seed and ranges.
    #[serde(flatten)]
    pub options: AugmentOptions,
    /// Augmentation by track.
    pub assets: BTreeMap<String, Augmentation>,
}

impl Substitutes {
    /// No substitutes: only the skeleton's own clouds.
    pub const NONE: Self =
        Self { templates: Vec::new(), assets: BTreeMap::new(), color_assets: BTreeMap::new() };

    /// Returns the built-in templates, for kinds that the skeleton lacks.
    pub fn built_in() -> &'static Self {
        static BUILT_IN: LazyLock<Substitutes> =
            LazyLock::new(|| Substitutes { templates: default_templates(), ..Substitutes::NONE });
        &BUILT_IN
    }

    /// Replaces the degraded assets of a log, and returns the degradation of all its assets.
    fn augment(
        &mut self,
        skeleton: &Skeleton,
        log: &str,
        options: AugmentOptions,
    ) -> Result<AugmentReport, FileError> {
        let all = skeleton.manifest.actors.iter().zip(skeleton.actors()?);
        let assets: Vec<_> = all.filter(|(asset, _)| asset.log == log).collect();
        let augmented: Vec<_> =
            assets.par_iter().map(|(asset, points)| augment(points, &asset.track, &options)).collect();
        let mut report = AugmentReport { options, assets: BTreeMap::new() };
        for ((asset, _), (points, augmentation)) in assets.iter().zip(augmented) {
            report.assets.insert(asset.track.clone(), augmentation);
            if augmentation != Augmentation::None {
                let replaced = if options.color_only { &mut self.color_assets } else { &mut self.assets };
                replaced.insert(asset.track.clone(), points);
            }
        }
        Ok(report)
    }
}

impl Default for SubstituteOptions {
    /// Built-in templates and unchanged assets.
    fn default() -> Self {
        Self { library: None, use_default: true, augment: None, looks: BTreeMap::new() }
    }
}

impl SubstituteOptions {
    /// Creates the options with built-in templates, and with assets degraded by a seed.
    pub fn augmented(seed: Option<u64>) -> Self {
        let augment = seed.map(|seed| AugmentOptions { seed, ..AugmentOptions::default() });
        Self { augment, ..Self::default() }
    }

    /// Returns the options with the points of files that a log's edits name.
    #[must_use]
    pub fn for_log(self, log: &Recording) -> Self {
        let look = |track: &Track| {
            let appearance = log.edits.replace.get(&track.id)?.clone();
            Some((track.id.clone(), (track.class, appearance)))
        };
        Self { looks: log.tracks.iter().filter_map(look).collect(), ..self }
    }

    /// Returns the fingerprint of the template library, see [`TemplateLibrary::fingerprint_at`]; `None`
    /// without one.
    ///
    /// # Errors
    /// Fails if it cannot be read.
    pub fn fingerprint(&self) -> Result<Option<String>, FileError> {
        self.library.as_deref().map(TemplateLibrary::fingerprint_at).transpose()
    }

    /// Reads templates, degrades the assets of a log, and returns both with a report.
    ///
    /// # Errors
    /// Fails if the template library cannot be read, or if points of the skeleton do not match their
    /// checksum.
    pub fn make(&self, skeleton: &Skeleton, log: &str) -> Result<(Substitutes, SubstituteReport), FileError> {
        let own = skeleton.manifest.templates.iter().map(|t| (t.kind, TemplateOrigin::Skeleton));
        let mut origins: BTreeMap<TemplateKind, TemplateOrigin> = own.collect();
        let library = self.library.as_deref().map(TemplateLibrary::open).transpose()?.unwrap_or_default();
        let defaults = if self.use_default { default_templates() } else { Vec::new() };
        let library = library.clouds.into_iter().map(|cloud| (TemplateOrigin::Library, cloud));
        let mut substitutes = Substitutes::default();
        for (origin, cloud) in library.chain(defaults.into_iter().map(|c| (TemplateOrigin::Default, c))) {
            origins.entry(cloud.0.kind).or_insert_with(|| {
                substitutes.templates.push(cloud);
                origin
            });
        }
        let templates = origins.iter().map(|(kind, origin)| (kind.name(), *origin)).collect();
        let augment = self.augment.map(|options| substitutes.augment(skeleton, log, options)).transpose()?;
        let mut looks = BTreeMap::new();
        for (track, (class, appearance)) in &self.looks {
            if let Some(points) = points_of(appearance)? {
                let classed = |point: &Point| Point::new(point.position, point.rgb(), *class as u8);
                let points: Vec<Point> = points.iter().map(classed).collect();
                looks.insert(track.clone(), Checksum::of(&points));
                substitutes.assets.insert(track.clone(), points);
            }
        }
        Ok((substitutes, SubstituteReport { templates, library: self.fingerprint()?, augment, looks }))
    }
}

/// Returns the points of a file that an actor looks like; `None` if there is no file.
///
/// # Errors
/// Fails if the file cannot be read, has no point that can be drawn, or lacks the track.
fn points_of(appearance: &Appearance) -> Result<Option<Vec<Point>>, FileError> {
    match appearance {
        Appearance::Track(_) | Appearance::Template => Ok(None),
        Appearance::File(path) => {
            let file = cloud::read(path)?;
            let expected = "points in the frame of a box, near its center";
            if file.origin != DVec3::ZERO {
                return Err(FileError::content(expected, format!("points around {}", file.origin), path));
            }
            let points: Vec<Point> = file.points.into_iter().filter(Point::is_finite).collect();
            if points.is_empty() { Err(FileError::content(expected, "none", path)) } else { Ok(Some(points)) }
        }
        Appearance::Skeleton { skeleton: path, track } => {
            let skeleton = Skeleton::open(path)?;
            let mut assets = skeleton.manifest.actors.iter().zip(skeleton.actors()?);
            let found = assets.find(|(asset, points)| asset.track == *track && !points.is_empty());
            let missing = || FileError::content(format!("an asset of track {track}"), "none", path);
            Ok(Some(found.ok_or_else(missing)?.1.to_vec()))
        }
    }
}
