//! The bodies of those who move or park in the town: vehicles, people, riders.

use glam::DVec3;

use super::mesh::{Mesh, Skin, Surface};

/// Kind of a body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[allow(missing_docs)]
pub enum BodyKind {
    Sedan,
    Hatchback,
    Suv,
    Pickup,
    Van,
    Truck,
    Bus,
    Walker,
    Cyclist,
    Cone,
}

/// A body: a kind, and a seed that its proportions, colors and clothes follow from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Body {
    /// What it is.
    pub kind: BodyKind,
    /// Of everything else.
    pub seed: u64,
}

impl Body {
    /// Category name as nuScenes has it.
    pub fn category(self) -> &'static str {
        match self.kind {
            BodyKind::Sedan | BodyKind::Hatchback | BodyKind::Suv | BodyKind::Pickup | BodyKind::Van => {
                "vehicle.car"
            }
            BodyKind::Truck => "vehicle.truck",
            BodyKind::Bus => "vehicle.bus.rigid",
            BodyKind::Walker => "human.pedestrian.adult",
            BodyKind::Cyclist => "vehicle.bicycle",
            BodyKind::Cone => "movable_object.trafficcone",
        }
    }

    /// Length, width and height of its box, metres: what its mesh fills in its widest pose.
    pub fn size_m(self) -> DVec3 {
        match self.kind {
            BodyKind::Sedan => DVec3::new(4.6, 1.84, 1.46),
            BodyKind::Hatchback => DVec3::new(4.1, 1.78, 1.5),
            BodyKind::Suv => DVec3::new(4.7, 1.92, 1.85),
            BodyKind::Pickup => DVec3::new(5.4, 1.95, 1.9),
            BodyKind::Van => DVec3::new(5.3, 2.02, 2.25),
            BodyKind::Truck => DVec3::new(8.0, 2.5, 3.4),
            BodyKind::Bus => DVec3::new(12.0, 2.55, 3.2),
            BodyKind::Walker => DVec3::new(0.8, 0.66, 1.76),
            BodyKind::Cyclist => DVec3::new(1.8, 0.62, 1.74),
            BodyKind::Cone => DVec3::new(0.42, 0.42, 0.72),
        }
    }

    /// How many poses of limbs [`Body::mesh`] knows: 1 for what is stiff.
    pub fn poses(self) -> usize {
        1
    }

    /// Its triangles in one of its poses; the origin is on the ground below the middle of its box, x forward, y left, z up.
    pub fn mesh(self, _pose: usize) -> Mesh {
        let mut mesh = Mesh::default();
        let half = self.size_m() / 2.0;
        let (min, max) = (DVec3::new(-half.x, -half.y, 0.0), DVec3::new(half.x, half.y, 2.0 * half.z));
        mesh.block(min, max, Skin::new([160, 60, 50], Surface::CarPaint));
        mesh
    }
}
