//! Solids that rays can hit: convex polyhedra, ellipsoids, cylinders. Lengths in metres.

use glam::DVec3;

/// A half line; `dir` need not be a unit vector, distances count in its length.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    pub(super) origin: DVec3,
    pub(super) dir: DVec3,
}

impl Ray {
    pub(super) fn at(&self, t: f64) -> DVec3 {
        self.origin + self.dir * t
    }
}

/// A solid.
#[derive(Clone, Debug)]
pub(super) enum Shape {
    /// The points with `normal · p ≤ offset` for all planes, and its bounds.
    Convex { planes: Vec<(DVec3, f64)>, bounds: Aabb },
    /// Axis-aligned ellipsoid.
    Ellipsoid { center: DVec3, radii: DVec3 },
    /// From `from` to `to`, capped.
    Cylinder { from: DVec3, to: DVec3, radius: f64 },
}

/// Axis-aligned bounds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Aabb {
    pub(super) min: DVec3,
    pub(super) max: DVec3,
}

/// The part of a ray inside of planes and its normal at the entry, while planes cut it.
struct Span {
    enter: f64,
    leave: f64,
    normal: DVec3,
}

impl Shape {
    /// An upright box from corner to corner.
    pub(super) fn block(min: DVec3, max: DVec3) -> Self {
        let planes = vec![
            (DVec3::X, max.x),
            (DVec3::NEG_X, -min.x),
            (DVec3::Y, max.y),
            (DVec3::NEG_Y, -min.y),
            (DVec3::Z, max.z),
            (DVec3::NEG_Z, -min.z),
        ];
        Self::Convex { planes, bounds: Aabb { min, max } }
    }

    /// A convex side profile (x, z), counter-clockwise seen from the right (-y), as wide as `2·half_width` at
    /// height `z_wide` and narrower by `taper` (metres per metre and side) above.
    pub(super) fn profile(points: &[[f64; 2]], half_width: f64, z_wide: f64, taper: f64) -> Self {
        let mut planes = Vec::new();
        let mut bounds = Aabb::EMPTY;
        for (i, &[x0, z0]) in points.iter().enumerate() {
            let [x1, z1] = points[(i + 1) % points.len()];
            let normal = DVec3::new(z1 - z0, 0.0, x0 - x1).normalize();
            planes.push((normal, normal.dot(DVec3::new(x0, 0.0, z0))));
            let side = half_width - taper * (z0 - z_wide);
            bounds = bounds.with(DVec3::new(x0, side, z0)).with(DVec3::new(x0, -side, z0));
        }
        for side in [1.0, -1.0] {
            let normal = DVec3::new(0.0, side, taper).normalize();
            planes.push((normal, normal.dot(DVec3::new(0.0, side * half_width, z_wide))));
        }
        Self::Convex { planes, bounds }
    }

    /// Its bounds.
    pub(super) fn bounds(&self) -> Aabb {
        match self {
            Self::Convex { bounds, .. } => *bounds,
            Self::Ellipsoid { center, radii } => Aabb { min: center - radii, max: center + radii },
            Self::Cylinder { from, to, radius } => {
                let axis = (to - from).normalize();
                let reach = (DVec3::ONE - axis * axis).max(DVec3::ZERO).map(f64::sqrt) * *radius;
                Aabb { min: from.min(*to) - reach, max: from.max(*to) + reach }
            }
        }
    }

    /// Distance and outward normal (not normalized) where a ray from outside enters.
    pub(super) fn hit(&self, ray: &Ray) -> Option<(f64, DVec3)> {
        match self {
            Self::Convex { planes, .. } => {
                let mut span = Span { enter: 0.0, leave: f64::INFINITY, normal: DVec3::ZERO };
                for (normal, offset) in planes {
                    span.cut(ray, *normal, *offset)?;
                }
                (span.enter > 0.0).then_some((span.enter, span.normal))
            }
            Self::Ellipsoid { center, radii } => {
                let (o, d) = ((ray.origin - center) / radii, ray.dir / radii);
                let (a, b, c) = (d.dot(d), o.dot(d), o.dot(o) - 1.0);
                let t = (-b - (b * b - a * c).max(0.0).sqrt()) / a;
                let outside = b * b > a * c && t > 0.0;
                outside.then(|| (t, (ray.at(t) - center) / (radii * radii)))
            }
            Self::Cylinder { from, to, radius } => {
                let length = (to - from).length();
                let axis = (to - from) / length;
                let mut span = Span { enter: 0.0, leave: f64::INFINITY, normal: DVec3::ZERO };
                span.cut(ray, axis, axis.dot(*to))?;
                span.cut(ray, -axis, -axis.dot(*from))?;
                let flat = |v: DVec3| v - axis * axis.dot(v);
                let (o, d) = (flat(ray.origin - from), flat(ray.dir));
                let (a, b, c) = (d.dot(d), o.dot(d), o.dot(o) - radius * radius);
                if b * b <= a * c {
                    return (a == 0.0 && c < 0.0 && span.enter > 0.0).then_some((span.enter, span.normal));
                }
                let root = (b * b - a * c).sqrt();
                if (-b - root) / a > span.enter {
                    span.enter = (-b - root) / a;
                    span.normal = flat(ray.at(span.enter) - from);
                }
                span.leave = span.leave.min((-b + root) / a);
                (span.enter > 0.0 && span.enter < span.leave).then_some((span.enter, span.normal))
            }
        }
    }
}

impl Span {
    /// Keeps what lies below a plane; `None` if nothing.
    fn cut(&mut self, ray: &Ray, normal: DVec3, offset: f64) -> Option<()> {
        let (along, height) = (normal.dot(ray.dir), normal.dot(ray.origin) - offset);
        if along == 0.0 {
            return (height <= 0.0).then_some(());
        }
        let t = -height / along;
        if along > 0.0 {
            self.leave = self.leave.min(t);
        } else if t > self.enter {
            self.enter = t;
            self.normal = normal;
        }
        (self.enter < self.leave).then_some(())
    }
}

impl Aabb {
    /// Holds nothing.
    pub(super) const EMPTY: Self = Self { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };

    /// Grown to hold a point.
    pub(super) fn with(self, point: DVec3) -> Self {
        Self { min: self.min.min(point), max: self.max.max(point) }
    }

    /// Holds both.
    pub(super) fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// The eight corners.
    pub(super) fn corners(&self) -> [DVec3; 8] {
        std::array::from_fn(|i| {
            let pick = |bit: usize, low: f64, high: f64| if i >> bit & 1 == 1 { high } else { low };
            DVec3::new(
                pick(0, self.min.x, self.max.x),
                pick(1, self.min.y, self.max.y),
                pick(2, self.min.z, self.max.z),
            )
        })
    }

    /// Whether a ray reaches it before `t_max`; `inverse` is `1 / dir`.
    pub(super) fn reached(&self, origin: DVec3, inverse: DVec3, t_max: f64) -> bool {
        let (a, b) = ((self.min - origin) * inverse, (self.max - origin) * inverse);
        let (enter, leave) = (a.min(b).max_element(), a.max(b).min_element());
        leave >= enter.max(0.0) && enter <= t_max
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_enter_where_the_surface_is() {
        let ray = Ray { origin: DVec3::new(-5.0, 0.2, 0.3), dir: DVec3::X };
        let block = Shape::block(DVec3::splat(-1.0), DVec3::ONE);
        assert_eq!(block.hit(&ray), Some((4.0, DVec3::NEG_X)));
        let ball = Shape::Ellipsoid { center: DVec3::ZERO, radii: DVec3::splat(2.0) };
        let (t, normal) = ball.hit(&ray).unwrap();
        assert!((ray.at(t).length() - 2.0).abs() < 1e-12 && normal.normalize().dot(ray.at(t) / 2.0) > 0.999);
        let pole = Shape::Cylinder { from: DVec3::NEG_Z, to: DVec3::Z, radius: 0.5 };
        let (t, _) = pole.hit(&ray).unwrap();
        assert!((ray.at(t).truncate().length() - 0.5).abs() < 1e-12);
        let above = Ray { origin: DVec3::new(0.1, 0.2, 9.0), dir: DVec3::NEG_Z };
        assert_eq!(pole.hit(&above), Some((8.0, DVec3::Z)));
        let away = Ray { origin: ray.origin, dir: DVec3::NEG_X };
        assert!([&block, &ball, &pole].iter().all(|s| s.hit(&away).is_none()));
    }

    #[test]
    fn a_profile_is_a_solid_within_its_bounds() {
        let roof = [[-1.0, 1.0], [-1.0, 0.0], [2.0, 0.0], [1.0, 1.0]];
        let shape = Shape::profile(&roof, 0.8, 0.0, 0.2);
        let bounds = shape.bounds();
        assert_eq!((bounds.min, bounds.max), (DVec3::new(-1.0, -0.8, 0.0), DVec3::new(2.0, 0.8, 1.0)));
        let down = |x: f64| shape.hit(&Ray { origin: DVec3::new(x, 0.0, 5.0), dir: DVec3::NEG_Z });
        assert_eq!(down(0.0).unwrap().0, 4.0);
        assert!((down(1.5).unwrap().0 - 4.5).abs() < 1e-12 && down(2.1).is_none());
    }
}
