//! Trees and bushes: trunks with crowns of irregular balls. The shader adds detail finer than a branch.

use std::collections::BTreeMap;

use glam::{DVec2, DVec3};
use point_skeleton::hash::unit;

use super::draw::Draw;
use super::sketch::bar;
use crate::mesh::{Mesh, Skin, Surface};

/// Color and shape seed of a crown.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crown {
    skin: Skin,
    seed: u64,
}

/// Kind of a tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Species {
    /// Wide crown of several balls.
    Broad,
    /// Narrow, tall crown.
    Slender,
    /// Fir.
    Conifer,
}

impl Crown {
    /// Creates a crown with leaves of a color.
    pub(super) fn new(rgb: [u8; 3], seed: u64) -> Self {
        Self { skin: Skin { rgb, surface: Surface::Foliage, seed: seed as u32 & 0xff_ffff }, seed }
    }
}

/// Returns a tree of a height and a crown radius, meters; `fine` adds detail for trees close to the street.
pub(super) fn tree(species: Species, height: f64, radius: f64, crown: Crown, fine: bool) -> Mesh {
    let mut mesh = Mesh::default();
    let mut draw = Draw::new(crown.seed, &[2]);
    let bark = Skin {
        rgb: draw.pick(&[[104, 84, 66], [120, 104, 86], [92, 80, 70]]),
        surface: Surface::Bark,
        seed: 0,
    };
    let sides = if fine { 7 } else { 4 };
    let thick = 0.03 * height + 0.02;
    if species == Species::Conifer {
        bar(
            &mut mesh,
            [DVec3::new(0.0, 0.0, -0.1), DVec3::Z * 0.3 * height],
            [thick, 0.8 * thick],
            sides,
            bark,
        );
        let layers = if fine { 5 } else { 3 };
        for i in 0..layers {
            let share = f64::from(i) / f64::from(layers);
            let (low, wide) = (height * (0.12 + 0.8 * share), radius * (1.0 - 0.85 * share));
            let top = (low + 1.9 * height / f64::from(layers) * 0.75).min(height);
            let turn = DVec3::new(draw.between(-0.08, 0.08), draw.between(-0.08, 0.08), 0.0);
            let skin = Skin { rgb: draw.shade(crown.skin.rgb, 0.08), ..crown.skin };
            bar(
                &mut mesh,
                [DVec3::Z * low + turn, DVec3::Z * top],
                [wide, 0.0],
                if fine { 9 } else { 6 },
                skin,
            );
        }
        return mesh;
    }
    let slender = species == Species::Slender;
    let stem = height * if slender { 0.4 } else { 0.46 };
    let lean = DVec3::new(draw.between(-0.1, 0.1), draw.between(-0.1, 0.1), stem);
    bar(&mut mesh, [DVec3::new(0.0, 0.0, -0.1), lean], [thick, 0.7 * thick], sides, bark);
    let detail = usize::from(fine);
    let balls = match (slender, fine) {
        (true, _) => 3,
        (false, true) => 5,
        (false, false) => 4,
    };
    for i in 0..balls {
        let share = (f64::from(i) + 0.5) / f64::from(balls);
        let (at, size) = if slender {
            let z = height * (0.5 + 0.4 * share);
            let wide = radius * (1.1 - 0.5 * share);
            let off = [draw.between(-0.15, 0.15), draw.between(-0.15, 0.15)];
            (DVec3::new(off[0], off[1], z), DVec3::new(0.8 * wide, 0.8 * wide, 0.17 * height))
        } else if i + 1 == balls {
            (DVec3::new(0.0, 0.0, height * 0.84), DVec3::new(0.72, 0.72, 0.6) * radius)
        } else {
            let turn =
                std::f64::consts::TAU * (f64::from(i) + draw.between(-0.2, 0.2)) / f64::from(balls - 1);
            let off = DVec2::from_angle(turn) * radius * draw.between(0.38, 0.5);
            let z = height * draw.between(0.62, 0.72);
            (off.extend(z), DVec3::new(0.66, 0.66, 0.5) * radius * draw.between(0.85, 1.1))
        };
        if fine && !slender {
            bar(&mut mesh, [lean * 0.9, at], [0.45 * thick, 0.2 * thick], 4, bark);
        }
        let skin = Skin { rgb: draw.shade(crown.skin.rgb, 0.1), ..crown.skin };
        ball(&mut mesh, at, size, detail, 0.2, Crown { skin, seed: draw.seed() });
    }
    mesh
}

/// Adds a bush on the ground.
pub(super) fn bush(mesh: &mut Mesh, at: DVec3, radius: f64, crown: Crown) {
    ball(mesh, at + DVec3::Z * 0.6 * radius, DVec3::new(1.0, 1.0, 0.85) * radius, 1, 0.16, crown);
}

/// Adds an irregular ellipsoid: an icosahedron subdivided `splits` times, with vertices displaced in and out.
fn ball(mesh: &mut Mesh, centre: DVec3, radii: DVec3, splits: usize, rough: f64, crown: Crown) {
    let (mut corners, mut faces) = icosahedron();
    for _ in 0..splits {
        (corners, faces) = split(corners, &faces);
    }
    let first = mesh.vertices.len() as u32;
    for (i, direction) in corners.iter().enumerate() {
        let reach = 1.0 + rough * (2.0 * unit(crown.seed, &[i as i64]) - 1.0);
        let p = centre + *direction * radii * reach;
        // These uv are continuous over the whole crown, without visible seams.
        let uv = DVec2::new(p.x + 0.6 * p.y, p.z - 0.4 * p.y);
        let normal = (*direction / radii).normalize_or(DVec3::Z);
        mesh.vertices.push(crate::mesh::Vertex {
            position: p.as_vec3().to_array(),
            normal: normal.as_vec3().to_array(),
            uv: uv.as_vec2().to_array(),
            rgba: [crown.skin.rgb[0], crown.skin.rgb[1], crown.skin.rgb[2], 255],
            surface: crown.skin.surface as u32 | crown.skin.seed << 8,
        });
    }
    mesh.triangles.extend(faces.iter().map(|face| face.map(|i| first + i)));
}

fn icosahedron() -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let g = (1.0 + 5.0f64.sqrt()) / 2.0;
    let corners = [
        [-1.0, g, 0.0],
        [1.0, g, 0.0],
        [-1.0, -g, 0.0],
        [1.0, -g, 0.0],
        [0.0, -1.0, g],
        [0.0, 1.0, g],
        [0.0, -1.0, -g],
        [0.0, 1.0, -g],
        [g, 0.0, -1.0],
        [g, 0.0, 1.0],
        [-g, 0.0, -1.0],
        [-g, 0.0, 1.0],
    ];
    let faces = vec![
        [0, 11, 5],
        [0, 5, 1],
        [0, 1, 7],
        [0, 7, 10],
        [0, 10, 11],
        [1, 5, 9],
        [5, 11, 4],
        [11, 10, 2],
        [10, 7, 6],
        [7, 1, 8],
        [3, 9, 4],
        [3, 4, 2],
        [3, 2, 6],
        [3, 6, 8],
        [3, 8, 9],
        [4, 9, 5],
        [2, 4, 11],
        [6, 2, 10],
        [8, 6, 7],
        [9, 8, 1],
    ];
    (corners.iter().map(|corner| DVec3::from(*corner).normalize_or(DVec3::Z)).collect(), faces)
}

fn split(mut corners: Vec<DVec3>, faces: &[[u32; 3]]) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut middles: BTreeMap<[u32; 2], u32> = BTreeMap::new();
    let mut halves = Vec::with_capacity(4 * faces.len());
    for &[a, b, c] in faces {
        let mut middle = |i: u32, j: u32| {
            *middles.entry([i.min(j), i.max(j)]).or_insert_with(|| {
                corners.push((corners[i as usize] + corners[j as usize]).normalize_or(DVec3::Z));
                corners.len() as u32 - 1
            })
        };
        let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
        halves.extend([[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]);
    }
    (corners, halves)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn balls_are_closed_and_face_outward() {
        for splits in 0..3 {
            let mut mesh = Mesh::default();
            ball(&mut mesh, DVec3::ZERO, DVec3::new(1.0, 2.0, 3.0), splits, 0.0, Crown::new([9; 3], 1));
            assert_eq!(mesh.triangles.len(), 20 * 4usize.pow(splits as u32));
            let corner = |i: u32| glam::Vec3::from(mesh.vertices[i as usize].position).as_dvec3();
            let mut volume = 0.0;
            for [a, b, c] in mesh.triangles.iter().map(|t| t.map(corner)) {
                assert!((b - a).cross(c - a).dot(a + b + c) > 0.0);
                volume += a.dot(b.cross(c)) / 6.0;
            }
            let whole = 4.0 / 3.0 * std::f64::consts::PI * 6.0;
            assert!(volume < whole && volume > whole * [0.6, 0.85, 0.95][splits], "{volume}");
        }
    }
}
