use std::ops::Range;

use glam::DVec2;

use super::Cuboid;

/// Rectangular footprint of a box in bird's-eye view, meters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    /// Center, global.
    pub center: DVec2,
    /// Unit vector along the length.
    pub forward: DVec2,
    /// Half length and half width.
    pub half_m: DVec2,
}

impl From<&Cuboid> for Footprint {
    /// Uses the yaw of the box and ignores its tilt.
    fn from(cuboid: &Cuboid) -> Self {
        let forward = DVec2::from_angle(cuboid.pose.yaw_rad());
        Self { center: cuboid.pose.translation.truncate(), forward, half_m: cuboid.size.truncate() / 2.0 }
    }
}

impl Footprint {
    /// Returns the corners counter-clockwise: front left, rear left, rear right, front right.
    pub fn corners(&self) -> [DVec2; 4] {
        let (length, width) = (self.forward * self.half_m.x, self.forward.perp() * self.half_m.y);
        [length + width, width - length, -length - width, length - width].map(|arm| self.center + arm)
    }

    /// Transforms a point to the rectangle's axes: meters forward and to the left of its center.
    pub fn local(&self, point: DVec2) -> DVec2 {
        let arm = point - self.center;
        DVec2::new(self.forward.dot(arm), self.forward.perp_dot(arm))
    }

    /// Radius of the circumscribed circle, meters.
    pub fn radius_m(&self) -> f64 {
        self.half_m.length()
    }

    /// Returns the rectangle enlarged by `by_m` meters on all sides.
    pub fn grown(self, by_m: f64) -> Self {
        Self { half_m: self.half_m + by_m, ..self }
    }

    /// Returns whether two rectangles share more than an edge, by the separating axis theorem.
    pub fn overlaps(&self, other: &Self) -> bool {
        self.axes(other).into_iter().all(|axis| {
            let (reach_m, apart_m) = self.along(other, axis);
            apart_m.abs() < reach_m
        })
    }

    /// Returns the time interval while two rectangles overlap, with `other` moving at a velocity relative to
    /// `self` (meters per second) without turning. Seconds from now, may be negative or infinite. `None` if
    /// they never overlap.
    pub fn meets(&self, other: &Self, velocity: DVec2) -> Option<Range<f64>> {
        let mut times_s = f64::NEG_INFINITY..f64::INFINITY;
        for axis in self.axes(other) {
            let (reach_m, apart_m) = self.along(other, axis);
            let speed = velocity.dot(axis);
            if speed == 0.0 {
                if apart_m.abs() >= reach_m {
                    return None;
                }
                continue;
            }
            let (from_s, to_s) = ((-reach_m - apart_m) / speed, (reach_m - apart_m) / speed);
            times_s.start = times_s.start.max(from_s.min(to_s));
            times_s.end = times_s.end.min(from_s.max(to_s));
        }
        (times_s.start < times_s.end).then_some(times_s)
    }

    /// Returns the smallest local x (meters, along `self`) of the intersection with `other`; `None` if they
    /// do not overlap.
    pub fn first_contact_m(&self, other: &Self) -> Option<f64> {
        let mut shape: Vec<DVec2> = other.corners().iter().map(|corner| self.local(*corner)).collect();
        for (axis, half_m) in [(DVec2::X, self.half_m.x), (DVec2::Y, self.half_m.y)] {
            shape = clip(&shape, axis, half_m);
            shape = clip(&shape, -axis, half_m);
        }
        shape.iter().map(|p| p.x).reduce(f64::min)
    }

    fn axes(&self, other: &Self) -> [DVec2; 4] {
        [self.forward, self.forward.perp(), other.forward, other.forward.perp()]
    }

    /// Returns the sum of the half extents along an axis, and the distance of the centers along it, meters.
    fn along(&self, other: &Self, axis: DVec2) -> (f64, f64) {
        let half_m =
            |f: &Self| f.half_m.x * axis.dot(f.forward).abs() + f.half_m.y * axis.dot(f.forward.perp()).abs();
        (half_m(self) + half_m(other), axis.dot(other.center - self.center))
    }
}

/// Clips a convex shape at a distance along an axis (Sutherland and Hodgman).
fn clip(shape: &[DVec2], axis: DVec2, limit_m: f64) -> Vec<DVec2> {
    let mut retained = Vec::with_capacity(shape.len() + 1);
    for (i, &to) in shape.iter().enumerate() {
        let from = shape[(i + shape.len() - 1) % shape.len()];
        let (a, b) = (axis.dot(from) - limit_m, axis.dot(to) - limit_m);
        if (a < 0.0) != (b < 0.0) {
            retained.push(from.lerp(to, a / (a - b)));
        }
        if b < 0.0 {
            retained.push(to);
        }
    }
    retained
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn footprint(x: f64, y: f64, yaw: f64, length: f64, width: f64) -> Footprint {
        let half_m = DVec2::new(length, width) / 2.0;
        Footprint { center: DVec2::new(x, y), forward: DVec2::from_angle(yaw), half_m }
    }

    #[test]
    fn touching_is_not_overlapping() {
        let a = footprint(0.0, 0.0, 0.0, 4.0, 2.0);
        assert!(!a.overlaps(&footprint(4.0, 0.0, 0.0, 4.0, 2.0)));
        assert!(a.overlaps(&footprint(3.999, 0.0, 0.0, 4.0, 2.0)));
        // Corner next to corner: only the axes of the rotated box separate them.
        let turned = |x: f64| footprint(x, x - 1.0, std::f64::consts::FRAC_PI_4, 2.0, 2.0);
        assert!(!a.overlaps(&turned(2.71)) && a.overlaps(&turned(2.70)));
    }

    #[test]
    fn contacts_are_where_edges_cross() {
        let corridor = footprint(10.0, 0.0, 0.0, 20.0, 2.0);
        assert_eq!(corridor.first_contact_m(&footprint(15.0, 1.5, 0.0, 4.0, 2.0)), Some(3.0));
        assert_eq!(corridor.first_contact_m(&footprint(15.0, 2.5, 0.0, 4.0, 2.0)), None);
        // The box starts behind the corridor, so the contact is at the corridor's rear edge.
        assert_eq!(corridor.first_contact_m(&footprint(0.0, 0.0, 0.0, 4.0, 2.0)), Some(-10.0));
        // A rotated square reaches into the corridor with less than its full length.
        let diamond = footprint(15.0, 2.0, std::f64::consts::FRAC_PI_4, 2.0, 2.0);
        let reach = 5.0 - (2f64.sqrt() - 1.0);
        assert!((corridor.first_contact_m(&diamond).unwrap() - reach).abs() < 1e-12);
    }

    fn any() -> impl Strategy<Value = Footprint> {
        (-8.0..8.0, -8.0..8.0, -4.0..4.0, 0.5..6.0, 0.5..3.0)
            .prop_map(|(x, y, yaw, length, width)| footprint(x, y, yaw, length, width))
    }

    proptest! {
        #[test]
        fn three_ways_to_overlap_agree(a in any(), b in any()) {
            prop_assert_eq!(a.overlaps(&b), a.first_contact_m(&b).is_some());
            prop_assert_eq!(a.overlaps(&b), b.overlaps(&a));
            prop_assert_eq!(a.overlaps(&b), a.meets(&b, DVec2::ZERO).is_some());
        }

        #[test]
        fn meetings_are_overlaps_at_their_time(a in any(), b in any(), x in -9.0..9.0, y in -9.0..9.0,
        t in -3.0..3.0f64) {
            let velocity = DVec2::new(x, y);
            let moved = Footprint { center: b.center + velocity * t, ..b };
            let times = a.meets(&b, velocity);
            let to_edge = |r: &Range<f64>| (r.start - t).abs().min((r.end - t).abs());
            let edge = times.as_ref().is_some_and(|r| to_edge(r) < 1e-9);
            if !edge {
                prop_assert_eq!(a.overlaps(&moved), times.is_some_and(|r| r.contains(&t)));
            }
        }
    }
}
