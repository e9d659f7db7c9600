//! Renderer of a town with actors in any state.

use std::collections::BTreeMap;

use glam::DAffine3;
use point_skeleton::dataset::Class;
use point_skeleton::geometry::{Pose, View};
use point_skeleton::gpu::{Device, DeviceDesc};

use super::error::TownError;
use super::meshes::{Meshes, limbs};
use crate::TownOptions;
use crate::mesh::Mesh;
use crate::model::Body;
use crate::plan::Actor;
use crate::view::{GroundTruthView, Light, MeshDraw, MeshRenderError, MeshRenderer};

/// Renderer with all meshes on the device.
pub(super) struct TownRenderer {
    renderer: MeshRenderer,
    light: Light,
    /// Number of static meshes; they come first and are in the town's frame.
    static_count: usize,
    bodies: BTreeMap<(Body, usize), usize>,
}

/// Actor in the town's frame.
pub(super) struct Figure {
    pub(super) actor: usize,
    pub(super) town_from_actor: Pose,
    /// Number in the instance map; 0 for actors without a box.
    pub(super) number: u32,
}

impl TownRenderer {
    /// Uploads the meshes of a town with these options.
    pub(super) fn new(meshes: &Meshes, options: &TownOptions) -> Result<Self, TownError> {
        let device = Device::new(&DeviceDesc::from_env())?;
        let all: Vec<&Mesh> = meshes.static_meshes.iter().chain(meshes.bodies.values()).collect();
        let static_count = meshes.static_meshes.len();
        let bodies = meshes.bodies.keys().copied().zip(static_count..).collect();
        let light = Light::new(options.light(), options.seed);
        Ok(Self { renderer: MeshRenderer::new(&device, &all)?, light, static_count, bodies })
    }

    /// Renders views whose world is the town's frame. Only the figures are visible, with their limbs at a
    /// time in seconds.
    pub(super) fn render(
        &mut self,
        t_s: f64,
        actors: &[Actor],
        figures: &[Figure],
        views: &[View],
    ) -> Result<Vec<GroundTruthView>, MeshRenderError> {
        let still = |mesh| MeshDraw { mesh, town_from_mesh: DAffine3::IDENTITY, class: 0, instance: 0 };
        let figure = |figure: &Figure| {
            let actor = &actors[figure.actor];
            let limbs = limbs(actor.body, &actor.motion, t_s);
            let class =
                if figure.number > 0 { Class::from_category(actor.body.category()) } else { Class::None };
            Some(MeshDraw {
                mesh: *self.bodies.get(&(actor.body, limbs))?,
                town_from_mesh: figure.town_from_actor.affine(),
                class: class as u8,
                instance: figure.number,
            })
        };
        let draws: Vec<MeshDraw> =
            (0..self.static_count).map(still).chain(figures.iter().filter_map(figure)).collect();
        self.renderer.render(&draws, views, &self.light)
    }
}
