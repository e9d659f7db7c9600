use std::collections::BTreeMap;

use glam::DVec3;
use rayon::prelude::*;

use super::aggregate::{aggregate, cluster_report};
use super::cluster::{Cluster, clusters};
use super::instance::Instance;
use super::kind::Family;
use super::{LogSource, TemplateCloud, TemplateKind, TemplateOptions, TemplateReport};
use crate::cloud::Point;
use crate::error::FileError;
use crate::skeleton::{Asset, Skeleton, Source};

/// Assets of any number of skeletons, the input of template generation.
#[derive(Clone, Debug, Default)]
pub struct Instances {
    instances: Vec<Instance>,
    notes: BTreeMap<String, usize>,
    options: TemplateOptions,
}

impl Instances {
    /// Creates an empty collection.
    pub fn new(options: TemplateOptions) -> Self {
        Self { options, ..Self::default() }
    }

    /// Adds assets, each with its points in box coordinates (meters). Unusable assets are counted by reason.
    pub fn add(&mut self, assets: &[(&Asset, &[Point])]) {
        let taken: Vec<Result<Instance, &str>> =
            assets.par_iter().map(|(asset, points)| Instance::new(asset, points, &self.options)).collect();
        for result in taken {
            match result {
                Ok(instance) => self.instances.push(instance),
                Err(reason) => *self.notes.entry(reason.to_owned()).or_default() += 1,
            }
        }
    }

    /// Adds all assets of a skeleton, and returns its source logs.
    ///
    /// # Errors
    /// Fails if points of the skeleton do not match their checksum.
    pub fn add_skeleton(&mut self, skeleton: &Skeleton) -> Result<Vec<LogSource>, FileError> {
        let manifest = &skeleton.manifest;
        let assets: Vec<_> = manifest.actors.iter().zip(skeleton.actors()?).collect();
        self.add(&assets);
        let count = |source: &Source| assets.iter().filter(|(asset, _)| asset.log == source.log).count();
        let source = |source: &Source| LogSource { source: source.clone(), actors: count(source) };
        Ok(manifest.sources.iter().map(source).collect())
    }

    /// Generates a template of every kind with enough points, in the order of kinds. The result depends only
    /// on the assets, their order and the options.
    pub fn templates(&self) -> (Vec<TemplateCloud>, TemplateReport) {
        let actors: Vec<(Family, DVec3)> = self.instances.iter().map(|i| (i.family, i.size_m)).collect();
        let mut kinds: BTreeMap<TemplateKind, Vec<Cluster>> = BTreeMap::new();
        for cluster in clusters(&actors, &self.options) {
            kinds.entry(cluster.kind).or_default().push(cluster);
        }
        let mut report = TemplateReport { notes: self.notes.clone(), ..TemplateReport::default() };
        let mut templates = Vec::new();
        for (kind, mut clusters) in kinds {
            let others =
                if kind.replaces_small_assets() { Vec::new() } else { self.split_off_main(&mut clusters) };
            let (mut summary, cloud) = aggregate(kind, &clusters, &self.instances, &self.options);
            for other in &others {
                summary.clusters.push(cluster_report(other, &self.instances, false));
                let reason = format!("actors of another size than the template of {}", kind.name());
                *report.notes.entry(reason).or_default() += other.members.len();
            }
            match cloud {
                Some(cloud) => templates.push(cloud),
                None => {
                    summary.points = 0;
                    let reason = format!("{} templates with too few points", kind.name());
                    *report.notes.entry(reason).or_default() += 1;
                }
            }
            report.templates.push(summary);
        }
        (templates, report)
    }

    /// Retains only the main cluster and returns the others. The main cluster has the most actors, or of
    /// equal ones the most points. Clusters with enough points for a template take precedence.
    fn split_off_main(&self, clusters: &mut Vec<Cluster>) -> Vec<Cluster> {
        let points = |c: &Cluster| c.members.iter().map(|i| self.instances[*i].points.len()).sum::<usize>();
        let rank = |c: &Cluster| (points(c) >= self.options.min_points, c.members.len(), points(c));
        clusters.sort_by_key(|c| std::cmp::Reverse(rank(c)));
        clusters.split_off(clusters.len().min(1))
    }
}
