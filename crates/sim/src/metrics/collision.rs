use std::collections::BTreeSet;

use glam::DVec2;
use point_skeleton::dataset::{Class, Track};
use point_skeleton::geometry::{Footprint, wrap_angle};
use serde::{Deserialize, Serialize};

use super::Road;
use crate::{EgoState, Instant, SimActor};

/// Maximum speed of a stopped road user, meters per second; nuPlan's threshold.
pub(super) const STOPPED_MPS: f64 = 0.05;
/// Minimum angle from straight ahead at which an actor is behind the ego, radians; nuPlan's 150 degrees.
const BEHIND_RAD: f64 = 150.0 * std::f64::consts::PI / 180.0;

/// First contact of the ego with an actor, in bird's-eye view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Collision {
    /// Step of the contact.
    pub step: usize,
    /// Time of the contact, absolute microseconds.
    pub t_us: i64,
    /// Track id of the actor.
    pub track: String,
    /// Class of the actor.
    pub class: Class,
    /// Kind of the contact.
    pub kind: CollisionKind,
    /// Whether the ego is at fault by nuPlan's rules; `None` if that depends on a missing map.
    pub at_fault: Option<bool>,
    /// Speed of the ego, meters per second.
    pub ego_speed_mps: f64,
    /// Speed of the actor, meters per second.
    pub actor_speed_mps: f64,
}

impl Collision {
    /// Describes the collision; `category` is the actor's.
    pub fn text(&self, category: &str) -> String {
        let fault = match self.at_fault {
            Some(true) => ", the ego's fault",
            Some(false) => ", not the ego's fault",
            None => "",
        };
        // Avoids a minus before zero.
        let speed = |speed_mps: f64| format!("{:.1} m/s", (speed_mps * 10.0).round() / 10.0 + 0.0);
        let [ego, other] = [self.ego_speed_mps, self.actor_speed_mps].map(speed);
        format!("collision with {category} (ego {ego}, other {other}){fault}")
    }
}

/// Kind of a collision, as in nuPlan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CollisionKind {
    /// The ego was stopped: not at fault.
    StoppedEgo,
    /// The actor was stopped: the ego is at fault.
    StoppedActor,
    /// The actor hit from behind: the ego is not at fault.
    Rear,
    /// The ego's front bumper hit the actor: the ego is at fault.
    Front,
    /// Side contact: the ego is at fault if it was not within a single lane or not on the drivable area.
    Lateral,
}

/// Returns new contacts of the ego with actors, keyed by track; actors in `before` are skipped.
pub(super) fn contacts(
    now: &Instant,
    tracks: &[Track],
    road: Option<&Road>,
    before: &BTreeSet<usize>,
) -> Vec<(usize, Collision)> {
    let ego = Footprint::from(&now.ego.cuboid());
    let touches = |actor: &&SimActor| {
        let body = Footprint::from(&actor.cuboid);
        let near = body.center.distance(ego.center) <= body.radius_m() + ego.radius_m();
        near && !before.contains(&actor.track) && ego.overlaps(&body)
    };
    let collision = |actor: &SimActor| {
        let kind = kind(&now.ego, actor, tracks[actor.track].class);
        let at_fault = match kind {
            CollisionKind::StoppedEgo | CollisionKind::Rear => Some(false),
            CollisionKind::StoppedActor | CollisionKind::Front => Some(true),
            CollisionKind::Lateral => road.map(|road| !road.is_in_one_lane(&ego)),
        };
        let track = &tracks[actor.track];
        let collision = Collision {
            step: now.step,
            t_us: now.t_us,
            track: track.id.clone(),
            class: track.class,
            kind,
            at_fault,
            ego_speed_mps: now.ego.speed_mps,
            actor_speed_mps: actor.speed_mps,
        };
        (actor.track, collision)
    };
    now.actors.iter().filter(touches).map(collision).collect()
}

/// Classifies a contact, checking the kinds in nuPlan's order.
fn kind(ego: &EgoState, actor: &SimActor, class: Class) -> CollisionKind {
    let stands = actor.speed_mps.abs() <= STOPPED_MPS || matches!(class, Class::Object | Class::None);
    if ego.speed_mps.abs() <= STOPPED_MPS {
        CollisionKind::StoppedEgo
    } else if stands {
        CollisionKind::StoppedActor
    } else if is_behind(ego, actor) {
        CollisionKind::Rear
    } else if front_bumper(&Footprint::from(&ego.cuboid())).overlaps(&Footprint::from(&actor.cuboid)) {
        CollisionKind::Front
    } else {
        CollisionKind::Lateral
    }
}

/// Returns whether an actor's center is behind the ego's rear axle, within 30 degrees of straight back.
pub(super) fn is_behind(ego: &EgoState, actor: &SimActor) -> bool {
    let arm: DVec2 = actor.cuboid.pose.translation.truncate() - ego.position_m();
    arm != DVec2::ZERO && wrap_angle(arm.to_angle() - ego.heading_rad()).abs() > BEHIND_RAD
}

/// Returns the segment between the front corners, as a rectangle of zero length.
fn front_bumper(ego: &Footprint) -> Footprint {
    let center = ego.center + ego.forward * ego.half_m.x;
    Footprint { center, half_m: DVec2::new(0.0, ego.half_m.y), ..*ego }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use glam::DVec3;
    use point_skeleton::geometry::{Cuboid, Pose};

    /// Returns a car of 4 m by 2 m.
    pub(crate) fn actor(track: usize, x: f64, y: f64, yaw: f64, speed_mps: f64) -> SimActor {
        let pose = Pose::from_yaw(yaw, DVec3::new(x, y, 0.8));
        let cuboid = Cuboid { pose, size: DVec3::new(4.0, 2.0, 1.6) };
        SimActor { track, cuboid, speed_mps, lateral_mps: 0.0, yaw_rate_radps: 0.0 }
    }

    /// Returns an instant with the ego's rear axle at the origin, heading along x.
    pub(crate) fn instant(speed_mps: f64, actors: &[SimActor]) -> Instant {
        let pose = Pose::IDENTITY;
        let ego =
            EgoState { pose, speed_mps, acceleration_mps2: 0.0, yaw_rate_radps: 0.0, steering_rad: 0.0 };
        Instant { step: 7, t_us: 700_000, ego, actors: actors.to_vec(), lights: Vec::new() }
    }

    pub(crate) fn tracks(classes: &[Class]) -> Vec<Track> {
        let track = |(i, class): (usize, &Class)| Track {
            id: format!("t{i}"),
            category: "vehicle.car".into(),
            class: *class,
        };
        classes.iter().enumerate().map(track).collect()
    }

    fn kinds(now: &Instant, class: Class) -> Vec<(CollisionKind, Option<bool>)> {
        let found = contacts(now, &tracks(&[class]), None, &BTreeSet::new());
        found.iter().map(|(_, c)| (c.kind, c.at_fault)).collect()
    }

    #[test]
    fn adjacent_actors_do_not_collide() {
        // The ego extends from -1.127 to 4.049 m and 1.1485 m to either side.
        let beside =
            [actor(0, 6.06, 0.0, 0.0, 3.0), actor(0, -3.1275, 0.0, 0.0, 3.0), actor(0, 1.0, 2.15, 0.0, 3.0)];
        for one in beside {
            assert_eq!(kinds(&instant(5.0, &[one]), Class::MotorVehicle), []);
        }
    }

    #[test]
    fn collision_faults_match_nuplan() {
        use CollisionKind::{Front, Lateral, Rear, StoppedActor, StoppedEgo};
        let ahead = actor(0, 6.0, 0.0, 0.0, 3.0);
        let behind = actor(0, -3.0, 0.0, 0.0, 9.0);
        let beside = actor(0, 1.0, 2.1, 0.0, 6.0);
        let kind = |speed: f64, one: SimActor| kinds(&instant(speed, &[one]), Class::MotorVehicle);
        assert_eq!(kind(5.0, ahead), [(Front, Some(true))]);
        assert_eq!(kind(5.0, behind), [(Rear, Some(false))]);
        assert_eq!(kind(5.0, beside), [(Lateral, None)]);
        assert_eq!(kind(0.05, ahead), [(StoppedEgo, Some(false))]);
        assert_eq!(kind(5.0, SimActor { speed_mps: 0.05, ..behind }), [(StoppedActor, Some(true))]);
        // Objects count as stopped, regardless of noise in their boxes.
        assert_eq!(kinds(&instant(5.0, &[ahead]), Class::Object), [(StoppedActor, Some(true))]);
    }

    #[test]
    fn a_contact_counts_once() {
        let now = instant(5.0, &[actor(0, 6.0, 0.0, 0.0, 3.0), actor(1, -3.0, 0.0, 0.0, 9.0)]);
        let tracks = tracks(&[Class::MotorVehicle; 2]);
        let found = contacts(&now, &tracks, None, &[0].into());
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].0, found[0].1.track.as_str(), found[0].1.step), (1, "t1", 7));
    }
}
