//! Initial placement of vehicles.

use glam::DVec2;

use super::bodies::{Bodies, DRIVING};
use super::lanes::Lanes;
use super::route::{BRAKING_MPS2, Route, RouteConstraints};
use super::vehicle::{Driver, Vehicle};
use super::world::World;
use crate::model::{Body, BodyKind};
use crate::plan::random::Random;
use crate::plan::{LaneKind, Signal, Turn};

/// Length and width of the recording car, and the distance of its box's middle ahead of its rear axle,
/// meters.
pub(super) const EGO_M: DVec2 = DVec2::new(5.176, 2.297);
pub(super) const EGO_AHEAD_M: f64 = 1.461;
/// Initial speed of the ego, m/s.
const EGO_MPS: f64 = 8.0;
/// Initial position of the ego along its lane, meters.
const EGO_ALONG_M: f64 = 7.0;
/// Duration, including the time before the start, above which the ego turns off, seconds.
const LONG_DRIVE_S: f64 = 24.0;
/// Distance from the ego's route within which streets have traffic, meters.
const NEAR_M: f64 = 140.0;
/// Length of lane per vehicle, meters, and min and max number of vehicles.
const SPACING_M: f64 = 66.0;
const COUNT: [usize; 2] = [26, 70];
/// Time for which trucks and buses need gentle curves, seconds; routes without tight curves for longer are
/// rare.
const LONG_S: f64 = 22.0;
/// Distance of cyclists from the right edge of a lane, meters.
const EDGE_M: f64 = 0.65;

/// Generator of vehicles.
pub(super) struct Start<'a> {
    pub(super) lanes: &'a Lanes<'a>,
    pub(super) bodies: &'a Bodies,
    pub(super) random: Random,
    /// Duration that routes last for, seconds.
    pub(super) duration_s: f64,
}

impl Start<'_> {
    /// Returns the ego at time 0: preferably on the left lane of an avenue, with a long distance ahead.
    pub(super) fn ego(&mut self) -> Vehicle {
        let mut best = (f64::NEG_INFINITY, 0);
        for lane in 0..self.lanes.paths.len() {
            if let Some(score) = self.score(lane) {
                let score = score + self.random.between(0.0, 0.9);
                best = if score > best.0 { (score, lane) } else { best };
            }
        }
        let wish =
            RouteConstraints { right_m: 0.0, long: false, turn_within: self.is_long_drive().then_some(2) };
        let length_m = 60.0 + 10.0 * self.duration_s;
        let route = Route::draw(self.lanes, best.1, length_m, wish, &mut self.random);
        Vehicle {
            body: None,
            size_m: EGO_M,
            driver: Driver { free_mps: 8.6, rise_mps2: 1.3, brake_mps2: 2.0 },
            along_m: EGO_ALONG_M.min(route.length_m() / 2.0),
            began_m: 0.0,
            speed_mps: EGO_MPS,
            granted: None,
            waits_since_s: None,
            route,
        }
    }

    /// Returns whether the ego drives beyond one junction.
    fn is_long_drive(&self) -> bool {
        self.duration_s > LONG_DRIVE_S
    }

    /// Scores a lane for the ego's start; `None` for paths through junctions.
    fn score(&self, lane: usize) -> Option<f64> {
        let LaneKind::Road(road) = self.lanes.network.lanes[lane].kind else { return None };
        let [forward, back] = self.lanes.network.lanes_of(road);
        let innermost = forward.first() == Some(&lane) || back.first() == Some(&lane);
        let left_m = self.lanes.length_m(lane) - EGO_ALONG_M;
        let mut score = 0.0;
        score += if self.lanes.network.roads[road].lanes_each_way > 1 && innermost { 8.0 } else { 0.0 };
        score += if self.lanes.is_open(lane, 2) { 3.0 } else { 0.0 };
        score += ((left_m - 50.0) / 25.0).clamp(-1.0, 1.0);
        let turns = self.lanes.network.lanes[lane].successors.iter();
        let turns = turns
            .filter_map(|connector| self.lanes.connectors[*connector])
            .any(|connector| connector.turn != Turn::Straight);
        score += if turns && self.is_long_drive() { 3.0 } else { 0.0 };
        let connector = self.lanes.connectors[*self.lanes.network.lanes[lane].successors.first()?]?;
        let arrives_s = (left_m - 10.0) / EGO_MPS;
        let is_green = |after_s: f64| {
            let light = self.lanes.network.signal_at(connector.junction, connector.road, arrives_s + after_s);
            light.is_none_or(|light| light == Signal::Green)
        };
        score += if [-4.0, -2.0, 2.0].into_iter().all(is_green) { 2.0 } else { 0.0 };
        Some(score)
    }

    /// Creates a vehicle with a body on a lane; `None` if it has no room to stop.
    fn vehicle(&mut self, body: Body, lane: usize, along_m: f64, speed_mps: f64) -> Option<Vehicle> {
        let size_m = body.size_m().truncate();
        let long = matches!(body.kind, BodyKind::Truck | BodyKind::Bus);
        let right_m = match body.kind {
            BodyKind::Cyclist => self.lanes.network.lanes[lane].width_m / 2.0 - EDGE_M,
            _ => 0.0,
        };
        let driver = match body.kind {
            BodyKind::Cyclist => {
                Driver { free_mps: self.random.between(3.0, 5.0), rise_mps2: 0.8, brake_mps2: 3.0 }
            }
            _ if long => Driver { free_mps: self.random.between(7.0, 8.5), rise_mps2: 0.9, brake_mps2: 3.2 },
            _ => {
                let rise_mps2 = self.random.between(1.2, 1.8);
                Driver { free_mps: self.random.between(7.8, 10.5), rise_mps2, brake_mps2: 3.3 }
            }
        };
        let length_m = 60.0 + driver.free_mps * self.duration_s;
        let wish = RouteConstraints { right_m, long, turn_within: None };
        let route = Route::draw(self.lanes, lane, length_m, wish, &mut self.random);
        let wanted_m = driver.free_mps * self.duration_s.min(LONG_S);
        if long && !route.is_wide(along_m, wanted_m) {
            let car = self.bodies.of(BodyKind::Sedan, &mut self.random);
            return self.vehicle(car, lane, along_m, speed_mps);
        }
        // Limits the speed so that it can still stop at the end of its lane.
        let stop_m = route.starts_m[1] - 8.0 - along_m - size_m.x / 2.0;
        let most_mps = (2.0 * BRAKING_MPS2 * (stop_m - 1.0)).max(0.0).sqrt();
        let speed_mps = speed_mps.min(driver.free_mps).min(route.cap_mps(along_m)).min(most_mps);
        (stop_m > 0.5).then_some(Vehicle {
            body: Some(body),
            size_m,
            driver,
            route,
            along_m,
            speed_mps,
            granted: None,
            waits_since_s: None,
            began_m: along_m,
        })
    }

    /// Returns vehicles on the streets around a route.
    pub(super) fn around(&mut self, drive: &[DVec2]) -> Vec<Vehicle> {
        let (mut places, mut total_m) = (Vec::new(), 0.0);
        for lane in 0..self.lanes.paths.len() {
            let path = &self.lanes.paths[lane];
            let near = |p: &DVec2| drive.iter().any(|q| p.distance(*q) < NEAR_M);
            let closed = self.lanes.connectors[lane].is_some() || !self.lanes.is_open(lane, 2);
            if closed || !path.points().iter().step_by(20).any(near) {
                continue;
            }
            total_m += path.length_m();
            let mut along_m = self.random.between(9.0, 20.0);
            while along_m < path.length_m() - 18.0 {
                places.push((lane, along_m));
                along_m += self.random.between(22.0, 34.0);
            }
        }
        self.random.shuffle(&mut places);
        let count = ((total_m / SPACING_M) as usize).clamp(COUNT[0], COUNT[1]);
        let cyclists = 2 + count / 14;
        let mut vehicles = Vec::new();
        for (lane, along_m) in places {
            let body = if vehicles.len() < cyclists && self.is_outermost(lane) {
                self.bodies.of(BodyKind::Cyclist, &mut self.random)
            } else {
                self.body_for(lane)
            };
            let speed_mps = self.random.between(4.0, 8.0);
            vehicles.extend(self.vehicle(body, lane, along_m, speed_mps));
            if vehicles.len() == count {
                break;
            }
        }
        vehicles
    }

    fn is_outermost(&self, lane: usize) -> bool {
        let LaneKind::Road(road) = self.lanes.network.lanes[lane].kind else { return false };
        self.lanes.network.lanes_of(road).iter().any(|side| side.last() == Some(&lane))
    }

    /// Picks a body for a lane; trucks and buses only on avenues.
    fn body_for(&mut self, lane: usize) -> Body {
        let body = self.bodies.any(&DRIVING, &mut self.random);
        let wide = match self.lanes.network.lanes[lane].kind {
            LaneKind::Road(road) => self.lanes.network.roads[road].lanes_each_way > 1,
            LaneKind::Junction(_) => false,
        };
        match body.kind {
            BodyKind::Truck | BodyKind::Bus if !wide => self.bodies.of(BodyKind::Sedan, &mut self.random),
            _ => body,
        }
    }

    /// Adds the ego, and vehicles around it that make lane changes relevant: one ahead, two on the adjacent
    /// lane, some oncoming. Vehicles in the ego's way are removed first.
    pub(super) fn join(&mut self, world: &mut World<'_>, ego: Vehicle) {
        let lane = ego.route.lanes[0];
        let LaneKind::Road(road) = self.lanes.network.lanes[lane].kind else {
            return world.vehicles.insert(0, ego);
        };
        let sides = self.lanes.network.lanes_of(road);
        let (own, other) = if sides[0].contains(&lane) { (0, 1) } else { (1, 0) };
        let here_m = ego.along_m;
        let occupants = world.occupants();
        let mut leaves: Vec<usize> = sides[own]
            .iter()
            .flat_map(|lane| &occupants[*lane])
            .filter(|(along_m, _)| *along_m < here_m + 62.0)
            .map(|(_, vehicle)| *vehicle)
            .collect();
        // Also removes vehicles that are about to enter the ego's place.
        leaves.extend((0..world.vehicles.len()).filter(|i| {
            let near = world.vehicles[*i].rect().overlaps(&ego.rect().grown(12.0));
            let comes = world.vehicles[*i].route.lanes.iter().any(|l| sides[own].contains(l));
            near && comes
        }));
        leaves.sort_unstable();
        leaves.dedup();
        for i in leaves.into_iter().rev() {
            world.vehicles.remove(i);
        }
        let mut places = vec![(lane, here_m + self.random.between(24.0, 34.0), 7.8)];
        if let Some(beside) = sides[own].get(1) {
            // Leaves room for a lane change with acceleration.
            places.push((*beside, here_m - self.random.between(15.0, 22.0), 7.6));
            places.push((*beside, here_m + self.random.between(38.0, 46.0), 8.0));
        }
        for (k, towards) in sides[other].iter().enumerate() {
            let length_m = self.lanes.length_m(*towards);
            for ahead_m in [28.0, 52.0] {
                let ahead_m = ahead_m + 9.0 * k as f64 + self.random.between(0.0, 10.0);
                places.push((*towards, length_m - here_m - ahead_m, 8.0));
            }
        }
        world.vehicles.insert(0, ego);
        for (i, (lane, along_m, speed_mps)) in places.into_iter().enumerate() {
            // A low vehicle ahead, because a truck would block the view.
            let body = match i {
                0 => self.bodies.of(BodyKind::Hatchback, &mut self.random),
                _ => self.body_for(lane),
            };
            let size_m = body.size_m().truncate();
            let occupants = world.occupants();
            let free = occupants[lane].iter().all(|(other_m, i)| {
                (other_m - along_m).abs() > (world.vehicles[*i].size_m.x + size_m.x) / 2.0 + 7.0
            });
            if free && along_m > 8.0 {
                world.vehicles.extend(self.vehicle(body, lane, along_m, speed_mps));
            }
        }
    }
}
