//! Category templates: substitute clouds for actors with few points of their own.
//!
//! # How it works
//! [`Instances`] collects the assets of any number of skeletons. `cluster` groups them by category and box
//! size. Each cluster gets its kind by the rules that rendering uses ([`TemplateKind::of_actor`]).
//! `aggregate` and `thin` superimpose the points of a kind in one box, mirror them, remove outliers and thin
//! them. The result is written to a skeleton or to a [`TemplateLibrary`] on disk. [`default_templates`] are
//! built in.

mod aggregate;
mod cluster;
mod defaults;
mod file;
mod instance;
mod instances;
mod kind;
mod library;
mod options;
mod sources;
mod thin;

pub use defaults::default_templates;
pub use file::read_template;
pub use instances::Instances;
pub use kind::TemplateKind;
pub use library::{LibraryManifest, LogSource, TemplateLibrary};
pub use options::{ClusterReport, TemplateOptions, TemplateReport, TemplateSummary};
pub use sources::TemplateSources;
pub use thin::poisson_thin;

use super::Template;
use crate::cloud::Point;

/// Template with its points.
pub type TemplateCloud = (Template, Vec<Point>);
