use glam::DVec2;

use crate::geometry::{Footprint, Polyline};
use crate::sim::{Instant, SimActor};

/// How far along its way an actor looks, metres.
pub(super) const SIGHT_M: f64 = 100.0;

/// Everybody who may be in somebody's way at an instant.
pub(super) struct Others {
    /// By actor, the ego last.
    bodies: Vec<Body>,
}

/// One of them.
#[derive(Clone, Copy, Debug)]
struct Body {
    /// `None`: the ego.
    track: Option<usize>,
    footprint: Footprint,
    speed_mps: f64,
}

/// Who is next on a way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Leader {
    /// From the follower's front to where the leader's box begins, along the way, metres; 0 where they touch.
    pub(super) gap_m: f64,
    /// Along the way, metres per second: negative if it comes towards.
    pub(super) speed_mps: f64,
}

impl Others {
    /// All of an instant.
    pub(super) fn new(now: &Instant) -> Self {
        let actor = |a: &SimActor| Body {
            track: Some(a.track),
            footprint: Footprint::from(&a.cuboid),
            speed_mps: a.speed_mps,
        };
        let ego =
            Body { track: None, footprint: Footprint::from(&now.ego.cuboid()), speed_mps: now.ego.speed_mps };
        Self { bodies: now.actors.iter().map(actor).chain([ego]).collect() }
    }

    /// The nearest other on the corridor along a way: as wide as `width_m`, from the follower's front at a station
    /// (metres) on as far as it looks.
    pub(super) fn leader(&self, track: usize, way: &Polyline, front_m: f64, width_m: f64) -> Option<Leader> {
        let (front, _) = way.at(front_m);
        let near = |body: &&Body| {
            body.track != Some(track)
                && body.footprint.center.distance(front) < SIGHT_M + body.footprint.radius_m() + width_m
        };
        let bodies: Vec<&Body> = self.bodies.iter().filter(near).collect();
        let end_m = front_m + SIGHT_M;
        let mut from_m = front_m;
        while from_m < end_m && !bodies.is_empty() {
            let piece = way.piece(from_m);
            let is_last = piece + 2 == way.points().len();
            let to_m = if is_last { end_m } else { way.stations_m()[piece + 1].min(end_m) };
            // Before the way's first point its first piece goes on as well.
            let (start, forward) = way.at(from_m);
            let half_m = DVec2::new((to_m - from_m) / 2.0, width_m / 2.0);
            let corridor = Footprint { center: start + forward * half_m.x, forward, half_m };
            let met = bodies.iter().filter_map(|body| met(&corridor, body, from_m - front_m));
            if let Some(leader) = met.min_by(|a, b| a.gap_m.total_cmp(&b.gap_m)) {
                return Some(leader);
            }
            from_m = to_m;
        }
        None
    }
}

/// A body on a straight piece of corridor that begins `start_m` in front of the follower.
fn met(corridor: &Footprint, body: &Body, start_m: f64) -> Option<Leader> {
    let reach_m = corridor.radius_m() + body.footprint.radius_m();
    if corridor.center.distance(body.footprint.center) > reach_m {
        return None;
    }
    let contact_m = corridor.first_contact_m(&body.footprint)?;
    let speed_mps = body.speed_mps * body.footprint.forward.dot(corridor.forward);
    Some(Leader { gap_m: start_m + corridor.half_m.x + contact_m, speed_mps })
}
