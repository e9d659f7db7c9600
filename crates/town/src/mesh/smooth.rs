//! Smooth normals, mirroring, and fitting into a box.

use glam::{DVec3, Vec3};
use rustc_hash::FxHashMap;

use super::{Mesh, Vertex};

impl Mesh {
    /// Sets each corner's normal to the area-weighted mean of the adjacent faces whose normals differ from
    /// its own face's by at most `crease_rad`, and merges identical vertices.
    pub fn smooth(&mut self, crease_rad: f64) {
        let least_cos = crease_rad.cos();
        let areas: Vec<DVec3> = self.triangles.iter().map(|t| self.area(*t)).collect();
        let mut around: FxHashMap<[u32; 3], Vec<usize>> = FxHashMap::default();
        for (i, triangle) in self.triangles.iter().enumerate() {
            triangle.iter().for_each(|corner| around.entry(self.place(*corner)).or_default().push(i));
        }
        let mut merged = Self::default();
        let mut known: FxHashMap<[u32; 10], u32> = FxHashMap::default();
        for (i, triangle) in self.triangles.iter().enumerate() {
            let own = areas[i].normalize_or_zero();
            let corners = triangle.map(|corner| {
                let near = around[&self.place(corner)].iter().map(|other| areas[*other]);
                let sum: DVec3 = near.filter(|a| a.normalize_or_zero().dot(own) >= least_cos).sum();
                let normal = sum.try_normalize().unwrap_or(own).as_vec3().to_array();
                let vertex = Vertex { normal, ..self.vertices[corner as usize] };
                *known.entry(bytemuck::cast(vertex)).or_insert_with(|| {
                    merged.vertices.push(vertex);
                    merged.vertices.len() as u32 - 1
                })
            });
            merged.triangles.push(corners);
        }
        *self = merged;
    }

    /// Appends the mirror image of the whole mesh, left and right swapped.
    pub fn mirror_y(&mut self) {
        let mut other = self.clone();
        for vertex in &mut other.vertices {
            vertex.position[1] = -vertex.position[1];
            vertex.normal[1] = -vertex.normal[1];
        }
        other.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        self.append(&other);
    }

    /// Scales along each axis so that one box (min and max coordinates, meters) maps to another.
    pub fn fit(&mut self, from: [DVec3; 2], to: [DVec3; 2]) {
        let scale = (to[1] - to[0]) / (from[1] - from[0]);
        for vertex in &mut self.vertices {
            let p = to[0] + (Vec3::from(vertex.position).as_dvec3() - from[0]) * scale;
            vertex.position = p.as_vec3().to_array();
            let normal = Vec3::from(vertex.normal).as_dvec3() / scale;
            vertex.normal = normal.normalize_or_zero().as_vec3().to_array();
        }
    }

    /// Returns the corners of a triangle, meters.
    pub fn corners(&self, triangle: [u32; 3]) -> [DVec3; 3] {
        triangle.map(|i| Vec3::from(self.vertices[i as usize].position).as_dvec3())
    }

    /// Returns a triangle's normal; its length is the area in square meters.
    pub fn area(&self, triangle: [u32; 3]) -> DVec3 {
        let [a, b, c] = self.corners(triangle);
        (b - a).cross(c - a) / 2.0
    }

    /// Returns the bits of a vertex's position; -0.0 equals 0.0.
    fn place(&self, corner: u32) -> [u32; 3] {
        self.vertices[corner as usize].position.map(|v| (v + 0.0).to_bits())
    }
}
