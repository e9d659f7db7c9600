use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::Args;
use point_skeleton::error::FileError;
use point_skeleton::scene::Substitutes;
use point_skeleton::skeleton::{
    AugmentOptions, Augmentation, Skeleton, TemplateCloud, TemplateKind, TemplateLibrary, augment,
    default_templates,
};
use rayon::prelude::*;
use serde::Serialize;

use super::numbers;

/// Options of substitute clouds: templates and augmented assets.
#[derive(Clone, Debug, Args)]
pub(super) struct SubstituteArgs {
    /// Folder of `pskel templates`, used for kinds without a template in the skeleton
    #[arg(long, value_name = "DIR")]
    templates: Option<PathBuf>,
    /// Disable the built-in templates of sedan, suv, pickup, pedestrian and bike, which are used for kinds without
    /// another template
    #[arg(long)]
    no_default_templates: bool,
    /// Augment assets as in training: a share of them (--augment-share) is degraded, half of these thinned to 5 to 80
    /// % of their points, half reduced to the points seen by one camera; the choice depends on the seed and the track
    #[arg(long, value_name = "SEED", num_args = 0..=1, require_equals = true, default_missing_value = "0")]
    augment: Option<u64>,
    /// Share of the assets that --augment degrades
    #[arg(long, value_name = "SHARE", value_parser = numbers::share, requires = "augment")]
    #[arg(allow_negative_numbers = true, default_value_t = AugmentOptions::default().share)]
    augment_share: f64,
}

/// Substitute clouds in use, for `index.json`.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct StandInReport {
    /// Origin of each kind's template.
    templates: BTreeMap<&'static str, Origin>,
    /// `None` for unchanged assets.
    augment: Option<AugmentReport>,
}

#[derive(Clone, Copy, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
enum Origin {
    Skeleton,
    Library,
    Default,
}

#[derive(Clone, Debug, Serialize)]
struct AugmentReport {
    #[serde(flatten)]
    options: AugmentOptions,
    /// Augmentation by track.
    assets: BTreeMap<String, Augmentation>,
}

impl SubstituteArgs {
    /// Creates options with only the built-in templates, and with augmented assets if a seed is given.
    pub(super) fn augmented(seed: Option<u64>) -> Self {
        let augment_share = AugmentOptions::default().share;
        Self { templates: None, no_default_templates: false, augment: seed, augment_share }
    }

    /// Reads templates, augments assets, and returns both with a report.
    pub(super) fn make(
        &self,
        skeleton: &Skeleton,
        log: &str,
    ) -> Result<(Substitutes, StandInReport), FileError> {
        let mut origins: BTreeMap<TemplateKind, Origin> =
            skeleton.manifest.templates.iter().map(|t| (t.kind, Origin::Skeleton)).collect();
        let library = self.templates.as_deref().map(TemplateLibrary::open).transpose()?;
        let mut stand_ins = Substitutes::default();
        let mut add = |origin: Origin, cloud: TemplateCloud| {
            origins.entry(cloud.0.kind).or_insert_with(|| {
                stand_ins.templates.push(cloud);
                origin
            });
        };
        library.unwrap_or_default().clouds.into_iter().for_each(|cloud| add(Origin::Library, cloud));
        if !self.no_default_templates {
            default_templates().into_iter().for_each(|cloud| add(Origin::Default, cloud));
        }
        let templates = origins.iter().map(|(kind, origin)| (kind.name(), *origin)).collect();
        let augment =
            self.augment.map(|seed| self.augment(seed, skeleton, log, &mut stand_ins)).transpose()?;
        Ok((stand_ins, StandInReport { templates, augment }))
    }

    fn augment(
        &self,
        seed: u64,
        skeleton: &Skeleton,
        log: &str,
        stand_ins: &mut Substitutes,
    ) -> Result<AugmentReport, FileError> {
        let options = AugmentOptions { seed, share: self.augment_share, ..AugmentOptions::default() };
        let all = skeleton.manifest.actors.iter().zip(skeleton.actors()?);
        let assets: Vec<_> = all.filter(|(asset, _)| asset.log == log).collect();
        let made: Vec<_> =
            assets.par_iter().map(|(asset, points)| augment(points, &asset.track, &options)).collect();
        let mut done = BTreeMap::new();
        for ((asset, _), (points, how)) in assets.iter().zip(made) {
            done.insert(asset.track.clone(), how);
            if how != Augmentation::None {
                stand_ins.assets.insert(asset.track.clone(), points);
            }
        }
        Ok(AugmentReport { options, assets: done })
    }
}
