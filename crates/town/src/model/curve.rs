//! Outlines with rounded corners.

/// Corner of an outline: position, height, and distance from it at which the rounding starts, meters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Corner {
    pub(super) x: f64,
    pub(super) z: f64,
    pub(super) round: f64,
}

/// Height as a piecewise linear function of `x`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Curve {
    points: Vec<[f64; 2]>,
}

/// Segments of a rounded corner.
const PIECES: usize = 3;

impl Curve {
    /// Creates a curve through corners sorted by `x`, each rounded by a parabola.
    pub(super) fn new(corners: &[Corner]) -> Self {
        let mut points = Vec::new();
        for (i, corner) in corners.iter().enumerate() {
            let at = [corner.x, corner.z];
            let (Some(before), Some(after)) = (i.checked_sub(1).map(|b| corners[b]), corners.get(i + 1))
            else {
                points.push(at);
                continue;
            };
            let towards = |other: &Corner| {
                let away = (other.x - corner.x).hypot(other.z - corner.z);
                let share = (corner.round / away).min(0.48);
                [corner.x + (other.x - corner.x) * share, corner.z + (other.z - corner.z) * share]
            };
            let (from, to) = (towards(&before), towards(after));
            points.extend((0..=PIECES).map(|piece| {
                let t = piece as f64 / PIECES as f64;
                let (a, b, c) = ((1.0 - t) * (1.0 - t), 2.0 * t * (1.0 - t), t * t);
                [0, 1].map(|k| a * from[k] + b * at[k] + c * to[k])
            }));
        }
        points.dedup_by(|a, b| a[0] - b[0] < 1e-6);
        Self { points }
    }

    /// Returns the height at `x`, clamped to the end points.
    pub(super) fn at(&self, x: f64) -> f64 {
        let next = self.points.partition_point(|p| p[0] < x);
        let Some([x1, z1]) = self.points.get(next) else { return self.points.last().map_or(0.0, |p| p[1]) };
        let Some([x0, z0]) = next.checked_sub(1).map(|i| self.points[i]) else { return *z1 };
        z0 + (z1 - z0) * (x - x0) / (x1 - x0)
    }

    /// Returns the `x` of its points.
    pub(super) fn bends(&self) -> impl Iterator<Item = f64> {
        self.points.iter().map(|p| p[0])
    }
}
