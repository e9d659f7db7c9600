use std::collections::BTreeMap;

use glam::{DMat2, DVec2, DVec3, Vec3};

use crate::town::mesh::Mesh;

/// Width of a cell, metres.
pub(super) const CELL_M: f64 = 40.0;

/// Where a thing stands and where it looks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// Its origin, town frame, metres.
    pub(super) at: DVec3,
    /// Its x axis from the town's, radians.
    pub(super) yaw_rad: f64,
}

/// Meshes by place.
#[derive(Debug, Default)]
pub(super) struct Cells {
    meshes: BTreeMap<[i64; 2], Mesh>,
    /// Too large to share a cell.
    large: Vec<Mesh>,
}

/// The cell of a place.
pub(super) fn cell_of(place: DVec2) -> [i64; 2] {
    [(place.x / CELL_M).floor() as i64, (place.y / CELL_M).floor() as i64]
}

impl Place {
    /// On the ground of sidewalks and gardens, `x` along a direction.
    pub(super) fn facing(at: DVec3, along: DVec2) -> Self {
        Self { at, yaw_rad: along.y.atan2(along.x) }
    }

    /// The town's coordinates of a place of the thing.
    pub(super) fn point(&self, local: DVec2) -> DVec2 {
        self.at.truncate() + DMat2::from_angle(self.yaw_rad) * local
    }
}

impl Cells {
    /// The mesh of a cell.
    pub(super) fn mesh(&mut self, cell: [i64; 2]) -> &mut Mesh {
        self.meshes.entry(cell).or_default()
    }

    /// The mesh about a place.
    pub(super) fn near(&mut self, place: DVec2) -> &mut Mesh {
        self.mesh(cell_of(place))
    }

    /// Adds a thing to the cell that its middle is in.
    pub(super) fn stand(&mut self, thing: &Mesh, place: Place) {
        let turn = DMat2::from_angle(place.yaw_rad);
        let turned = |v: [f32; 3]| {
            let v = Vec3::from(v).as_dvec3();
            (turn * v.truncate()).extend(v.z)
        };
        let mut moved = thing.clone();
        for vertex in &mut moved.vertices {
            vertex.position = (turned(vertex.position) + place.at).as_vec3().to_array();
            vertex.normal = turned(vertex.normal).as_vec3().to_array();
        }
        if let Some([low, high]) = moved.bounds() {
            self.near((low + high).truncate() / 2.0).append(&moved);
        }
    }

    /// Adds a mesh of its own, in the town's frame.
    pub(super) fn add_large(&mut self, mesh: Mesh) {
        self.large.push(mesh);
    }

    /// All of them, in the order of cells.
    pub(super) fn into_meshes(self) -> Vec<Mesh> {
        self.meshes.into_values().chain(self.large).filter(|mesh| !mesh.triangles.is_empty()).collect()
    }
}
