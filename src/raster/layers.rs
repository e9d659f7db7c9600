//! Assignment of a frame's instances to visibility buffers.

use crate::raster::{FrameJob, Instance, MapKind, MapSet, Occlusion};

/// An instance of either cloud with its visibility buffers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LayerInstance {
    pub(super) instance: Instance,
    /// Bit mask of its layers.
    pub(super) layers: u32,
    /// Whether point numbers include its points.
    pub(super) numbered: bool,
}

/// The visibility buffers ("layers") of a frame, at most three. Each serves one or more of these purposes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Layers {
    pub(super) color: Option<usize>,
    /// Depth and points, and with [`Occlusion::Scene`] also classes and instances.
    pub(super) geometry: Option<usize>,
    /// Classes and instances with [`Occlusion::Actors`].
    pub(super) actors: Option<usize>,
    pub(super) count: usize,
}

impl Layers {
    pub(super) fn of(job: &FrameJob<'_>) -> Self {
        let semantics = job.maps.intersects(MapSet::ACTORS);
        let in_scene = semantics && job.occlusion == Occlusion::Scene;
        let mut layers = Self::default();
        let mut next = || {
            layers.count += 1;
            layers.count - 1
        };
        let geometry = (job.maps.intersects(MapSet::GEOMETRY) || in_scene).then(&mut next);
        let shared = geometry.filter(|_| job.color == job.geometry);
        let color = job.maps.contains(MapKind::Color).then(|| shared.unwrap_or_else(&mut next));
        let actors = (semantics && !in_scene).then(&mut next);
        Self { color, geometry, actors, ..layers }
    }

    /// Returns the layers where both clouds have the same instances: color is read from the layer of the
    /// geometry.
    pub(super) fn shared(self) -> Self {
        Self { color: self.color.map(|color| self.geometry.unwrap_or(color)), ..self }
    }

    /// Returns the bit mask of the layers that serve a purpose.
    pub(super) fn used(&self) -> u32 {
        self.bits(true, true, true)
    }

    /// Returns whether an instance with these layers is in all those that show the whole scene.
    pub(super) fn is_in_both(&self, layers: u32) -> bool {
        let both = self.bits(true, true, false);
        layers & both == both
    }

    fn bits(&self, in_color: bool, in_geometry: bool, actor: bool) -> u32 {
        let bit = |layer: Option<usize>, wanted: bool| layer.filter(|_| wanted).map_or(0, |l| 1 << l);
        bit(self.color, in_color) | bit(self.geometry, in_geometry) | bit(self.actors, in_geometry && actor)
    }

    /// Merges both clouds into one list that preserves both orders; shared instances occur once.
    pub(super) fn merge(&self, job: &FrameJob<'_>) -> Vec<LayerInstance> {
        let (mut color, mut geometry) = (job.color, job.geometry);
        let mut merged = Vec::with_capacity(color.len().max(geometry.len()));
        loop {
            let (instance, in_color, in_geometry) = match (color.first(), geometry.first()) {
                (None, None) => return merged,
                (Some(c), Some(g)) if c == g => (c, true, true),
                // Differing lists advance in the order of actors, so that the next instances can be shared
                // again.
                (Some(c), Some(g)) if c.number <= g.number => (c, true, false),
                (Some(c), None) => (c, true, false),
                (_, Some(g)) => (g, false, true),
            };
            let layers = self.bits(in_color, in_geometry, instance.number > 0);
            merged.push(LayerInstance { instance: *instance, layers, numbered: in_geometry });
            color = &color[usize::from(in_color)..];
            geometry = &geometry[usize::from(in_geometry)..];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::SplatSchedule;
    use glam::DAffine3;

    fn instance(cloud: usize, number: u32) -> Instance {
        Instance { cloud, world_from_local: DAffine3::IDENTITY, number }
    }

    fn job<'a>(color: &'a [Instance], geometry: &'a [Instance], schedule: &'a SplatSchedule) -> FrameJob<'a> {
        FrameJob {
            views: &[],
            schedule,
            color,
            geometry,
            occlusion: Occlusion::Scene,
            crop: None,
            maps: MapSet::SPLATTED,
            out_size: None,
        }
    }

    #[test]
    fn one_cloud_needs_one_layer() {
        let (list, schedule) = ([instance(0, 0), instance(1, 1)], SplatSchedule::default());
        let mut job = job(&list, &list, &schedule);
        let layers = Layers::of(&job);
        assert_eq!((layers.count, layers.color, layers.geometry, layers.actors), (1, Some(0), Some(0), None));
        job.occlusion = Occlusion::Actors;
        let layers = Layers::of(&job);
        assert_eq!((layers.count, layers.actors), (2, Some(1)));
        assert_eq!(layers.merge(&job).iter().map(|l| l.layers).collect::<Vec<_>>(), [0b01, 0b11]);
        job.maps = MapSet::COLOR;
        assert_eq!(Layers::of(&job).count, 1);
    }

    #[test]
    fn layers_of_equal_clouds_are_shared() {
        let schedule = SplatSchedule::default();
        let (one, other) = ([instance(0, 1)], [instance(1, 1)]);
        let mut job = job(&one, &other, &schedule);
        for (occlusion, used, shared) in [(Occlusion::Scene, 0b11, 0b01), (Occlusion::Actors, 0b111, 0b101)] {
            job.occlusion = occlusion;
            let layers = Layers::of(&job);
            assert_eq!((layers.used(), layers.shared().used()), (used, shared));
            assert_eq!(layers.shared().shared(), layers.shared());
            assert!(layers.is_in_both(0b11) && !layers.is_in_both(0b101) && !layers.is_in_both(0b10));
        }
        job.maps = MapSet::COLOR;
        let color = Layers::of(&job);
        assert_eq!((color.shared(), color.used()), (color, 1));
        assert!(color.is_in_both(1) && !color.is_in_both(0));
    }

    #[test]
    fn shared_instances_are_drawn_once() {
        let schedule = SplatSchedule::default();
        let color = [instance(0, 0), instance(1, 1), instance(2, 2), instance(3, 3)];
        let geometry = [instance(0, 0), instance(9, 1), instance(2, 2), instance(8, 4)];
        let job = job(&color, &geometry, &schedule);
        let merged = Layers::of(&job).merge(&job);
        let list: Vec<_> = merged.iter().map(|l| (l.instance.cloud, l.layers, l.numbered)).collect();
        let (both, color, geometry) = (0b11, 0b10, 0b01);
        assert_eq!(
            list,
            [
                (0, both, true),
                (1, color, false),
                (9, geometry, true),
                (2, both, true),
                (3, color, false),
                (8, geometry, true)
            ]
        );
    }
}
