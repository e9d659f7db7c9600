use std::collections::BTreeMap;

use glam::{DMat2, DVec2, DVec3, Vec3};

use crate::mesh::Mesh;

/// Width of a cell, meters.
pub(super) const CELL_M: f64 = 40.0;

/// Position and orientation of an object.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// Origin in the town's frame, meters.
    pub(super) at: DVec3,
    /// Rotation of its x axis from the town's, radians.
    pub(super) yaw_rad: f64,
}

/// Meshes grouped by grid cell.
#[derive(Debug, Default)]
pub(super) struct Cells {
    meshes: BTreeMap<[i64; 2], Mesh>,
    /// Meshes too large to share a cell.
    large: Vec<Mesh>,
}

/// Returns the cell that contains a position.
pub(super) fn cell_of(place: DVec2) -> [i64; 2] {
    [(place.x / CELL_M).floor() as i64, (place.y / CELL_M).floor() as i64]
}

impl Place {
    /// Creates a place at `at` with `x` along a direction.
    pub(super) fn facing(at: DVec3, along: DVec2) -> Self {
        Self { at, yaw_rad: along.y.atan2(along.x) }
    }

    /// Transforms a point from the object's frame to the town's.
    pub(super) fn point(&self, local: DVec2) -> DVec2 {
        self.at.truncate() + DMat2::from_angle(self.yaw_rad) * local
    }
}

impl Cells {
    /// Returns the mesh of a cell.
    pub(super) fn mesh(&mut self, cell: [i64; 2]) -> &mut Mesh {
        self.meshes.entry(cell).or_default()
    }

    /// Returns the mesh of the cell around a position.
    pub(super) fn near(&mut self, place: DVec2) -> &mut Mesh {
        self.mesh(cell_of(place))
    }

    /// Adds an object to the cell that contains its middle.
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

    /// Adds a separate mesh, in the town's frame.
    pub(super) fn add_large(&mut self, mesh: Mesh) {
        self.large.push(mesh);
    }

    /// Returns all meshes that are not empty, in the order of cells, then the large ones.
    pub(super) fn into_meshes(self) -> Vec<Mesh> {
        self.meshes.into_values().chain(self.large).filter(|mesh| !mesh.triangles.is_empty()).collect()
    }
}
