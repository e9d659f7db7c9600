use std::collections::BTreeMap;

use glam::{DAffine3, DVec3};
use serde::{Deserialize, Serialize};

use super::{ActorState, SceneState};
use crate::cloud::Bounds;
use crate::cloud::Point;
use crate::raster::{CloudSet, Instance};
use crate::skeleton::{Skeleton, TemplateKind};

/// How a template is placed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum TemplateFit {
    /// Scaled along each axis to the actor's box.
    #[default]
    Box,
    /// As it is.
    None,
}

/// Which cloud stands in for an actor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SelectionOptions {
    /// Assets of more points than this serve as geometry; smaller ones give way to the category's template.
    pub min_actor_points: usize,
    /// How templates are placed.
    pub template_fit: TemplateFit,
}

impl Default for SelectionOptions {
    fn default() -> Self {
        Self { min_actor_points: 20_000, template_fit: TemplateFit::Box }
    }
}

/// The two clouds of a step, as instances: background first (number 0), then actors (number = index + 1).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneInstances {
    /// What the color map shows.
    pub color: Vec<Instance>,
    /// What depth, class and instance maps show.
    pub geometry: Vec<Instance>,
}

/// Knows a skeleton's clouds by their ids in the rasterizer.
pub struct Stage<'a> {
    skeleton: &'a Skeleton,
    /// Asset by track id.
    assets: BTreeMap<&'a str, usize>,
    templates: BTreeMap<TemplateKind, usize>,
}

impl<'a> Stage<'a> {
    /// Of a skeleton.
    pub fn new(skeleton: &'a Skeleton) -> Self {
        let manifest = &skeleton.manifest;
        let assets = manifest.actors.iter().enumerate().map(|(i, a)| (a.track.as_str(), i)).collect();
        let templates = manifest.templates.iter().enumerate().map(|(i, t)| (t.kind, i)).collect();
        Self { skeleton, assets, templates }
    }

    /// All clouds for a rasterizer: background chunks, then assets, then templates.
    pub fn clouds(skeleton: &'a Skeleton) -> CloudSet<'a> {
        let mut clouds: Vec<&[Point]> = skeleton.background();
        clouds.extend(skeleton.actors());
        clouds.extend(skeleton.templates());
        clouds
    }

    /// Which clouds stand where in a step.
    pub fn instances(&self, state: &SceneState, options: &SelectionOptions) -> SceneInstances {
        let chunks = self.skeleton.manifest.background.iter().enumerate();
        let background: Vec<Instance> = chunks
            .map(|(cloud, chunk)| {
                let world_from_local = DAffine3::from_translation(DVec3::from(chunk.origin));
                Instance { cloud, world_from_local, number: 0 }
            })
            .collect();
        let mut both = SceneInstances { color: background.clone(), geometry: background };
        for (index, actor) in state.actors.iter().enumerate() {
            let (color, geometry) = self.actor_instances(actor, index as u32 + 1, options);
            both.color.extend(color);
            both.geometry.extend(geometry);
        }
        both
    }

    /// The table "two clouds" of the condition contract, for one actor.
    fn actor_instances(
        &self,
        actor: &ActorState,
        number: u32,
        options: &SelectionOptions,
    ) -> (Option<Instance>, Option<Instance>) {
        let manifest = &self.skeleton.manifest;
        let first_asset = manifest.background.len();
        let first_template = first_asset + manifest.actors.len();
        let asset = self.assets.get(actor.track.as_str()).copied();
        let kind = TemplateKind::of_actor(&actor.category, actor.cuboid.size.z);
        let template = kind.and_then(|kind| self.templates.get(&kind)).copied();
        let pose = actor.cuboid.pose.affine();
        let of_asset = asset.map(|i| Instance { cloud: first_asset + i, world_from_local: pose, number });
        let of_template = template.map(|i| {
            let fit = fit(options.template_fit, &manifest.templates[i].bounds, actor.cuboid.size);
            Instance { cloud: first_template + i, world_from_local: pose * fit, number }
        });
        let enough = asset.is_some_and(|i| manifest.actors[i].points > options.min_actor_points);
        let geometry = if enough || of_template.is_none() { of_asset } else { of_template };
        (of_asset, geometry)
    }
}

/// `box_from_template`: scales a template's bounds to a box of `size` (metres) about their common centre.
fn fit(how: TemplateFit, bounds: &Bounds, size: DVec3) -> DAffine3 {
    if how == TemplateFit::None {
        return DAffine3::IDENTITY;
    }
    let (min, max) = (DVec3::from(bounds.min.map(f64::from)), DVec3::from(bounds.max.map(f64::from)));
    let extent = (max - min).max(DVec3::splat(1e-3));
    let scale = size / extent;
    DAffine3::from_scale(scale) * DAffine3::from_translation(-(min + max) / 2.0)
}
