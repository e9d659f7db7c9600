//! Meshes of a town: static objects, and bodies in all poses of their limbs.

use std::collections::BTreeMap;

use crate::built;
use crate::mesh::Mesh;
use crate::model::Body;
use crate::plan::{Actor, Motion, Plan};

/// All meshes.
pub(super) struct Meshes {
    /// Static town, town frame.
    pub(super) static_meshes: Vec<Mesh>,
    /// Bodies by kind, seed and pose of the limbs, in the body's frame.
    pub(super) bodies: BTreeMap<(Body, usize), Mesh>,
}

impl Meshes {
    /// Generates the meshes of a town with this plan and seed.
    pub(super) fn new(plan: &Plan, seed: u64) -> Self {
        let poses = |actor: &Actor| {
            let poses = if actor.motion.poses.len() > 1 { actor.body.poses() } else { 1 };
            (0..poses.max(1)).map(|pose| (actor.body, pose)).collect::<Vec<_>>()
        };
        let keys = plan.traffic.actors.iter().flat_map(poses);
        let bodies: BTreeMap<_, _> = keys.map(|(body, pose)| ((body, pose), body.mesh(pose))).collect();
        Self { static_meshes: built::static_meshes(plan, seed), bodies }
    }
}

/// Returns the pose of a body's limbs.
pub(super) fn limbs(body: Body, motion: &Motion, t_s: f64) -> usize {
    if motion.poses.len() > 1 { body.pose_at(motion.travelled_m(t_s)) } else { 0 }
}
