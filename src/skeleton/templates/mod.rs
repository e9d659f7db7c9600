//! Category templates: clouds that stand in for actors without many points of their own.
//!
//! # How it works
//! [`Instances`] takes the assets of any number of skeletons. They are clustered by category and box size (`cluster`),
//! every cluster gets its kind by the rules that rendering goes by ([`TemplateKind::of_actor`]), and the points of
//! a kind are laid over each other in one box, mirrored, freed of outliers and thinned (`aggregate`, `thin`). The
//! result goes into a skeleton or into a [`TemplateLibrary`] on disk. [`default_templates`] are bodies of the built-in town.

mod aggregate;
mod cluster;
mod defaults;
mod instances;
mod kind;
mod library;
mod options;
mod thin;

pub use defaults::{default_template, default_templates};
pub use instances::Instances;
pub use kind::TemplateKind;
pub use library::{LibraryManifest, LogSource, TemplateLibrary};
pub use options::{ClusterReport, TemplateOptions, TemplateReport, TemplateSummary};

use super::Template;
use crate::cloud::Point;

/// A template with its points.
pub type TemplateCloud = (Template, Vec<Point>);
