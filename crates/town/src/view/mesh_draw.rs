//! Draw of a mesh: what to render, where, and with which class and instance.

use glam::DAffine3;

/// Draw of a mesh at a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshDraw {
    /// Index of the mesh.
    pub mesh: usize,
    /// Pose of the mesh: rotation and translation, meters.
    pub town_from_mesh: DAffine3,
    /// Value in the class map.
    pub class: u8,
    /// Value in the instance map; 0 if it is not an instance.
    pub instance: u32,
}
