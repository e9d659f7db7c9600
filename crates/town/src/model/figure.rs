//! Bodies built from rings: people and bicycles.

use glam::DVec3;

use crate::mesh::{Mesh, Ring, Skin};

/// Tube with closed ends.
#[derive(Clone, Debug)]
pub(super) struct Tube {
    pub(super) rings: Vec<Ring>,
    pub(super) segments: usize,
    pub(super) skin: Skin,
}

/// Figure made of closed tubes, and of rings that are open in the middle (wheels).
#[derive(Clone, Debug, Default)]
pub(super) struct Figure {
    pub(super) tubes: Vec<Tube>,
    /// Their first ring is also the last one.
    pub(super) loops: Vec<Tube>,
}

impl Figure {
    /// Adds a limb through joints, each with its radius, rounded at both ends.
    pub(super) fn limb(&mut self, joints: &[(DVec3, f64)], segments: usize, skin: Skin) {
        let [(first, first_radius), .., (last, last_radius)] = joints else { return };
        let towards = |a: DVec3, b: DVec3| (b - a).normalize_or_zero();
        let start = towards(*first, joints[1].0);
        let end = towards(joints[joints.len() - 2].0, *last);
        let mut rings = vec![Ring::circle(*first - start * 0.75 * *first_radius, start, 0.62 * first_radius)];
        for (i, (at, radius)) in joints.iter().enumerate() {
            let before = i.checked_sub(1).map_or(start, |b| towards(joints[b].0, *at));
            let after = joints.get(i + 1).map_or(end, |next| towards(*at, next.0));
            rings.push(Ring::circle(*at, (before + after).normalize_or_zero(), *radius));
        }
        rings.push(Ring::circle(*last + end * 0.75 * *last_radius, end, 0.62 * last_radius));
        self.tubes.push(Tube { rings, segments, skin });
    }

    /// Adds a straight rod.
    pub(super) fn rod(&mut self, from: DVec3, to: DVec3, radius: f64, skin: Skin) {
        let axis = (to - from).normalize_or_zero();
        let rings = vec![Ring::circle(from, axis, radius), Ring::circle(to, axis, radius)];
        self.tubes.push(Tube { rings, segments: 4, skin });
    }

    /// Adds an ellipsoid with the vertical axis `up` (a unit vector perpendicular to y).
    pub(super) fn ball(&mut self, center: DVec3, radii: DVec3, up: DVec3, skin: Skin) {
        let ahead = DVec3::Y.cross(up);
        let ring = |i: usize| {
            let (sin, cos) = (std::f64::consts::PI * (i as f64 + 0.35) / 6.7).sin_cos();
            let center = center - up * radii.z * cos / 0.987;
            Ring { center, u: ahead * radii.x * sin, v: DVec3::Y * radii.y * sin }
        };
        self.tubes.push(Tube { rings: (0..=6).map(ring).collect(), segments: 10, skin });
    }

    /// Adds rings along a bent spine in the plane y = 0: center, half depth and half width of each.
    pub(super) fn trunk(&mut self, spine: &[(DVec3, f64, f64)], segments: usize, skin: Skin) {
        let last = spine.len().saturating_sub(1);
        let ring = |(i, (center, depth, width)): (usize, &(DVec3, f64, f64))| {
            let along = (spine[(i + 1).min(last)].0 - spine[i.saturating_sub(1)].0).normalize_or_zero();
            Ring { center: *center, u: DVec3::Y.cross(along) * *depth, v: DVec3::Y * *width }
        };
        self.tubes.push(Tube { rings: spine.iter().enumerate().map(ring).collect(), segments, skin });
    }

    /// Adds a ring of revolution around an axis to the left. `profile` has radius and distance along the
    /// axis, far side first; its last point equals the first.
    pub(super) fn revolve(&mut self, hub: DVec3, profile: &[[f64; 2]], segments: usize, skin: Skin) {
        let ring = |[radius, along]: &[f64; 2]| Ring::circle(hub + DVec3::Y * *along, DVec3::Y, *radius);
        self.loops.push(Tube { rings: profile.iter().map(ring).collect(), segments, skin });
    }

    /// Scales the whole figure.
    pub(super) fn scale(&mut self, by: f64) {
        let tubes = self.tubes.iter_mut().chain(&mut self.loops);
        for ring in tubes.flat_map(|t| &mut t.rings) {
            *ring = Ring { center: ring.center * by, u: ring.u * by, v: ring.v * by };
        }
    }

    /// Moves the whole figure.
    pub(super) fn shift(&mut self, by: DVec3) {
        let tubes = self.tubes.iter_mut().chain(&mut self.loops);
        tubes.flat_map(|t| &mut t.rings).for_each(|ring| ring.center += by);
    }

    /// Returns the min and max coordinates of its rings, meters.
    pub(super) fn bounds(&self) -> [DVec3; 2] {
        let rings = self.tubes.iter().chain(&self.loops).flat_map(|t| &t.rings);
        let boxes = rings.map(|r| [r.center - r.half_extent(), r.center + r.half_extent()]);
        boxes.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]).unwrap_or_default()
    }

    /// Returns the min and max coordinates of its triangles, meters.
    pub(super) fn corner_bounds(&self) -> [DVec3; 2] {
        let tubes = self.tubes.iter().chain(&self.loops);
        let corners = tubes.flat_map(|t| t.rings.iter().flat_map(|ring| ring.corners(t.segments)));
        let boxes = corners.map(|p| [p, p]).reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
        boxes.unwrap_or_default()
    }

    /// Returns its triangles.
    pub(super) fn mesh(&self) -> Mesh {
        let mut mesh = Mesh::default();
        self.tubes.iter().for_each(|t| mesh.tube(&t.rings, t.segments, |_, _| t.skin));
        self.loops.iter().for_each(|t| mesh.sleeve(&t.rings, t.segments, |_, _| t.skin));
        mesh.smooth(1.0);
        mesh
    }
}

/// Returns the joint between two limbs of the given lengths from `from` to `to`, bent towards `bend`. If the
/// limbs are too short, it is on the line between them.
pub(super) fn joint(from: DVec3, to: DVec3, lengths: [f64; 2], bend: DVec3) -> DVec3 {
    let (away, distance) = ((to - from).normalize_or_zero(), from.distance(to));
    let [a, b] = lengths;
    let along = ((a * a - b * b + distance * distance) / (2.0 * distance.max(1e-6))).clamp(-a, a);
    let off = (a * a - along * along).max(0.0).sqrt();
    let side = (bend - away * bend.dot(away)).normalize_or_zero();
    from + away * along + side * off
}
