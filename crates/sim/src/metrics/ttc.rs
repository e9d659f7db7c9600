use glam::DVec2;
use point_skeleton::geometry::Footprint;

use super::collision::{STOPPED_MPS, is_behind};
use crate::{Instant, SimActor};

/// Maximum time to contact; later contacts are ignored, as velocities do not stay constant that long.
/// nuPlan's horizon.
const HORIZON_S: f64 = 3.0;

/// Returns the seconds until the ego first touches an actor not behind it, at constant velocities; 0 for a
/// present contact. `None` without a contact within 3 s, or for a stopped ego.
pub(super) fn seconds_to_contact(now: &Instant) -> Option<f64> {
    let ego = Footprint::from(&now.ego.cuboid());
    if now.ego.speed_mps.abs() <= STOPPED_MPS {
        return None;
    }
    let velocity: DVec2 = ego.forward * now.ego.speed_mps;
    let contact = |actor: &SimActor| {
        let body = Footprint::from(&actor.cuboid);
        let times = ego.meets(&body, body.forward * actor.speed_mps - velocity)?;
        (times.end > 0.0 && times.start <= HORIZON_S).then_some(times.start.max(0.0))
    };
    let others = now.actors.iter().filter(|actor| !is_behind(&now.ego, actor));
    others.filter_map(contact).reduce(f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::collision::tests::{actor, instant};

    #[test]
    fn ttc_is_gap_over_closing_speed() {
        // The ego's front is 4.049 m before its rear axle; the rear of a stopped car of 4 m is at 20 m.
        let front = 1.461 + 5.176 / 2.0;
        let found = |speed: f64, others: &[_]| seconds_to_contact(&instant(speed, others));
        let gap = 20.0 - front;
        let stands = actor(0, 22.0, 0.0, 0.0, 0.0);
        assert!((found(10.0, &[stands]).unwrap() - gap / 10.0).abs() < 1e-9);
        assert_eq!(found(5.0, &[stands]), None);
        assert_eq!(found(0.0, &[stands]), None);
        // Oncoming, driving away, in the next lane, and cutting in.
        let towards = actor(1, 22.0, 0.0, std::f64::consts::PI, 5.0);
        assert!((found(10.0, &[stands, towards]).unwrap() - gap / 15.0).abs() < 1e-9);
        assert_eq!(found(10.0, &[actor(1, 22.0, 0.0, 0.0, 10.0), actor(2, 22.0, 3.0, 0.0, 0.0)]), None);
        let cuts = actor(1, 12.0, 8.0, -std::f64::consts::FRAC_PI_2, 4.0);
        let side = (8.0 - 2.0 - 2.297 / 2.0) / 4.0;
        assert!((found(7.0, &[cuts]).unwrap() - side).abs() < 1e-9);
    }

    #[test]
    fn ignores_actors_behind() {
        let found = |others: &[_]| seconds_to_contact(&instant(5.0, others));
        assert_eq!(found(&[actor(0, -6.0, 0.0, 0.0, 20.0)]), None);
        assert_eq!(found(&[actor(0, 4.0, 0.0, 0.0, 5.0)]), Some(0.0));
    }
}
