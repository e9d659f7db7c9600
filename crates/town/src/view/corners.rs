//! Identification of triangles by their provoking vertex.
//!
//! # How it works
//! The device reports the provoking vertex of the triangle that a sample shows. To identify the triangle, no
//! two triangles may start with the same vertex: their corners are rotated, and if all corners of a triangle
//! are taken, its first is duplicated. The host then looks up the triangle and computes its depth in `f64`.

use std::ops::Range;

use glam::{DVec3, Vec3};

use super::MeshRenderError;
use crate::mesh::{Mesh, Vertex};

/// All meshes in one vertex and one index list.
#[derive(Debug, Default)]
pub(super) struct Corners {
    /// Vertices of all meshes.
    pub(super) vertices: Vec<Vertex>,
    /// Three indices per triangle; the first is the first of no other triangle.
    pub(super) indices: Vec<u32>,
    /// Indices of the triangle that each vertex starts; `[0; 3]` if it starts none.
    begun: Vec<[u32; 3]>,
    /// One part for each mesh.
    pub(super) parts: Vec<Part>,
}

/// Part of the lists that belongs to a mesh.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Part {
    /// Range of its indices.
    pub(super) indices: Range<u32>,
    /// Min and max coordinates, meters, mesh frame; `None` without vertices.
    pub(super) bounds: Option<[DVec3; 2]>,
}

impl Corners {
    /// Concatenates meshes.
    ///
    /// # Errors
    /// Returns an error if a triangle has a corner that its mesh does not have, or if there are too many
    /// corners.
    pub(super) fn new(meshes: &[&Mesh]) -> Result<Self, MeshRenderError> {
        let mut all = Self::default();
        for (number, mesh) in meshes.iter().enumerate() {
            all.add(number, mesh)?;
        }
        Ok(all)
    }

    fn add(&mut self, number: usize, mesh: &Mesh) -> Result<(), MeshRenderError> {
        // Every triangle adds at most one vertex, and three indices.
        let most = self.vertices.len() + mesh.vertices.len() + mesh.triangles.len();
        let most = most.max(self.indices.len() + 3 * mesh.triangles.len());
        u32::try_from(most).map_err(|_| MeshRenderError::TooManyCorners)?;
        let (base, start) = (self.vertices.len() as u32, self.indices.len() as u32);
        self.vertices.extend_from_slice(&mesh.vertices);
        self.begun.resize(self.vertices.len(), [0; 3]);
        let mut taken = vec![false; mesh.vertices.len()];
        for triangle in &mesh.triangles {
            if let Some(&corner) = triangle.iter().find(|i| **i as usize >= mesh.vertices.len()) {
                let corners = mesh.vertices.len();
                return Err(MeshRenderError::Corner { mesh: number, corners, corner });
            }
            let free = (0..3).find(|i| !taken[triangle[*i] as usize]);
            let [mut a, b, c] = [0, 1, 2].map(|i| base + triangle[(free.unwrap_or(0) + i) % 3]);
            match free {
                Some(i) => taken[triangle[i] as usize] = true,
                None => {
                    self.vertices.push(self.vertices[a as usize]);
                    self.begun.push([0; 3]);
                    a = self.vertices.len() as u32 - 1;
                }
            }
            self.begun[a as usize] = [a, b, c];
            self.indices.extend([a, b, c]);
        }
        let indices = start..self.indices.len() as u32;
        self.parts.push(Part { indices, bounds: mesh.bounds() });
        Ok(())
    }

    /// Returns the triangle that a vertex starts, meters, mesh frame; `None` if the vertex does not exist.
    pub(super) fn triangle(&self, corner: u32) -> Option<[DVec3; 3]> {
        let corners = self.begun.get(corner as usize)?;
        Some(corners.map(|i| Vec3::from(self.vertices[i as usize].position).as_dvec3()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{Skin, Surface};

    #[test]
    fn every_triangle_has_its_own_provoking_corner() {
        let mut mesh = Mesh::default();
        mesh.block(DVec3::ZERO, DVec3::ONE, Skin::new([9; 3], Surface::Plain));
        // Adds a fan around one corner, and more triangles than corners.
        mesh.triangles.extend([[0, 1, 2], [0, 2, 1], [0, 1, 2], [5, 9, 13]]);
        let all = Corners::new(&[&mesh, &Mesh::default(), &mesh]).unwrap();
        assert_eq!(all.parts.len(), 3);
        assert_eq!((all.parts[1].indices.len(), all.parts[1].bounds), (0, None));
        let mut seen = std::collections::BTreeSet::new();
        for part in [&all.parts[0], &all.parts[2]] {
            assert_eq!(part.indices.len(), 3 * mesh.triangles.len());
            let range = part.indices.start as usize..part.indices.end as usize;
            for (now, was) in all.indices[range].chunks(3).zip(&mesh.triangles) {
                assert!(seen.insert(now[0]));
                let at = |i: u32| Vec3::from(mesh.vertices[i as usize].position).as_dvec3();
                let [a, b, c] = was.map(at);
                // The same triangle, rotated.
                let found = all.triangle(now[0]).unwrap();
                assert!([[a, b, c], [b, c, a], [c, a, b]].contains(&found), "{found:?}");
            }
        }
        assert_eq!(all.triangle(all.vertices.len() as u32), None);
    }

    #[test]
    fn rejects_missing_corners() {
        let mut mesh = Mesh::default();
        mesh.block(DVec3::ZERO, DVec3::ONE, Skin::new([9; 3], Surface::Plain));
        mesh.triangles[3][1] = 24;
        let text = Corners::new(&[&Mesh::default(), &mesh]).unwrap_err().to_string();
        assert_eq!(text, "expected corners below 24 in the triangles of mesh 1, found 24");
    }
}
