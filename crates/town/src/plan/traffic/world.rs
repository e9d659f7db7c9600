//! Step-by-step simulation of the vehicles.
//!
//! # How it works
//! Every vehicle follows a route and needs a grant to enter a junction: until a path through it is granted,
//! the stop line ends its road. A path is granted if the light allows it, no vehicle is on a path that
//! crosses it, no pedestrian is on its crossings, and there is room behind the junction. On lanes, and on
//! paths with a common start, every vehicle follows the one in front.

use point_skeleton::idm::Leader;

use super::junction_path::{JunctionPath, STOP_M};
use super::lanes::{BEYOND_CROSSING_M, Lanes};
use super::route::BRAKING_MPS2;
use super::vehicle::Vehicle;
use crate::plan::{JunctionKind, Signal, Turn};

/// Duration of a step, seconds.
pub(super) const STEP_S: f64 = 0.1;
/// Maximum distance of a leader, meters.
const SIGHT_M: f64 = 60.0;
/// Waiting time after which a vehicle takes precedence, seconds.
const PATIENCE_S: f64 = 3.0;
/// Duration of the halt at a stop sign, seconds.
const HALT_S: f64 = 0.7;

/// State of all vehicles at one time.
pub(super) struct World<'a> {
    pub(super) lanes: &'a Lanes<'a>,
    pub(super) vehicles: Vec<Vehicle>,
    /// Number of walkers on each crossing.
    pub(super) walkers_on: Vec<usize>,
    /// Time, seconds.
    pub(super) t_s: f64,
}

/// Vehicles on each lane: position of the middle along it, meters, and index of the vehicle.
type Occupants = Vec<Vec<(f64, usize)>>;

impl<'a> World<'a> {
    pub(super) fn new(lanes: &'a Lanes<'a>, t_s: f64) -> Self {
        let walkers_on = vec![0; lanes.network.crossings.len()];
        Self { lanes, vehicles: Vec::new(), walkers_on, t_s }
    }

    /// Advances all vehicles by a step.
    pub(super) fn step(&mut self) {
        let occupants = self.occupants();
        self.revoke();
        self.grant(&occupants);
        let plans: Vec<(Option<Leader>, f64)> = (0..self.vehicles.len())
            .map(|i| (self.leader(i, &occupants), self.stop_m(&self.vehicles[i])))
            .collect();
        self.t_s += STEP_S;
        for (vehicle, (leader, stop_m)) in self.vehicles.iter_mut().zip(plans) {
            vehicle.step(leader, stop_m, STEP_S);
            let at_line = stop_m - vehicle.front_m() < 1.0 && vehicle.speed_mps < 0.2;
            vehicle.waits_since_s = at_line.then(|| vehicle.waits_since_s.unwrap_or(self.t_s));
        }
    }

    pub(super) fn occupants(&self) -> Occupants {
        let mut on = vec![Vec::new(); self.lanes.paths.len()];
        for (i, vehicle) in self.vehicles.iter().enumerate() {
            let (lane, along_m) = self.place(vehicle);
            on[lane].push((along_m, i));
        }
        on
    }

    /// Returns the lane of its middle, and the position along it, meters.
    fn place(&self, vehicle: &Vehicle) -> (usize, f64) {
        let k = vehicle.route.lane_at(vehicle.along_m);
        let lane = vehicle.route.lanes[k];
        (lane, (vehicle.along_m - vehicle.route.starts_m[k]) * self.scale(vehicle, k))
    }

    /// Returns the ratio of a lane's length to the route's length on it; the route may run beside the lane's
    /// middle.
    fn scale(&self, vehicle: &Vehicle, k: usize) -> f64 {
        let own_m = vehicle.route.starts_m[k + 1] - vehicle.route.starts_m[k];
        self.lanes.length_m(vehicle.route.lanes[k]) / own_m.max(0.1)
    }

    /// Returns the route index of the next path through a junction that the vehicle has not been granted.
    fn next_connector(&self, vehicle: &Vehicle) -> Option<usize> {
        let at = vehicle.route.lane_at(vehicle.along_m);
        let from = vehicle.granted.map_or(at, |granted| at.max(granted + 1));
        (from..vehicle.route.lanes.len()).find(|k| self.lanes.connectors[vehicle.route.lanes[*k]].is_some())
    }

    /// Returns the position where its front has to stop, meters along its route.
    fn stop_m(&self, vehicle: &Vehicle) -> f64 {
        match self
            .next_connector(vehicle)
            .and_then(|k| Some((k, self.lanes.connectors[vehicle.route.lanes[k]]?)))
        {
            Some((k, connector)) => vehicle.route.starts_m[k] - connector.stop_m(),
            None => vehicle.route.length_m() - STOP_M,
        }
    }

    /// Returns the nearest vehicle in front, on its own lanes or still beside the start of its path.
    fn leader(&self, index: usize, occupants: &Occupants) -> Option<Leader> {
        let me = &self.vehicles[index];
        let first = me.route.lane_at(me.along_m);
        let mut best: Option<Leader> = None;
        for k in first..me.route.lanes.len() {
            let (lane, start_m) = (me.route.lanes[k], me.route.starts_m[k]);
            if start_m - me.along_m > SIGHT_M {
                break;
            }
            let mut look = |on: usize, until_m: f64| {
                for (along_m, other) in occupants[on].iter().filter(|o| o.1 != index && o.0 < until_m) {
                    let place_m = start_m + along_m / self.scale(me, k);
                    if place_m < me.along_m || (place_m == me.along_m && *other > index) {
                        continue;
                    }
                    let other = &self.vehicles[*other];
                    let gap_m = place_m - other.size_m.x / 2.0 - me.front_m();
                    if best.is_none_or(|best| gap_m < best.gap_m) {
                        best = Some(Leader { gap_m, speed_mps: other.speed_mps });
                    }
                }
            };
            look(lane, f64::INFINITY);
            let Some(connector) = self.lanes.connectors[lane] else { continue };
            for sibling in self.lanes.network.lanes[connector.from].successors.iter().filter(|s| **s != lane)
            {
                let long = me.is_long() || occupants[*sibling].iter().any(|o| self.vehicles[o.1].is_long());
                if let Some(clear_m) = self.lanes.clear_m(*sibling, lane, long) {
                    look(*sibling, clear_m);
                }
            }
        }
        best
    }

    /// Revokes grants if the light is no longer green and the vehicle can still stop before it.
    fn revoke(&mut self) {
        for vehicle in &mut self.vehicles {
            let Some(k) = vehicle.granted else { continue };
            let Some(connector) = self.lanes.connectors[vehicle.route.lanes[k]] else { continue };
            let light = self.lanes.network.signal_at(connector.junction, connector.road, self.t_s);
            let left_m = vehicle.route.starts_m[k] - connector.stop_m() - vehicle.front_m();
            let halts_m = vehicle.speed_mps * (vehicle.speed_mps / (2.0 * BRAKING_MPS2) + STEP_S);
            if light.is_some_and(|light| light != Signal::Green) && left_m > halts_m + 0.1 {
                vehicle.granted = k.checked_sub(2);
            }
        }
    }

    /// Grants paths to vehicles that reach a junction: longest wait first, left turns at traffic lights last.
    fn grant(&mut self, occupants: &Occupants) {
        let mut asking = Vec::new();
        for (i, vehicle) in self.vehicles.iter().enumerate() {
            let Some(k) = self.next_connector(vehicle) else { continue };
            let Some(connector) = self.lanes.connectors[vehicle.route.lanes[k]] else { continue };
            let v = vehicle.speed_mps;
            let left_m = vehicle.route.starts_m[k] - connector.stop_m() - vehicle.front_m();
            if left_m < v * v / 3.0 + v * 0.6 + 3.0 {
                let waits_s = vehicle.waits_since_s.map_or(0.0, |since| self.t_s - since);
                let patient = waits_s < PATIENCE_S;
                let last = patient && connector.kind == JunctionKind::Signals && connector.turn == Turn::Left;
                asking.push((last, waits_s, i, k, connector));
            }
        }
        asking.sort_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)).then(a.2.cmp(&b.2)));
        let mut kept_free: Vec<usize> = Vec::new();
        for (_, waits_s, i, k, connector) in asking {
            let lane = self.vehicles[i].route.lanes[k];
            let retained = kept_free.iter().any(|other| self.lanes.clear_m(*other, lane, false).is_some());
            if retained || !self.could_enter(i, k, connector, occupants) {
                continue;
            }
            if !self.is_crossed(i, lane, connector) {
                self.vehicles[i].granted = Some(k);
            } else if waits_s > PATIENCE_S {
                // Keeps the junction free for a vehicle that has waited for long.
                kept_free.push(lane);
            }
        }
    }

    /// Returns whether a vehicle may enter a junction, apart from vehicles that cross its path there.
    fn could_enter(&self, index: usize, k: usize, connector: JunctionPath, occupants: &Occupants) -> bool {
        let me = &self.vehicles[index];
        let allowed = match connector.kind {
            JunctionKind::Free => true,
            JunctionKind::Stop => me.waits_since_s.is_some_and(|since| self.t_s - since > HALT_S),
            JunctionKind::Signals => {
                // A vehicle that waits to turn left goes last, at yellow, when oncoming vehicles have to
                // stop.
                let last = connector.turn == Turn::Left && me.waits_since_s.is_some();
                match self.lanes.network.signal_at(connector.junction, connector.road, self.t_s) {
                    Some(Signal::Yellow) => last,
                    light => light == Some(Signal::Green),
                }
            }
        };
        allowed
            && connector.crossings.iter().flatten().all(|crossing| self.walkers_on[*crossing] == 0)
            && self.is_first(index, k, connector.from, occupants)
            && self.has_room(index, connector, occupants)
    }

    /// Returns whether no vehicle ahead on its lane is still waiting.
    fn is_first(&self, index: usize, k: usize, lane: usize, occupants: &Occupants) -> bool {
        let me = &self.vehicles[index];
        let own_m = (me.along_m - me.route.starts_m[k - 1]) * self.scale(me, k - 1);
        let waits = |other: &Vehicle| {
            let at = other.route.lane_at(other.along_m);
            other.granted.is_none_or(|granted| granted <= at)
        };
        occupants[lane]
            .iter()
            .all(|(along_m, other)| *other == index || *along_m <= own_m || !waits(&self.vehicles[*other]))
    }

    /// Returns the paths that a vehicle has been granted and not yet left: lane, path, position of its middle
    /// along it, and distance of its rear beyond the end, meters.
    fn held<'v>(
        &self,
        vehicle: &'v Vehicle,
    ) -> impl Iterator<Item = (usize, JunctionPath, f64, f64)> + use<'v, '_> {
        let at = vehicle.route.lane_at(vehicle.along_m);
        let lanes = self.lanes;
        let last = vehicle.granted.unwrap_or(0);
        (at.saturating_sub(1)..=last).filter_map(move |k| {
            let lane = *vehicle.route.lanes.get(k)?;
            let connector = lanes.connectors[lane]?;
            let beyond_m = vehicle.rear_m() - vehicle.route.starts_m[k + 1];
            let along_m = vehicle.along_m - vehicle.route.starts_m[k];
            (beyond_m < BEYOND_CROSSING_M).then_some((lane, connector, along_m, beyond_m))
        })
    }

    /// Returns whether a vehicle with a granted path may still touch one on this path.
    fn is_crossed(&self, index: usize, lane: usize, connector: JunctionPath) -> bool {
        let me = &self.vehicles[index];
        let crosses = |other: &Vehicle| {
            let long = me.is_long() || other.is_long();
            self.held(other)
                .filter(|held| held.1.junction == connector.junction && held.1.from != connector.from)
                .any(|(held, _, along_m, _)| {
                    held != lane && self.lanes.clear_m(held, lane, long).is_some_and(|clear| along_m < clear)
                })
        };
        self.vehicles.iter().enumerate().any(|(i, other)| i != index && crosses(other))
    }

    /// Returns whether it fits on the lane after the junction, together with all vehicles that get there
    /// before it.
    fn has_room(&self, index: usize, connector: JunctionPath, occupants: &Occupants) -> bool {
        let mut room_m = self.lanes.length_m(connector.to);
        for (along_m, other) in occupants[connector.to].iter().filter(|o| o.1 != index) {
            let other = &self.vehicles[*other];
            // Moving vehicles will make room.
            let leaves_m = other.speed_mps * 1.2;
            room_m = room_m.min(along_m - other.size_m.x / 2.0 + leaves_m);
        }
        let mut needed_m = BEYOND_CROSSING_M + self.vehicles[index].size_m.x + 3.0;
        for (i, other) in self.vehicles.iter().enumerate().filter(|(i, _)| *i != index) {
            let comes =
                self.held(other).any(|held| held.1.to == connector.to && self.place(other).0 != connector.to);
            needed_m += if comes && i != index { other.size_m.x + 3.0 } else { 0.0 };
        }
        needed_m < room_m
    }

    /// Returns whether no vehicle has been granted a path over a crossing.
    pub(super) fn is_free(&self, crossing: usize) -> bool {
        let over = |held: &(usize, JunctionPath, f64, f64)| held.1.crossings.contains(&Some(crossing));
        self.vehicles.iter().all(|vehicle| !self.held(vehicle).any(|held| over(&held)))
    }
}
