use std::collections::BTreeMap;

use glam::{DAffine3, DVec3};
use serde::Serialize;

use super::from_log::actors;
use super::{ActorState, SceneState, Substitutes};
use crate::dataset::{Recording, TrackBox};
use crate::raster::{CloudSet, Instance};
use crate::skeleton::{Skeleton, TemplateKind};
use crate::{named, named_in_files};

/// How a template is fitted to an actor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TemplateFit {
    /// Scales the template along each axis to the actor's box.
    #[default]
    Box,
    /// Leaves the template at its own size.
    None,
}

named!(TemplateFit, "template fit" {
    Box => "box", "Scales the template along each axis to the actor's box";
    None => "none", "Leaves the template at its own size";
});
named_in_files!(TemplateFit);

/// Options for the choice of the cloud that represents an actor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SelectionOptions {
    /// Assets with more points than this are used as geometry; the category's template replaces smaller ones.
    pub min_actor_points: usize,
    /// How templates are fitted.
    pub template_fit: TemplateFit,
}

impl Default for SelectionOptions {
    fn default() -> Self {
        Self { min_actor_points: 20_000, template_fit: TemplateFit::Box }
    }
}

/// Color and geometry clouds of a step, as instances: background first (number 0), then actors (number =
/// index + 1).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneInstances {
    /// Shown in the color map.
    pub color: Vec<Instance>,
    /// Shown in depth, class and instance maps.
    pub geometry: Vec<Instance>,
}

/// Scene clouds: a skeleton's clouds and their substitutes, with their ids in the rasterizer.
pub struct SceneClouds<'a> {
    skeleton: &'a Skeleton,
    /// All clouds: background chunks, assets, templates, then substitutes.
    clouds: CloudSet<'a>,
    /// Cloud id of each asset, by track id.
    assets: BTreeMap<&'a str, usize>,
    /// Cloud id of each asset that color maps have instead, by track id.
    color_assets: BTreeMap<&'a str, usize>,
    /// Cloud id and box size (meters), by kind.
    templates: BTreeMap<TemplateKind, (usize, DVec3)>,
    /// Whether geometry shows the color cloud.
    is_one_cloud: bool,
}

impl<'a> SceneClouds<'a> {
    /// Creates the scene clouds of a skeleton for one of its source logs, without substitutes.
    pub fn new(skeleton: &'a Skeleton, log: &str) -> Self {
        static NONE: Substitutes = Substitutes::NONE;
        Self::with(skeleton, log, &NONE)
    }

    /// Creates the scene clouds of a skeleton for one of its source logs, with substitutes.
    pub fn with(skeleton: &'a Skeleton, log: &str, substitutes: &'a Substitutes) -> Self {
        let manifest = &skeleton.manifest;
        let mut clouds = skeleton.clouds();
        let first_asset = manifest.background.len();
        let first_template = first_asset + manifest.actors.len();
        let mut assets = BTreeMap::new();
        for (cloud, asset) in (first_asset..).zip(&manifest.actors).filter(|(_, asset)| asset.log == log) {
            assets.insert(asset.track.as_str(), cloud);
            if let Some(points) = substitutes.assets.get(&asset.track) {
                clouds[cloud] = points.into();
            }
        }
        let own = (first_template..).zip(&manifest.templates);
        let mut templates: BTreeMap<TemplateKind, (usize, DVec3)> =
            own.map(|(cloud, t)| (t.kind, (cloud, DVec3::from(t.size)))).collect();
        for (template, points) in &substitutes.templates {
            templates.entry(template.kind).or_insert_with(|| {
                clouds.push(points.into());
                (clouds.len() - 1, DVec3::from(template.size))
            });
        }
        for (track, points) in &substitutes.assets {
            assets.entry(track.as_str()).or_insert_with(|| {
                clouds.push(points.into());
                clouds.len() - 1
            });
        }
        let mut color_assets = BTreeMap::new();
        for track in assets.keys() {
            if let Some(points) = substitutes.color_assets.get(*track) {
                color_assets.insert(*track, clouds.len());
                clouds.push(points.into());
            }
        }
        Self { skeleton, clouds, assets, color_assets, templates, is_one_cloud: false }
    }

    /// Returns scene clouds whose geometry is the color cloud.
    #[must_use]
    pub fn of_color(self) -> Self {
        Self { is_one_cloud: true, ..self }
    }

    /// Returns all clouds for a rasterizer, substitutes included.
    pub fn cloud_set(&self) -> CloudSet<'a> {
        self.clouds.clone()
    }

    /// Returns the instances (cloud and pose) of all clouds shown in a step.
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
            both.geometry.extend(if self.is_one_cloud { color } else { geometry });
        }
        both
    }

    /// Returns the tracks of a log that no cloud shows in geometry maps, by their first boxes: the skeleton
    /// has no points of them, and there is no template of their category.
    pub fn boxes_alone<'l>(&self, log: &'l Recording, options: &SelectionOptions) -> Vec<&'l str> {
        let mut is_known = vec![false; log.tracks.len()];
        let mut alone = Vec::new();
        for frame in &log.frames {
            let mut is_new = |item: &&TrackBox| !std::mem::replace(&mut is_known[item.track], true);
            let boxes: Vec<TrackBox> = frame.boxes.iter().filter(&mut is_new).copied().collect();
            for (item, actor) in boxes.iter().zip(actors(log, frame.t_us, &boxes)) {
                if self.actor_instances(&actor, 1, options).1.is_none() {
                    alone.push(log.tracks[item.track].id.as_str());
                }
            }
        }
        alone.sort_unstable();
        alone
    }

    /// Selects the color and geometry clouds of one actor: the table "two clouds" of the condition contract.
    fn actor_instances(
        &self,
        actor: &ActorState,
        number: u32,
        options: &SelectionOptions,
    ) -> (Option<Instance>, Option<Instance>) {
        let size_m = actor.cuboid.size;
        let kind = TemplateKind::of_actor(&actor.category, size_m);
        let template = kind.and_then(|kind| self.templates.get(&kind));
        // An asset that was observed in no frame of the skeleton can exist without points.
        let asset = actor.asset().and_then(|track| self.assets.get(track));
        let asset = asset.filter(|cloud| !self.clouds[**cloud].is_empty());
        let pose = actor.cuboid.pose.affine();
        let of_asset = asset.map(|cloud| Instance { cloud: *cloud, world_from_local: pose, number });
        let of_template = template.map(|(cloud, template_size_m)| {
            let fit = fit(options.template_fit, *template_size_m, size_m);
            Instance { cloud: *cloud, world_from_local: pose * fit, number }
        });
        let few = asset.is_none_or(|cloud| self.clouds[*cloud].len() <= options.min_actor_points);
        let gives_way = few && kind.is_some_and(TemplateKind::replaces_small_assets);
        let geometry = if gives_way { of_template.or(of_asset) } else { of_asset.or(of_template) };
        let color = actor.asset().and_then(|track| self.color_assets.get(track));
        let color = color.map(|cloud| Instance { cloud: *cloud, world_from_local: pose, number });
        (color.or(of_asset), geometry)
    }
}

/// Returns `box_from_template`, which scales a template's box to an actor's about their common center,
/// meters.
fn fit(how: TemplateFit, template_size_m: DVec3, size_m: DVec3) -> DAffine3 {
    match how {
        TemplateFit::Box => DAffine3::from_scale(size_m / template_size_m.max(DVec3::splat(1e-3))),
        TemplateFit::None => DAffine3::IDENTITY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::{Bounds, Point};
    use crate::dataset::Class;
    use crate::error::FileError;
    use crate::files::Checksum;
    use crate::geometry::{Cuboid, Pose};
    use crate::skeleton::{Asset, BuildOptions, BuildReport, Chunk, SkeletonWriter, Template, TemplateCloud};

    fn cube(count: usize) -> (Vec<Point>, Bounds) {
        let corner = |i: usize| [0.0, 1.0, 2.0].map(|_: f32| if i.is_multiple_of(2) { -1.0 } else { 1.0 });
        let points: Vec<Point> = (0..count).map(|i| Point::new(corner(i), [9; 3], 1)).collect();
        let bounds = Bounds::of(&points).unwrap();
        (points, bounds)
    }

    fn template(kind: TemplateKind, points: usize) -> TemplateCloud {
        let (cloud, bounds) = cube(points);
        let xxh3 = Checksum::of(&cloud);
        (Template { kind, class: kind.class(), size: [2.0; 3], points, bounds, xxh3 }, cloud)
    }

    /// One background chunk; car "big" with 30 points, car "small" with 10, truck "truck" with 10; one
    /// template of sedans and one of pedestrians.
    fn skeleton(folder: &std::path::Path) -> Skeleton {
        let asset = |track: &str, category: &str, count: usize| {
            let (points, bounds) = cube(count);
            let class = Class::from_category(category);
            let (log, track, category) = ("log".to_owned(), track.to_owned(), category.to_owned());
            let (size, xxh3) = ([2.0; 3], Checksum::of(&points));
            (Asset { log, track, category, class, size, sweeps: 1, points: count, bounds, xxh3 }, points)
        };
        let assets =
            [("big", "vehicle.car", 30), ("small", "vehicle.car", 10), ("truck", "vehicle.truck", 10)];
        SkeletonWriter::write::<FileError>(folder, |writer| {
            let (points, bounds) = cube(2);
            let (origin, xxh3) = ([100.0, 200.0, 0.0], Checksum::of(&points));
            writer.chunk(Chunk { origin, points: 2, bounds, xxh3 }, &points)?;
            for (track, category, count) in assets {
                let (asset, points) = asset(track, category, count);
                writer.actor(asset, &points)?;
            }
            for kind in [TemplateKind::Sedan, TemplateKind::Pedestrian] {
                let (template, points) = template(kind, 4);
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
        ActorState {
            track,
            class: Class::from_category(&category),
            category,
            cuboid: cuboid.unwrap(),
            appearance: None,
        }
    }

    /// Ids of the color and geometry clouds of one actor: 0 is background, 1 to 3 assets, 4 and 5 templates.
    fn shown(
        scene_clouds: &SceneClouds<'_>,
        actor: ActorState,
        options: &SelectionOptions,
    ) -> [Option<usize>; 2] {
        let (color, geometry) = scene_clouds.actor_instances(&actor, 1, options);
        [color, geometry].map(|instance| instance.map(|i| i.cloud))
    }

    #[test]
    fn the_two_clouds_table_is_followed() {
        let folder = tempfile::tempdir().unwrap();
        let skeleton = skeleton(&folder.path().join("s"));
        let scene_clouds = SceneClouds::new(&skeleton, "log");
        let options = SelectionOptions { min_actor_points: 20, template_fit: TemplateFit::Box };
        let shown = |track: &str, category: &str| shown(&scene_clouds, actor(track, category), &options);
        assert_eq!(shown("big", "vehicle.car"), [Some(1), Some(1)]);
        assert_eq!(shown("small", "vehicle.car"), [Some(2), Some(4)]);
        assert_eq!(shown("new", "vehicle.car"), [None, Some(4)]);
        assert_eq!(shown("new", "human.pedestrian.adult"), [None, Some(5)]);
        assert_eq!(shown("truck", "vehicle.truck"), [Some(3), Some(3)]);
        assert_eq!(shown("new", "vehicle.truck"), [None, None]);
        assert_eq!(shown("new", "movable_object.barrier"), [None, None]);
    }

    #[test]
    fn a_trucks_own_points_take_precedence_over_a_template() {
        let folder = tempfile::tempdir().unwrap();
        let skeleton = skeleton(&folder.path().join("s"));
        let templates = vec![template(TemplateKind::Truck, 7), template(TemplateKind::Bus, 7)];
        let substitutes = Substitutes { templates, ..Substitutes::NONE };
        let scene_clouds = SceneClouds::with(&skeleton, "log", &substitutes);
        let options = SelectionOptions { min_actor_points: 20, template_fit: TemplateFit::Box };
        let shown = |track: &str, category: &str| shown(&scene_clouds, actor(track, category), &options);
        assert_eq!(shown("truck", "vehicle.truck"), [Some(3), Some(3)]);
        assert_eq!(shown("new", "vehicle.truck"), [None, Some(6)]);
        assert_eq!(shown("new", "vehicle.bus.bendy"), [None, Some(7)]);
        assert_eq!(shown("new", "vehicle.trailer"), [None, None]);
    }

    #[test]
    fn substitutes_supplement_the_skeleton() {
        let folder = tempfile::tempdir().unwrap();
        let skeleton = skeleton(&folder.path().join("s"));
        let kinds = [TemplateKind::Sedan, TemplateKind::Bike, TemplateKind::Bike];
        let templates = kinds.iter().zip(5..).map(|(kind, points)| template(*kind, points)).collect();
        // The big car loses points, the small one gains some.
        let assets = [("big".to_owned(), cube(12).0), ("small".to_owned(), cube(40).0)].into();
        let substitutes = Substitutes { templates, assets, ..Substitutes::NONE };
        let scene_clouds = SceneClouds::with(&skeleton, "log", &substitutes);
        let options = SelectionOptions { min_actor_points: 20, template_fit: TemplateFit::Box };
        let shown = |track: &str, category: &str| shown(&scene_clouds, actor(track, category), &options);
        assert_eq!(shown("big", "vehicle.car"), [Some(1), Some(4)]);
        assert_eq!(shown("small", "vehicle.car"), [Some(2), Some(2)]);
        assert_eq!(shown("new", "vehicle.bicycle"), [None, Some(6)]);
        let lengths: Vec<usize> = scene_clouds.cloud_set().iter().map(|c| c.len()).collect();
        assert_eq!(lengths, [2, 12, 40, 10, 4, 4, 6]);
    }

    #[test]
    fn a_template_fills_the_box() {
        let folder = tempfile::tempdir().unwrap();
        let skeleton = skeleton(&folder.path().join("s"));
        let scene_clouds = SceneClouds::new(&skeleton, "log");
        let corner = |template_fit| {
            let options = SelectionOptions { template_fit, ..SelectionOptions::default() };
            let (_, geometry) = scene_clouds.actor_instances(&actor("new", "vehicle.car"), 1, &options);
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
        let both = SceneClouds::new(&skeleton, "log").instances(&state, &options);
        let list = |instances: &[Instance]| instances.iter().map(|i| (i.cloud, i.number)).collect::<Vec<_>>();
        assert_eq!(list(&both.color), [(0, 0), (1, 1), (2, 3)]);
        assert_eq!(list(&both.geometry), [(0, 0), (1, 1), (4, 2), (4, 3)]);
        assert_eq!(both.color[0].world_from_local.translation, DVec3::new(100.0, 200.0, 0.0));
        assert_eq!(skeleton.clouds().len(), 6);
        let one = SceneClouds::new(&skeleton, "log").of_color().instances(&state, &options);
        assert_eq!([&one.color, &one.geometry], [&both.color; 2]);
    }

    /// A degraded asset of color maps leaves the geometry, and the count of points that decides on it, as
    /// they are.
    #[test]
    fn color_maps_may_use_other_assets() {
        let folder = tempfile::tempdir().unwrap();
        let skeleton = skeleton(&folder.path().join("s"));
        let degraded = |track: &str| (track.to_owned(), cube(3).0);
        let color_assets = ["big", "small", "unknown"].map(degraded).into_iter().collect();
        let substitutes = Substitutes { color_assets, ..Substitutes::NONE };
        let scene_clouds = SceneClouds::with(&skeleton, "log", &substitutes);
        let options = SelectionOptions { min_actor_points: 20, template_fit: TemplateFit::Box };
        let shown = |track: &str, category: &str| shown(&scene_clouds, actor(track, category), &options);
        assert_eq!(shown("big", "vehicle.car"), [Some(6), Some(1)]);
        assert_eq!(shown("small", "vehicle.car"), [Some(7), Some(4)]);
        assert_eq!(shown("truck", "vehicle.truck"), [Some(3), Some(3)]);
        assert_eq!(scene_clouds.cloud_set().iter().map(|cloud| cloud.len()).collect::<Vec<_>>()[6..], [3, 3]);
    }
}
