//! The first surfaces that rays of a fan meet, while they are searched.

use glam::Vec3A;

use super::fan::Fan;
use super::lanes::{LANES, Lanes};
use super::patch::Patch;

/// Depth within which surfaces are layers of one, meters along the ray: sweeps and devices differ by
/// centimeters, and the first of several layers is nearer than their surface.
pub(super) const LAYERS_M: f32 = 0.2;

/// Where a ray meets a solid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hit {
    /// Number of the ray as given to the fan.
    pub(super) ray: usize,
    /// Distance along the ray, in lengths of its direction.
    pub(super) t: f64,
    /// Coarse class.
    pub(super) class: u8,
}

/// Rays of a fan, in its order. Distances are in lengths of the directions. A search can be started again.
#[derive(Default)]
pub(super) struct Search {
    /// Greatest distance; negative if the ray is not searched.
    far: Vec<f32>,
    /// How far layers behind the first surface may be; negative if the ray is not searched.
    last: Vec<f32>,
    /// The nearest surface, and its class.
    first: Vec<(f32, u8)>,
    met: Vec<Met>,
    /// Sums over the layers of a ray: of distances times points, and of points.
    sums: Vec<[f64; 2]>,
}

/// A piece of a surface that a ray meets.
struct Met {
    ray: usize,
    t: f32,
    points: u32,
}

impl Search {
    /// Starts a search up to a distance of each ray, in the order as given to the fan; rays of negative ones
    /// are not searched.
    pub(super) fn start(&mut self, fan: &Fan, far: &[f32]) {
        let rays = far.len();
        self.far.clear();
        self.far.extend(fan.order.iter().map(|number| far[*number as usize]));
        self.last.clear();
        let depth = |(far, length): (&f32, &f32)| if *far < 0.0 { -1.0 } else { far + LAYERS_M / length };
        self.last.extend(self.far.iter().zip(&fan.lengths).map(depth));
        self.last.resize(rays + LANES, -1.0);
        self.first.clear();
        self.first.resize(rays, (f32::INFINITY, 0));
        self.met.clear();
    }

    /// Returns whether a surface at a distance in meters may be the first one of some rays, or its layer.
    #[inline(always)]
    pub(super) fn is_open(&self, fan: &Fan, [start, end]: [usize; 2], near_m: f32) -> bool {
        let (last, lengths) = (&self.last[start..end], &fan.lengths[start..end]);
        last.iter().zip(lengths).any(|(last, length)| last * length >= near_m)
    }

    /// Lets a fan's rays from a point meet a patch.
    #[inline(always)]
    pub(super) fn meet(&mut self, patch: &Patch, origin: Vec3A, fan: &Fan, [start, end]: [usize; 2]) {
        for start in (start..end).step_by(LANES) {
            let [x, y, z] = &fan.directions;
            let directions = [Lanes::at(x, start), Lanes::at(y, start), Lanes::at(z, start)];
            let t: Lanes<LANES> = patch.meet(origin, directions);
            let met = t.at_most(Lanes::at(&self.last, start));
            if met == [false; LANES] {
                continue;
            }
            for i in (0..LANES).filter(|i| met[*i]) {
                let (t, ray) = (t.0[i], start + i);
                self.met.push(Met { ray, t, points: patch.points });
                if t <= self.far[ray] && t < self.first[ray].0 {
                    self.first[ray] = (t, patch.class);
                    self.last[ray] = t + LAYERS_M / fan.lengths[ray];
                }
            }
        }
    }

    /// Returns the first surfaces: the means of their layers, weighted by their numbers of points.
    pub(super) fn hits<'s>(&'s mut self, fan: &'s Fan) -> impl Iterator<Item = Hit> + use<'s> {
        self.sums.clear();
        self.sums.resize(self.first.len(), [0.0; 2]);
        for Met { ray, t, points } in &self.met {
            if *t <= self.first[*ray].0 + LAYERS_M / fan.lengths[*ray] {
                let (weight, sum) = (f64::from(*points), &mut self.sums[*ray]);
                *sum = [sum[0] + weight * f64::from(*t), sum[1] + weight];
            }
        }
        let hit = |((first, sum), number): ((&(f32, u8), &[f64; 2]), &u32)| {
            let (t, class) = *first;
            t.is_finite().then(|| Hit { ray: *number as usize, t: sum[0] / sum[1], class })
        };
        self.first.iter().zip(&self.sums).zip(&fan.order).filter_map(hit)
    }
}
