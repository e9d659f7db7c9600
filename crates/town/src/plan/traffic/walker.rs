use glam::{DVec2, DVec3};
use point_skeleton::geometry::{Footprint, Polyline, Pose};

use super::footprint::on_path;
use super::world::{STEP_S, World};
use crate::model::Body;
use crate::plan::{JunctionKind, KERB_M, Network};

/// Acceleration and deceleration of walkers, m/s².
const STEPPING_MPS2: f64 = 2.5;
/// Look-ahead for walkers that have precedence (those earlier in the list), and for all walkers, meters.
const SIGHT_M: f64 = 0.7;
const SIGHT_FIRST_M: f64 = 0.25;
/// Minimum gap to other walkers, meters.
const ROOM_M: f64 = 0.08;
/// Distance over which walkers turn around corners, meters.
const TURN_M: f64 = 1.0;
/// Distance over which a kerb is stepped on, meters.
const RAMP_M: f64 = 0.5;
/// Distance of waiting walkers from the kerb, meters.
const WAIT_M: f64 = 0.6;

/// Simulated pedestrian.
#[derive(Clone, Debug)]
pub(super) struct Walker {
    pub(super) body: Body,
    pub(super) size_m: DVec2,
    pub(super) path: Polyline,
    /// Position along the path, meters.
    pub(super) along_m: f64,
    pub(super) speed_mps: f64,
    pub(super) pace_mps: f64,
    pub(super) crossing: Option<CrossingState>,
}

/// Crossing of a road by a walker.
#[derive(Clone, Copy, Debug)]
pub(super) struct CrossingState {
    /// Indices of the crossing and of its junction.
    pub(super) crossing: usize,
    pub(super) junction: usize,
    /// Positions where the walker steps off one kerb and onto the other, meters along the path.
    pub(super) kerbs_m: [f64; 2],
    /// Whether the walker is on the crossing.
    pub(super) walks: bool,
}

impl Walker {
    pub(super) fn rect_at(&self, along_m: f64) -> Footprint {
        on_path(&self.path, along_m, TURN_M, self.size_m)
    }

    /// Returns the pose on the ground below the middle.
    pub(super) fn pose(&self) -> Pose {
        let rect = self.rect_at(self.along_m);
        let high = self.crossing.map_or(1.0, |over| {
            let [off_m, on_m] = over.kerbs_m;
            let ramp = |m: f64| (m / RAMP_M + 0.5).clamp(0.0, 1.0);
            ramp(off_m - self.along_m).max(ramp(self.along_m - on_m))
        });
        Pose::from_yaw(rect.forward.to_angle(), rect.center.extend(0.0) + DVec3::Z * (KERB_M * high))
    }

    /// Returns the speed limit from the road ahead, m/s: the walker waits at the kerb until the road is free.
    fn wait_mps(&mut self, world: &mut World<'_>) -> f64 {
        let Some(over) = &mut self.crossing else { return f64::INFINITY };
        let left_m = over.kerbs_m[0] - WAIT_M - self.along_m;
        if over.walks {
            if self.along_m > over.kerbs_m[1] + 1.0 {
                over.walks = false;
                world.walkers_on[over.crossing] -= 1;
            }
        } else if left_m < 0.5 && self.along_m < over.kerbs_m[1] {
            let takes_s = (over.kerbs_m[1] - over.kerbs_m[0] + 2.0) / self.pace_mps + 1.0;
            let road = world.lanes.network.crossings[over.crossing].road;
            let red_s = world.lanes.network.red_for_s(over.junction, road, world.t_s);
            let lit = world.lanes.network.junctions[over.junction].kind == JunctionKind::Signals;
            let allowed = !lit || red_s.is_some_and(|red_s| red_s > takes_s);
            if allowed && world.is_free(over.crossing) {
                over.walks = true;
                world.walkers_on[over.crossing] += 1;
            }
        }
        let on_road = over.walks || self.along_m > over.kerbs_m[0];
        if on_road { f64::INFINITY } else { (2.0 * STEPPING_MPS2 * left_m.max(0.0)).sqrt() }
    }
}

/// Advances all walkers by a step.
pub(super) fn step(walkers: &mut [Walker], world: &mut World<'_>) {
    let mut rects: Vec<Footprint> = walkers.iter().map(|walker| walker.rect_at(walker.along_m)).collect();
    for (i, walker) in walkers.iter_mut().enumerate() {
        let most_mps = walker.wait_mps(world).min(walker.pace_mps);
        let blocked = |along_m: f64, first: bool| {
            let rect = walker.rect_at(along_m).grown(ROOM_M);
            let others = rects.iter().enumerate().filter(|(k, _)| *k != i && (!first || *k < i));
            let met = others.filter(|(_, other)| rect.overlaps(other));
            // A walker that is already too near may walk on.
            met.into_iter()
                .any(|(k, _)| !rects[i].grown(ROOM_M).overlaps(&rects[k]) || along_m <= walker.along_m)
        };
        let sight_m = walker.along_m + SIGHT_M;
        let halts = blocked(sight_m, true) || blocked(walker.along_m + SIGHT_FIRST_M, false);
        let wanted = if halts { 0.0 } else { most_mps };
        let change = STEPPING_MPS2 * STEP_S;
        let speed = wanted.clamp(walker.speed_mps - change, walker.speed_mps + change).max(0.0);
        let speed = if blocked(walker.along_m + speed * STEP_S, false) { 0.0 } else { speed };
        walker.speed_mps = speed;
        walker.along_m += speed * STEP_S;
        rects[i] = walker.rect_at(walker.along_m);
    }
}

/// Returns the junction that a crossing belongs to.
pub(super) fn junction_of(network: &Network, crossing: usize) -> Option<usize> {
    let crossing = &network.crossings[crossing];
    let middle = (crossing.path[0] + crossing.path[1]) / 2.0;
    let ends = network.roads[crossing.road].junctions;
    let distance = |junction: &usize| {
        network.roads[crossing.road].mouth(*junction).map_or(f64::INFINITY, |mouth| mouth[0].distance(middle))
    };
    ends.into_iter().min_by(|a, b| distance(a).total_cmp(&distance(b)))
}
