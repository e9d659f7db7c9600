//! Round and chamfered solids built from rings; call [`Mesh::smooth`] at the end.

use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3};

use super::{Mesh, Skin};

/// Triangles with a smaller area are skipped, square meters.
const LEAST_AREA_M2: f64 = 2e-8;

/// Ellipse in space: `center + u cos t + v sin t`, meters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ring {
    /// Center.
    pub center: DVec3,
    /// First half axis.
    pub u: DVec3,
    /// Second half axis.
    pub v: DVec3,
}

impl Ring {
    /// Returns a circle perpendicular to a unit axis.
    pub fn circle(center: DVec3, axis: DVec3, radius: f64) -> Self {
        let u = if axis.y.abs() < 0.9 { DVec3::Y } else { DVec3::Z };
        let u = (u - axis * u.dot(axis)).normalize_or_zero();
        Self { center, u: u * radius, v: axis.cross(u) * radius }
    }

    /// Returns a horizontal ellipse.
    pub fn level(center: DVec3, half_x: f64, half_y: f64) -> Self {
        Self { center, u: DVec3::X * half_x, v: DVec3::Y * half_y }
    }

    /// Returns points on the ring, counter-clockwise seen from the side that `u × v` points to.
    pub fn corners(&self, segments: usize) -> impl Iterator<Item = DVec3> {
        (0..segments).map(move |i| {
            let (sin, cos) = (TAU * i as f64 / segments as f64).sin_cos();
            self.center + self.u * cos + self.v * sin
        })
    }

    /// Returns half the extent along each axis.
    pub fn half_extent(&self) -> DVec3 {
        (self.u * self.u + self.v * self.v).map(f64::sqrt)
    }
}

impl Mesh {
    /// Adds a quad that need not be planar, counter-clockwise seen from outside, split along its shorter
    /// diagonal. `uv` are the coordinates of its corners. Degenerate triangles are skipped.
    pub fn quad(&mut self, corners: [DVec3; 4], uv: [DVec2; 4], skin: Skin) {
        let shorter = corners[0].distance_squared(corners[2]) <= corners[1].distance_squared(corners[3]);
        let halves = if shorter { [[0, 1, 2], [0, 2, 3]] } else { [[0, 1, 3], [1, 2, 3]] };
        for half in halves {
            let [a, b, c] = half.map(|i| corners[i].as_vec3().as_dvec3());
            let area = (b - a).cross(c - a) / 2.0;
            if area.length() > LEAST_AREA_M2 {
                let normal = area.normalize();
                self.fan(&half.map(|i| (corners[i], normal, uv[i])), skin);
            }
        }
    }

    /// Adds the surface through lines with the same number of points. Seen from outside, the second line is
    /// to the left of the first. `skin` takes the indices of line and point; `None` leaves a hole.
    pub fn loft(&mut self, lines: &[impl AsRef<[DVec3]>], skin: impl Fn(usize, usize) -> Option<Skin>) {
        let mut across = vec![0.0; lines.first().map_or(0, |l| l.as_ref().len())];
        for (i, pair) in lines.windows(2).enumerate() {
            let [a, b] = [pair[0].as_ref(), pair[1].as_ref()];
            let mut along = 0.0;
            for j in 0..across.len().min(a.len()).min(b.len()).saturating_sub(1) {
                let next = along + a[j].distance(a[j + 1]);
                let (v, next_v) = (across[j], across[j + 1]);
                let (w, next_w) = (v + a[j].distance(b[j]), next_v + a[j + 1].distance(b[j + 1]));
                if let Some(skin) = skin(i, j) {
                    let uv = [(along, v), (next, next_v), (next, next_w), (along, w)].map(DVec2::from);
                    self.quad([a[j], a[j + 1], b[j + 1], b[j]], uv, skin);
                }
                along = next;
            }
            (0..across.len().min(a.len()).min(b.len())).for_each(|j| across[j] += a[j].distance(b[j]));
        }
    }

    /// Adds the surface through rings, open at both ends. The axes `u × v` must point from each ring towards
    /// the next. `skin` takes the indices of ring and segment.
    pub fn sleeve(&mut self, rings: &[Ring], segments: usize, skin: impl Fn(usize, usize) -> Skin) {
        let line = |ring: &Ring| -> Vec<DVec3> {
            let mut line: Vec<DVec3> = ring.corners(segments).collect();
            line.extend(line.first().copied());
            line
        };
        let lines: Vec<Vec<DVec3>> = rings.iter().map(line).collect();
        self.loft(&lines, |i, j| Some(skin(i, j)));
    }

    /// Adds the surface of [`Mesh::sleeve`], closed with flat caps at both ends.
    pub fn tube(&mut self, rings: &[Ring], segments: usize, skin: impl Fn(usize, usize) -> Skin) {
        let [first, .., last] = rings else { return };
        let lid = |ring: &Ring| Ring { u: DVec3::ZERO, v: DVec3::ZERO, ..*ring };
        let closed: Vec<Ring> =
            std::iter::once(lid(first)).chain(rings.iter().copied()).chain([lid(last)]).collect();
        self.sleeve(&closed, segments, |i, j| skin(i.clamp(1, rings.len() - 1) - 1, j));
    }

    /// Adds a body of revolution. `profile` has the radius and the distance along a unit `axis` from `base`,
    /// meters, from its far side over the rim to its near side. `skin` takes the indices of profile point and
    /// segment.
    pub fn lathe(
        &mut self,
        (base, axis): (DVec3, DVec3),
        profile: &[[f64; 2]],
        segments: usize,
        skin: impl Fn(usize, usize) -> Skin,
    ) {
        let ring = |[radius, along]: &[f64; 2]| Ring::circle(base + axis * *along, axis, *radius);
        let rings: Vec<Ring> = profile.iter().map(ring).collect();
        self.sleeve(&rings, segments, skin);
    }

    /// Adds a cylinder or a truncated cone with a radius at each end.
    pub fn cylinder(&mut self, from: DVec3, to: DVec3, radii: [f64; 2], segments: usize, skin: Skin) {
        let axis = (to - from).normalize_or_zero();
        let rings = [Ring::circle(from, axis, radii[0]), Ring::circle(to, axis, radii[1])];
        self.tube(&rings, segments, |_, _| skin);
    }

    /// Adds an ellipsoid with `rings` latitude bands.
    pub fn ellipsoid(&mut self, center: DVec3, radii: DVec3, [rings, segments]: [usize; 2], skin: Skin) {
        let ring = |i: usize| {
            let (sin, cos) = (PI * i as f64 / rings as f64).sin_cos();
            let sin = if i == rings { 0.0 } else { sin };
            Ring::level(center - DVec3::Z * radii.z * cos, radii.x * sin, radii.y * sin)
        };
        self.sleeve(&(0..=rings).map(ring).collect::<Vec<_>>(), segments, |_, _| skin);
    }

    /// Adds a box with edges chamfered by `chamfer` meters, at most half its shortest side.
    pub fn chamfered(&mut self, min: DVec3, max: DVec3, chamfer: f64, skin: Skin) {
        let (center, half) = ((min + max) / 2.0, (max - min) / 2.0);
        let cut = half - DVec3::splat(chamfer.min(half.min_element()));
        // The corner in the side perpendicular to `axis`, in the octant given by the signs.
        let at = |signs: DVec3, axis: usize| {
            let mut p = cut * signs;
            p[axis] = half[axis] * signs[axis];
            center + p
        };
        let mut face = |corners: &[DVec3]| {
            let outward = corners.iter().sum::<DVec3>() / corners.len() as f64 - center;
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
            let mut corners = corners.to_vec();
            if normal.dot(outward) < 0.0 {
                corners.reverse();
            }
            if normal.length() > 4.0 * LEAST_AREA_M2 {
                self.polygon(&corners, skin);
            }
        };
        let signs = |axis: usize, s: f64, t: f64, r: f64| {
            let mut v = DVec3::splat(s);
            v[(axis + 1) % 3] = t;
            v[(axis + 2) % 3] = r;
            v
        };
        let around = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        for axis in 0..3 {
            for side in [-1.0, 1.0] {
                face(&around.map(|(t, r)| at(signs(axis, side, t, r), axis)));
            }
            // The chamfers parallel to this axis lie between the sides perpendicular to the other two.
            for (t, r) in around {
                let [low, high] = [signs(axis, -1.0, t, r), signs(axis, 1.0, t, r)];
                let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
                face(&[at(low, a), at(high, a), at(high, b), at(low, b)]);
            }
        }
        for bits in 0..8 {
            let sign = |axis: usize| if bits >> axis & 1 == 1 { 1.0 } else { -1.0 };
            let corner = DVec3::new(sign(0), sign(1), sign(2));
            face(&[at(corner, 0), at(corner, 1), at(corner, 2)]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Surface;
    use super::*;

    const SKIN: Skin = Skin::new([9; 3], Surface::Plain);

    fn volume(mesh: &Mesh) -> f64 {
        mesh.triangles.iter().map(|t| mesh.corners(*t)).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
    }

    /// Asserts that every edge occurs once in each direction.
    fn assert_closed(mesh: &Mesh) {
        let mut edges = std::collections::HashMap::new();
        for triangle in &mesh.triangles {
            let p = triangle.map(|i| mesh.vertices[i as usize].position.map(|v| (v + 0.0).to_bits()));
            for (a, b) in [(0, 1), (1, 2), (2, 0)] {
                *edges.entry((p[a], p[b])).or_insert(0) += 1;
            }
        }
        for ((a, b), times) in &edges {
            assert_eq!((*times, edges.get(&(*b, *a))), (1, Some(&1)));
        }
    }

    #[test]
    fn round_solids_are_closed_with_correct_volume() {
        let at = DVec3::new(0.3, -2.0, 5.0);
        type Build<'a> = &'a dyn Fn(&mut Mesh);
        let solids: [(Build, f64, f64); 4] = [
            (
                &|m| m.cylinder(at, at + DVec3::new(1.0, 2.0, 2.0), [0.5, 0.5], 64, SKIN),
                PI * 0.25 * 3.0,
                0.002,
            ),
            (&|m| m.cylinder(at, at + DVec3::Y * 3.0, [0.5, 0.0], 64, SKIN), PI * 0.25, 0.002),
            (&|m| m.ellipsoid(at, DVec3::new(1.0, 2.0, 0.5), [48, 64], SKIN), PI * 4.0 / 3.0, 0.004),
            // Minus the wedges of twelve edges and eight corners.
            (
                &|m| m.chamfered(DVec3::ZERO, DVec3::new(2.0, 3.0, 4.0), 0.1, SKIN),
                24.0 - 4.0 * 0.005 * (1.8 + 2.8 + 3.8) - 8.0 * (0.001 * 5.0 / 6.0),
                1e-6,
            ),
        ];
        for (build, expected, share) in solids {
            let mut mesh = Mesh::default();
            build(&mut mesh);
            assert_closed(&mesh);
            assert!((volume(&mesh) / expected - 1.0).abs() < share, "{} {expected}", volume(&mesh));
        }
    }

    #[test]
    fn smooth_normals_match_the_sphere_and_edges_stay_sharp() {
        let mut ball = Mesh::default();
        ball.ellipsoid(DVec3::ZERO, DVec3::ONE, [24, 32], SKIN);
        ball.smooth(0.7);
        for vertex in &ball.vertices {
            let [p, n] = [vertex.position, vertex.normal].map(glam::Vec3::from);
            assert!(n.dot(p) > 0.999, "{p} {n}");
        }
        let mut block = Mesh::default();
        block.block(DVec3::NEG_ONE, DVec3::ONE, SKIN);
        let before = block.clone();
        block.smooth(0.7);
        let normals = |m: &Mesh| {
            let all = m.triangles.iter().map(|t| t.map(|i| m.vertices[i as usize].normal));
            all.collect::<Vec<_>>()
        };
        assert_eq!(normals(&block), normals(&before));
    }

    #[test]
    fn fitting_keeps_normals_perpendicular() {
        let mut ball = Mesh::default();
        ball.ellipsoid(DVec3::ZERO, DVec3::ONE, [64, 96], SKIN);
        ball.smooth(0.7);
        let to = [DVec3::new(-2.0, -1.0, 0.0), DVec3::new(2.0, 1.0, 1.0)];
        ball.fit([DVec3::NEG_ONE, DVec3::ONE], to);
        let center = DVec3::new(0.0, 0.0, 0.5);
        for vertex in &ball.vertices {
            let [p, n] = [vertex.position, vertex.normal].map(|v| glam::Vec3::from(v).as_dvec3());
            // The gradient of the ellipsoid's equation.
            let expected = ((p - center) / DVec3::new(4.0, 1.0, 0.25)).normalize();
            assert!(n.dot(expected) > 0.999);
        }
    }
}
