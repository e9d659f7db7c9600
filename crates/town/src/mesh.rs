//! Triangle meshes with surface materials, shared by the town's cameras and LiDAR.
//!
//! # Rules for mesh authors
//! - All corners of a triangle have the same color, surface and seed, since the device takes them from an
//!   unspecified corner. Both sides of triangles are rendered.
//! - uv wraps at ±64 m with a resolution of 2 mm. Brick, plaster, concrete, wood, roof tiles, sidewalk,
//!   window and sign use uv with u horizontal and v up (roof tiles: v up the slope; wood: planks along v).
//!   Asphalt, paint and grass use the position in the town.
//! - The uv of a window starts at the lower left corner of the pane. A pane whose lower edge is below 0.75 m
//!   is a shop window or a door. The seed selects room, curtains, and whether it is lit at dusk.
//! - A sign with seed 0 has no letters.

mod smooth;
mod solids;

use bytemuck::{Pod, Zeroable};
use glam::{DVec2, DVec3};

pub use solids::Ring;

/// Material of a surface; selects its shading and its LiDAR reflectance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
#[allow(missing_docs)]
pub enum Surface {
    /// Matt, of one color.
    Plain = 0,
    Asphalt = 1,
    /// Paved with slabs.
    Sidewalk = 2,
    /// Worn paint on asphalt.
    Paint = 3,
    Grass = 4,
    Plaster = 5,
    Brick = 6,
    /// Window of a house: mirrors the sky, with a room or curtains behind.
    Window = 7,
    /// Window of a vehicle.
    CarGlass = 8,
    CarPaint = 9,
    Rubber = 10,
    Metal = 11,
    Foliage = 12,
    Bark = 13,
    RoofTiles = 14,
    Concrete = 15,
    /// Lamp: bright in any daylight, brighter at dusk.
    Lamp = 16,
    /// Traffic sign or shop sign.
    Sign = 17,
    Wood = 18,
    Cloth = 19,
}

/// Vertex of a triangle: 40 bytes, uploaded to the device unchanged.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Vertex {
    /// Position in the mesh's frame, meters.
    pub position: [f32; 3],
    /// Unit normal, outward.
    pub normal: [f32; 3],
    /// Texture coordinates along the surface, meters.
    pub uv: [f32; 2],
    /// sRGB color; alpha is 255.
    pub rgba: [u8; 4],
    /// [`Surface`] in the low 8 bits, the pattern's seed in the high 24.
    pub surface: u32,
}

/// Color and material that meshes are built with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Skin {
    /// sRGB color.
    pub rgb: [u8; 3],
    /// Material.
    pub surface: Surface,
    /// Seed of the pattern; only the low 24 bits are used.
    pub seed: u32,
}

/// Triangle mesh; triangles are counter-clockwise seen from outside.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertices.
    pub vertices: Vec<Vertex>,
    /// Indices of vertices.
    pub triangles: Vec<[u32; 3]>,
}

impl Skin {
    /// Creates a skin with pattern seed 0.
    pub const fn new(rgb: [u8; 3], surface: Surface) -> Self {
        Self { rgb, surface, seed: 0 }
    }
}

impl Mesh {
    /// Adds a flat-shaded convex polygon, counter-clockwise seen from outside. `uv` starts at its first
    /// corner and runs along its first edge and perpendicular to it, meters.
    pub fn polygon(&mut self, corners: &[DVec3], skin: Skin) {
        let [a, b, .., last] = corners else { return };
        let along = (*b - *a).normalize_or_zero();
        let normal = along.cross(*last - *a).normalize_or_zero();
        let across = normal.cross(along);
        let uv = |p: DVec3| DVec2::new((p - *a).dot(along), (p - *a).dot(across));
        let corners: Vec<(DVec3, DVec3, DVec2)> = corners.iter().map(|p| (*p, normal, uv(*p))).collect();
        self.fan(&corners, skin);
    }

    /// Adds a convex polygon with a position, normal and uv for each corner.
    pub fn fan(&mut self, corners: &[(DVec3, DVec3, DVec2)], skin: Skin) {
        let first = self.vertices.len() as u32;
        self.vertices.extend(corners.iter().map(|(position, normal, uv)| Vertex {
            position: position.as_vec3().to_array(),
            normal: normal.as_vec3().to_array(),
            uv: uv.as_vec2().to_array(),
            rgba: [skin.rgb[0], skin.rgb[1], skin.rgb[2], 255],
            surface: skin.surface as u32 | skin.seed << 8,
        }));
        self.triangles.extend((2..corners.len() as u32).map(|i| [first, first + i - 1, first + i]));
    }

    /// Adds the six sides of a box.
    pub fn block(&mut self, min: DVec3, max: DVec3, skin: Skin) {
        let corner = |bits: usize| {
            let pick = |axis: usize| if bits >> axis & 1 == 1 { max[axis] } else { min[axis] };
            DVec3::new(pick(0), pick(1), pick(2))
        };
        for side in [[1, 3, 7, 5], [2, 0, 4, 6], [3, 2, 6, 7], [0, 1, 5, 4], [4, 5, 7, 6], [2, 3, 1, 0]] {
            self.polygon(&side.map(corner), skin);
        }
    }

    /// Appends another mesh.
    pub fn append(&mut self, other: &Self) {
        let first = self.vertices.len() as u32;
        self.vertices.extend_from_slice(&other.vertices);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|i| i + first)));
    }

    /// Returns the min and max coordinates, meters; `None` without vertices.
    pub fn bounds(&self) -> Option<[DVec3; 2]> {
        let positions = self.vertices.iter().map(|v| glam::Vec3::from(v.position).as_dvec3());
        positions.map(|p| [p, p]).reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_closed_and_face_outward() {
        let mut mesh = Mesh::default();
        mesh.block(DVec3::new(-1.0, -2.0, 0.0), DVec3::new(1.0, 2.0, 3.0), Skin::new([9; 3], Surface::Plain));
        assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (24, 12));
        assert_eq!(mesh.bounds(), Some([DVec3::new(-1.0, -2.0, 0.0), DVec3::new(1.0, 2.0, 3.0)]));
        let mut volume = 0.0;
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|i| glam::Vec3::from(mesh.vertices[i as usize].position));
            let normal = (b - a).cross(c - a).normalize();
            assert_eq!(normal.to_array(), mesh.vertices[triangle[0] as usize].normal);
            volume += a.dot(b.cross(c)) / 6.0;
        }
        assert!((volume - 24.0).abs() < 1e-5);
    }
}
