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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::Class;
    use crate::error::FileError;
    use crate::geometry::{Cuboid, Pose};
    use crate::skeleton::{Asset, BuildOptions, BuildReport, Chunk, SkeletonWriter, Template};

    fn cube(count: usize) -> (Vec<Point>, Bounds) {
        let corner = |i: usize| [0.0, 1.0, 2.0].map(|_: f32| if i.is_multiple_of(2) { -1.0 } else { 1.0 });
        let points: Vec<Point> = (0..count).map(|i| Point::new(corner(i), [9; 3], 1)).collect();
        let bounds = Bounds::of(&points).unwrap();
        (points, bounds)
    }

    /// Background of one chunk; car "big" with 30 points, car "small" with 10, truck "truck" with 10; a template of
    /// sedans and one of pedestrians.
    fn skeleton(folder: &std::path::Path) -> Skeleton {
        let asset = |track: &str, category: &str, count: usize| {
            let (points, bounds) = cube(count);
            let class = Class::from_category(category);
            let (log, track, category) = ("log".to_owned(), track.to_owned(), category.to_owned());
            (Asset { log, track, category, class, size: [2.0; 3], sweeps: 1, points: count, bounds }, points)
        };
        let template = |kind: TemplateKind| {
            let (points, bounds) = cube(4);
            (Template { kind, class: kind.class(), size: [2.0; 3], points: 4, bounds }, points)
        };
        let assets =
            [("big", "vehicle.car", 30), ("small", "vehicle.car", 10), ("truck", "vehicle.truck", 10)];
        SkeletonWriter::write::<FileError>(folder, |writer| {
            let (points, bounds) = cube(2);
            writer.chunk(Chunk { origin: [100.0, 200.0, 0.0], points: 2, bounds }, &points)?;
            for (track, category, count) in assets {
                let (asset, points) = asset(track, category, count);
                writer.actor(asset, &points)?;
            }
            for (template, points) in [template(TemplateKind::Sedan), template(TemplateKind::Pedestrian)] {
                writer.template(template, &points)?;
            }
            writer.finish(Vec::new(), BuildOptions::default(), BuildReport::default())
        })
        .unwrap();
        Skeleton::open(folder).unwrap()
    }

    fn actor(track: &str, category: &str) -> ActorState {
        let cuboid = Cuboid::new(Pose::from_yaw(0.0, DVec3::new(5.0, 0.0, 0.0)), DVec3::new(4.0, 2.0, 1.5));
        let (track, category) = (track.to_owned(), category.to_owned());
        ActorState { track, class: Class::from_category(&category), category, cuboid: cuboid.unwrap() }
    }

    /// Ids of the clouds that show one actor: color, geometry. 0 background, 1 to 3 assets, 4 and 5 templates.
    fn shown(stage: &Stage<'_>, actor: ActorState, options: &SelectionOptions) -> [Option<usize>; 2] {
        let (color, geometry) = stage.actor_instances(&actor, 1, options);
        [color, geometry].map(|instance| instance.map(|i| i.cloud))
    }

    #[test]
    fn the_table_of_two_clouds() {
        let folder = tempfile::tempdir().unwrap();
        let skeleton = skeleton(&folder.path().join("s"));
        let stage = Stage::new(&skeleton);
        let options = SelectionOptions { min_actor_points: 20, template_fit: TemplateFit::Box };
        let shown = |track: &str, category: &str| shown(&stage, actor(track, category), &options);
        assert_eq!(shown("big", "vehicle.car"), [Some(1), Some(1)]);
        assert_eq!(shown("small", "vehicle.car"), [Some(2), Some(4)]);
        assert_eq!(shown("new", "vehicle.car"), [None, Some(4)]);
        assert_eq!(shown("new", "human.pedestrian.adult"), [None, Some(5)]);
        assert_eq!(shown("truck", "vehicle.truck"), [Some(3), Some(3)]);
        assert_eq!(shown("new", "vehicle.truck"), [None, None]);
        assert_eq!(shown("new", "movable_object.barrier"), [None, None]);
    }

    #[test]
    fn a_template_fills_the_box() {
        let folder = tempfile::tempdir().unwrap();
        let skeleton = skeleton(&folder.path().join("s"));
        let stage = Stage::new(&skeleton);
        let corner = |template_fit| {
            let options = SelectionOptions { template_fit, ..SelectionOptions::default() };
            let (_, geometry) = stage.actor_instances(&actor("new", "vehicle.car"), 1, &options);
            geometry.unwrap().world_from_local.transform_point3(DVec3::ONE)
        };
        assert!((corner(TemplateFit::Box) - DVec3::new(7.0, 1.0, 0.75)).length() < 1e-12);
        assert!((corner(TemplateFit::None) - DVec3::new(6.0, 1.0, 1.0)).length() < 1e-12);
    }

    #[test]
    fn numbers_follow_the_actor_list() {
        let folder = tempfile::tempdir().unwrap();
        let skeleton = skeleton(&folder.path().join("s"));
        let state = SceneState {
            name: "000000".into(),
            t_us: 0,
            global_from_ego: Pose::IDENTITY,
            cameras: Vec::new(),
            actors: vec![
                actor("big", "vehicle.car"),
                actor("new", "vehicle.car"),
                actor("small", "vehicle.car"),
            ],
            map: None,
        };
        let options = SelectionOptions { min_actor_points: 20, ..SelectionOptions::default() };
        let both = Stage::new(&skeleton).instances(&state, &options);
        let list = |instances: &[Instance]| instances.iter().map(|i| (i.cloud, i.number)).collect::<Vec<_>>();
        assert_eq!(list(&both.color), [(0, 0), (1, 1), (2, 3)]);
        assert_eq!(list(&both.geometry), [(0, 0), (1, 1), (4, 2), (4, 3)]);
        assert_eq!(both.color[0].world_from_local.translation, DVec3::new(100.0, 200.0, 0.0));
        assert_eq!(Stage::clouds(&skeleton).len(), 6);
    }
}
