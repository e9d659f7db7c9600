use std::path::{Path, PathBuf};

use clap::Args;
use point_skeleton::scene::SubstituteOptions;
use point_skeleton::skeleton::AugmentOptions;

use super::numbers;

/// Options of substitute clouds: templates and augmented assets.
#[derive(Clone, Debug, Args)]
pub(crate) struct SubstituteArgs {
    /// Folder of `pskel templates`, used for kinds without a template in the skeleton
    #[arg(long, value_name = "DIR")]
    templates: Option<PathBuf>,
    /// Disable the built-in templates of sedan, suv, pickup, pedestrian and bike, which are used for kinds
    /// without another template
    #[arg(long)]
    no_default_templates: bool,
    /// Augment assets as in training: a share of them (--augment-share) is degraded, half of these thinned to
    /// 5 to 80 % of their points, half reduced to the points seen by one camera; the choice depends on the
    /// seed and the track
    #[arg(long, value_name = "SEED", num_args = 0..=1, require_equals = true, default_missing_value = "0")]
    augment: Option<u64>,
    /// Share of the assets that --augment degrades
    #[arg(long, value_name = "SHARE", value_parser = numbers::share, requires = "augment")]
    #[arg(allow_negative_numbers = true, default_value_t = AugmentOptions::default().share)]
    augment_share: f64,
    /// With --augment, leave all maps but color unchanged
    #[arg(long, requires = "augment")]
    augment_color_only: bool,
}

impl SubstituteArgs {
    /// Returns the folders that are read.
    pub(crate) fn inputs(&self) -> impl Iterator<Item = &Path> {
        self.templates.as_deref().into_iter()
    }

    /// Returns the options of the library.
    pub(crate) fn options(&self) -> SubstituteOptions {
        let augment = |seed| AugmentOptions {
            seed,
            share: self.augment_share,
            color_only: self.augment_color_only,
            ..AugmentOptions::default()
        };
        SubstituteOptions {
            library: self.templates.clone(),
            use_default: !self.no_default_templates,
            augment: self.augment.map(augment),
        }
    }
}
