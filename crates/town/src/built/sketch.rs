//! Basic shapes that objects are assembled from.

use glam::{DVec2, DVec3};

use crate::mesh::{Mesh, Skin};

/// Vertical plane: `u` runs to the right as seen from outside, `v` up, `out` towards the viewer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wall {
    origin: DVec3,
    along: DVec3,
    out: DVec3,
    /// Length from its left to its right end, meters.
    pub(super) length: f64,
}

impl Wall {
    /// Creates a wall from its lower left and lower right corners, seen from outside.
    pub(super) fn new(left: DVec3, right: DVec3) -> Self {
        let along = (right - left).normalize_or(DVec3::X);
        Self { origin: left, along, out: along.cross(DVec3::Z), length: left.distance(right) }
    }

    /// Returns the point `u` along, `v` up and `out` in front.
    pub(super) fn at(&self, u: f64, v: f64, out: f64) -> DVec3 {
        self.origin + self.along * u + DVec3::Z * v + self.out * out
    }

    /// Returns the same plane with another origin.
    pub(super) fn moved(&self, u: f64, v: f64, out: f64) -> Self {
        Self { origin: self.at(u, v, out), ..*self }
    }

    /// Adds a vertical rectangle; its pattern is continuous across all rectangles of the wall.
    pub(super) fn quad(&self, mesh: &mut Mesh, u: [f64; 2], v: [f64; 2], out: f64, skin: Skin) {
        if u[1] - u[0] > 1e-6 && v[1] - v[0] > 1e-6 {
            self.shape(mesh, &[[u[0], v[0]], [u[1], v[0]], [u[1], v[1]], [u[0], v[1]]], out, skin);
        }
    }

    /// Adds a vertical convex polygon in `u` and `v`, counter-clockwise, with the pattern of [`Wall::quad`].
    pub(super) fn shape(&self, mesh: &mut Mesh, corners: &[[f64; 2]], out: f64, skin: Skin) {
        let corner = |[u, v]: &[f64; 2]| (self.at(*u, *v, out), self.out, DVec2::new(*u, *v));
        mesh.fan(&corners.iter().map(corner).collect::<Vec<_>>(), skin);
    }

    /// Adds a convex polygon in `u`, `v` and `out`, counter-clockwise seen from outside.
    pub(super) fn polygon(&self, mesh: &mut Mesh, corners: &[[f64; 3]], skin: Skin) {
        let corners: Vec<DVec3> = corners.iter().map(|[u, v, out]| self.at(*u, *v, *out)).collect();
        mesh.polygon(&corners, skin);
    }

    /// Adds a block in front of the wall, without its back.
    pub(super) fn slab(&self, mesh: &mut Mesh, u: [f64; 2], v: [f64; 2], out: [f64; 2], skin: Skin) {
        self.shelf(mesh, u, v, out, skin);
        let ([a, b], [low, high], [back, front]) = (u, v, out);
        self.polygon(mesh, &[[a, low, back], [a, low, front], [a, high, front], [a, high, back]], skin);
        self.polygon(mesh, &[[b, low, front], [b, low, back], [b, high, back], [b, high, front]], skin);
    }

    /// Adds a [`Wall::slab`] without its ends.
    pub(super) fn shelf(&self, mesh: &mut Mesh, u: [f64; 2], v: [f64; 2], out: [f64; 2], skin: Skin) {
        let ([a, b], [low, high], [back, front]) = (u, v, out);
        self.quad(mesh, u, v, front, skin);
        self.polygon(mesh, &[[a, high, front], [b, high, front], [b, high, back], [a, high, back]], skin);
        self.polygon(mesh, &[[a, low, back], [b, low, back], [b, low, front], [a, low, front]], skin);
    }

    /// Adds the sides and the top of a hole, from the plane inward.
    pub(super) fn reveal(&self, mesh: &mut Mesh, u: [f64; 2], v: [f64; 2], depth: f64, skin: Skin) {
        let ([a, b], [low, high], back) = (u, v, -depth);
        self.polygon(mesh, &[[a, low, 0.0], [a, low, back], [a, high, back], [a, high, 0.0]], skin);
        self.polygon(mesh, &[[b, low, back], [b, low, 0.0], [b, high, 0.0], [b, high, back]], skin);
        self.polygon(mesh, &[[a, high, back], [b, high, back], [b, high, 0.0], [a, high, 0.0]], skin);
    }
}

/// Adds a round bar between two points with a radius at each end; ends with a radius above 0 are closed.
pub(super) fn bar(mesh: &mut Mesh, ends: [DVec3; 2], radii: [f64; 2], sides: usize, skin: Skin) {
    let axis = (ends[1] - ends[0]).normalize_or(DVec3::Z);
    let (x, y) = axis.any_orthonormal_pair();
    let length = ends[0].distance(ends[1]);
    let direction = |i: usize| {
        let angle = std::f64::consts::TAU * i as f64 / sides as f64;
        x * angle.cos() + y * angle.sin()
    };
    let around = std::f64::consts::TAU * radii[0].max(radii[1]) / sides as f64;
    for i in 0..sides {
        let (a, b) = (direction(i), direction(i + 1));
        let u = [around * i as f64, around * (i + 1) as f64];
        let corners = [
            (ends[0] + a * radii[0], a, DVec2::new(u[0], 0.0)),
            (ends[0] + b * radii[0], b, DVec2::new(u[1], 0.0)),
            (ends[1] + b * radii[1], b, DVec2::new(u[1], length)),
            (ends[1] + a * radii[1], a, DVec2::new(u[0], length)),
        ];
        mesh.fan(if radii[1] > 0.0 { &corners } else { &corners[..3] }, skin);
    }
    let ring = |end: usize| (0..sides).map(move |i| ends[end] + direction(i) * radii[end]);
    if radii[1] > 0.0 {
        mesh.polygon(&ring(1).collect::<Vec<_>>(), skin);
    }
    if radii[0] > 0.0 {
        mesh.polygon(&ring(0).rev().collect::<Vec<_>>(), skin);
    }
}

/// Adds a vertical disc that faces `out`.
pub(super) fn disc(mesh: &mut Mesh, centre: DVec3, out: DVec3, radius: f64, sides: usize, skin: Skin) {
    let across = DVec3::Z.cross(out).normalize_or(DVec3::X);
    let up = out.cross(across);
    let turn = std::f64::consts::PI / sides as f64;
    let corner = |i: usize| {
        let angle = turn * (2 * i + 1) as f64 - std::f64::consts::FRAC_PI_2;
        centre + (across * angle.cos() + up * angle.sin()) * radius
    };
    mesh.polygon(&(0..sides).map(corner).collect::<Vec<_>>(), skin);
}

/// Adds an upright block over four corners on the ground, counter-clockwise seen from above, without its
/// underside.
pub(super) fn column(mesh: &mut Mesh, corners: [DVec2; 4], z: [f64; 2], skin: Skin) {
    for i in 0..4 {
        let wall = Wall::new(corners[i].extend(0.0), corners[(i + 1) % 4].extend(0.0));
        wall.quad(mesh, [0.0, wall.length], z, 0.0, skin);
    }
    mesh.polygon(&corners.map(|p| p.extend(z[1])), skin);
}

/// Returns the four corners of an axis-aligned rectangle, counter-clockwise.
pub(super) fn corners(min: DVec2, max: DVec2) -> [DVec2; 4] {
    [min, DVec2::new(max.x, min.y), max, DVec2::new(min.x, max.y)]
}
