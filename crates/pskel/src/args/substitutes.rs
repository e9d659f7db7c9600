use std::path::{Path, PathBuf};

use clap::Args;
use point_skeleton::scene::SubstituteOptions;
use point_skeleton::skeleton::AugmentOptions;

/// Options of substitute clouds: templates and augmented assets.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Templates and augmentation")]
pub(crate) struct SubstituteArgs {
    /// Folder of `pskel templates`, used for kinds without a template in the skeleton
    #[arg(long, value_name = "DIR")]
    templates: Option<PathBuf>,
    /// Disable the built-in templates of sedan, suv, pickup, pedestrian and bike, which are used for kinds
    /// without another template
    #[arg(long)]
    no_default_templates: bool,
    /// Augment assets as in training: a share of them is degraded, half of these thinned to 5 to 80 % of
    /// their points, half reduced to the points seen by one camera; the choice depends on the seed and the
    /// track. SEED is 0 by default, share 0.8; with color_only, only color shows the degraded assets
    #[arg(long, value_name = "SEED,share=S,color_only", num_args = 0..=1, require_equals = true)]
    #[arg(default_missing_value = "")]
    augment: Option<AugmentOptions>,
}

impl SubstituteArgs {
    /// Returns the folders that are read.
    pub(crate) fn inputs(&self) -> impl Iterator<Item = &Path> {
        self.templates.as_deref().into_iter()
    }

    /// Returns the options of the library.
    pub(crate) fn options(&self) -> SubstituteOptions {
        SubstituteOptions {
            library: self.templates.clone(),
            use_default: !self.no_default_templates,
            augment: self.augment,
            ..SubstituteOptions::default()
        }
    }
}
