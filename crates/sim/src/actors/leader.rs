use glam::DVec2;
use point_skeleton::geometry::{Footprint, Polyline};
use point_skeleton::idm::Leader;

use crate::{Instant, SimActor};

/// Look-ahead distance of an actor along its path, meters.
pub(super) const SIGHT_M: f64 = 100.0;

/// All road users at one instant, as possible leaders.
pub(super) struct Others {
    /// Actors, then the ego.
    bodies: Vec<Body>,
}

/// Road user at one instant.
#[derive(Clone, Copy, Debug)]
struct Body {
    /// `None` for the ego.
    track: Option<usize>,
    footprint: Footprint,
    speed_mps: f64,
}

impl Others {
    /// Collects the actors and the ego of an instant.
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

    /// Returns the nearest other road user in the corridor along a path. The corridor is `width_m` wide and
    /// extends from the follower's front (a station, meters) over the look-ahead distance.
    pub(super) fn leader(&self, track: usize, path: &Polyline, front_m: f64, width_m: f64) -> Option<Leader> {
        let (front, _) = path.at(front_m);
        let near = |body: &&Body| {
            body.track != Some(track)
                && body.footprint.center.distance(front) < SIGHT_M + body.footprint.radius_m() + width_m
        };
        let bodies: Vec<&Body> = self.bodies.iter().filter(near).collect();
        let end_m = front_m + SIGHT_M;
        let mut from_m = front_m;
        while from_m < end_m && !bodies.is_empty() {
            let piece = path.piece(from_m);
            let is_last = piece + 2 == path.points().len();
            let to_m = if is_last { end_m } else { path.stations_m()[piece + 1].min(end_m) };
            // Before the path's first point, `path.at` extends its first segment.
            let (start, forward) = path.at(from_m);
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

/// Returns the contact with a body in a straight corridor segment that begins `start_m` in front of the
/// follower.
fn met(corridor: &Footprint, body: &Body, start_m: f64) -> Option<Leader> {
    let reach_m = corridor.radius_m() + body.footprint.radius_m();
    if corridor.center.distance(body.footprint.center) > reach_m {
        return None;
    }
    let contact_m = corridor.first_contact_m(&body.footprint)?;
    let speed_mps = body.speed_mps * body.footprint.forward.dot(corridor.forward);
    Some(Leader { gap_m: start_m + corridor.half_m.x + contact_m, speed_mps })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::collision::tests::{actor, instant};

    /// Returns a path along x from 40 m behind the ego that turns left after 60 m.
    fn path() -> Polyline {
        let points = [(-40.0, 0.0), (20.0, 0.0), (20.0, 60.0)];
        Polyline::new(points.map(DVec2::from)).unwrap()
    }

    /// Returns the leader of a 4 m by 2 m car centered at x = -30 m, among the ego at the origin and others.
    fn leader(others: &[SimActor]) -> Option<Leader> {
        let me = actor(9, -30.0, 0.0, 0.0, 8.0);
        let all: Vec<SimActor> = others.iter().copied().chain([me]).collect();
        Others::new(&instant(5.0, &all)).leader(9, &path(), 12.0, 2.0)
    }

    fn close(found: Option<Leader>, gap_m: f64, speed_mps: f64) {
        let found = found.unwrap();
        assert!(
            (found.gap_m - gap_m).abs() < 1e-9 && (found.speed_mps - speed_mps).abs() < 1e-9,
            "{found:?}"
        );
    }

    #[test]
    fn ego_leads_if_no_actor_is_nearer() {
        // The ego's rear is 1.127 m behind its rear axle; the car's front is at -28 m.
        close(leader(&[]), 28.0 - (5.176 / 2.0 - 1.461), 5.0);
        close(leader(&[actor(0, -20.0, 0.0, 0.0, 3.0)]), 6.0, 3.0);
    }

    #[test]
    fn cut_in_leads_from_its_corridor_entry() {
        // The right front corner has just crossed the edge of the corridor.
        let turn = -0.2f64;
        let cuts = actor(0, -18.0, 2.3, turn, 6.0);
        let corner =
            DVec2::new(-18.0, 2.3) + DVec2::from_angle(turn) * 2.0 + DVec2::from_angle(turn).perp() * -1.0;
        assert!(corner.y < 1.0);
        // The right side crosses the edge at y = 1.
        let x = corner.x - (1.0 - corner.y) / (-turn).tan();
        close(leader(&[cuts]), x + 28.0, 6.0 * turn.cos());
        // A little further out it is not a leader.
        assert_eq!(leader(&[actor(0, -18.0, 2.5, turn, 6.0)]), leader(&[]));
    }

    #[test]
    fn oncoming_and_crossing_speeds_are_projected() {
        close(leader(&[actor(0, -15.0, 0.0, std::f64::consts::PI, 7.0)]), 11.0, -7.0);
        close(leader(&[actor(0, -15.0, 0.0, std::f64::consts::FRAC_PI_2, 7.0)]), 12.0, 0.0);
    }

    #[test]
    fn ignores_actors_beside_behind_or_far() {
        let parked = [actor(0, -20.0, 2.01, 0.0, 0.0), actor(1, -20.0, -2.01, 0.0, 0.0)];
        assert_eq!(leader(&parked), leader(&[]));
        assert_eq!(leader(&[actor(0, -34.1, 0.0, 0.0, 9.0)]), leader(&[]));
        assert_eq!(leader(&[actor(0, -30.0, 1.9, 0.0, 9.0)]), leader(&[]), "side by side");
        // Around the corner: 48 m to it, then up to the rear bumper. A car beyond the look-ahead distance is
        // ignored.
        let around = |y: f64| actor(0, 20.0, y, std::f64::consts::FRAC_PI_2, 4.0);
        let me = actor(9, -30.0, 0.0, 0.0, 8.0);
        let mut now = instant(5.0, &[around(40.0), me]);
        now.ego.pose.translation.y = 500.0;
        close(Others::new(&now).leader(9, &path(), 12.0, 2.0), 48.0 + 38.0, 4.0);
        now.actors[0] = around(54.1);
        assert_eq!(Others::new(&now).leader(9, &path(), 12.0, 2.0), None);
        // The path extends straight beyond its end.
        close(Others::new(&instant(5.0, &[around(70.0)])).leader(9, &path(), 110.0, 2.0), 18.0, 4.0);
    }
}
