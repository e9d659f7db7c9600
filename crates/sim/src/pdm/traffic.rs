//! Other road users and red lights over the time of a plan.

use std::collections::{BTreeMap, BTreeSet};

use glam::DVec2;
use point_skeleton::dataset::Class;
use point_skeleton::geometry::{Footprint, wrap_angle};

use super::SAMPLES;
use crate::SimActor;

/// Samples between frames at 2 Hz.
pub(super) const FRAME_SAMPLES: usize = 5;
/// Range and numbers of road users that PDM-Closed predicts: vehicles, pedestrians, bicycles, objects.
const PREDICTED_M: f64 = 100.0;
const PREDICTED: [usize; 4] = [50, 25, 10, 50];

/// Road user at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Object {
    /// Index of the track.
    pub(super) track: usize,
    pub(super) body: Footprint,
}

/// State of a road user when it was first seen: NAVSIM classifies collisions by it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct First {
    pub(super) class: Class,
    pub(super) heading_rad: f64,
    pub(super) speed_mps: f64,
}

/// Road users and red lights at each sample.
#[derive(Clone, Debug, Default)]
pub(super) struct Traffic {
    pub(super) objects: Vec<Vec<Object>>,
    pub(super) first: BTreeMap<usize, First>,
    /// Tracks whose collisions do not count.
    pub(super) ignored: BTreeSet<usize>,
    /// Indices of red lane connectors on the route.
    pub(super) red: Vec<Vec<usize>>,
    /// Indices of lane connectors that the ego was in at the start: no leaders, when red.
    pub(super) entered: BTreeSet<usize>,
}

impl First {
    fn of(actor: &SimActor, class: Class) -> Self {
        Self { class, heading_rad: actor.cuboid.pose.yaw_rad(), speed_mps: actor.velocity_mps().length() }
    }

    /// Returns whether it moves by itself, unlike cones and barriers.
    pub(super) fn is_agent(&self) -> bool {
        matches!(self.class, Class::MotorVehicle | Class::Pedestrian | Class::Cycle)
    }
}

impl Traffic {
    /// Interpolates frames at 2 Hz: position, heading and size of a track between its first and last frame.
    /// Tracks of a single frame stand there all the time, as in NAVSIM's `_interpolate_gt_observation`;
    /// tracks that touch the ego (`body`) at the start are left out.
    pub(super) fn between(frames: &[Vec<SimActor>], classes: &[Class], body: &Footprint) -> Self {
        let mut tracks: BTreeMap<usize, Vec<(usize, SimActor)>> = BTreeMap::new();
        for (frame, actors) in frames.iter().enumerate() {
            for actor in actors {
                tracks.entry(actor.track).or_default().push((frame * FRAME_SAMPLES, *actor));
            }
        }
        let mut traffic = Self { objects: vec![Vec::new(); SAMPLES], ..Self::default() };
        for (track, states) in &tracks {
            let touches = states[0].0 == 0 && Footprint::from(&states[0].1.cuboid).overlaps(body);
            if touches || (states.len() == 1 && Footprint::from(&states[0].1.cuboid).overlaps(body)) {
                continue;
            }
            traffic.first.insert(*track, First::of(&states[0].1, classes[*track]));
            for (sample, objects) in traffic.objects.iter_mut().enumerate() {
                objects.extend(interpolated(states, sample).map(|body| Object { track: *track, body }));
            }
        }
        traffic
    }

    /// Predicts actors at constant velocities along their heading, as PDM-Closed does; every second sample is
    /// that before it. `center` is the ego's, `body` its rectangle.
    pub(super) fn predicted(actors: &[SimActor], classes: &[Class], body: &Footprint) -> Self {
        let mut traffic = Self { objects: vec![Vec::new(); SAMPLES], ..Self::default() };
        let mut near: Vec<(f64, &SimActor)> = actors
            .iter()
            .map(|actor| (actor.cuboid.pose.translation.truncate().distance(body.center), actor))
            .filter(|(distance_m, _)| *distance_m <= PREDICTED_M)
            .collect();
        for (_, actor) in &near {
            traffic.first.insert(actor.track, First::of(actor, classes[actor.track]));
        }
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut counts = [0; 4];
        for (_, actor) in near {
            let kind = match classes[actor.track] {
                Class::MotorVehicle => 0,
                Class::Pedestrian => 1,
                Class::Cycle => 2,
                Class::Object | Class::None => 3,
            };
            counts[kind] += 1;
            if counts[kind] > PREDICTED[kind] {
                continue;
            }
            let start = Footprint::from(&actor.cuboid);
            if start.overlaps(body) {
                traffic.ignored.insert(actor.track);
            }
            let velocity = if kind == 3 { DVec2::ZERO } else { along(actor) };
            for (sample, objects) in traffic.objects.iter_mut().enumerate() {
                let center = start.center + velocity * ((sample - sample % 2) as f64 * super::state::STEP_S);
                objects.push(Object { track: actor.track, body: Footprint { center, ..start } });
            }
        }
        traffic
    }
}

/// Returns the velocity of an actor, turned into its heading or against it.
fn along(actor: &SimActor) -> DVec2 {
    let velocity = actor.velocity_mps();
    let heading_rad = actor.cuboid.pose.yaw_rad();
    let drives_forward = wrap_angle(heading_rad - velocity.to_angle()).abs() < std::f64::consts::FRAC_PI_2;
    DVec2::from_angle(heading_rad) * velocity.length() * if drives_forward { 1.0 } else { -1.0 }
}

/// Returns the rectangle of a track at a sample; `None` before its first and after its last state.
fn interpolated(states: &[(usize, SimActor)], sample: usize) -> Option<Footprint> {
    let first = Footprint::from(&states[0].1.cuboid);
    if states.len() == 1 {
        return Some(first);
    }
    let next = states.partition_point(|(at, _)| *at < sample);
    let (to, after) = states.get(next)?;
    if *to == sample {
        return Some(turned(first, &Footprint::from(&after.cuboid), 1.0, None));
    }
    let (from, before) = states.get(next.checked_sub(1)?)?;
    let s = (sample - from) as f64 / (to - from) as f64;
    let before = Footprint::from(&before.cuboid);
    Some(turned(first, &Footprint::from(&after.cuboid), s, Some(&before)))
}

/// Returns the pose between two rectangles, with the size of the first one of the track.
fn turned(first: Footprint, after: &Footprint, s: f64, before: Option<&Footprint>) -> Footprint {
    let before = before.unwrap_or(after);
    let from_rad = before.forward.to_angle();
    let heading_rad = from_rad + s * wrap_angle(after.forward.to_angle() - from_rad);
    let center = before.center + s * (after.center - before.center);
    Footprint { center, forward: DVec2::from_angle(heading_rad), half_m: first.half_m }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::collision::tests::actor;

    const BODY: Footprint =
        Footprint { center: DVec2::new(1.461, 0.0), forward: DVec2::X, half_m: DVec2::new(2.588, 1.1485) };

    #[test]
    fn tracks_are_interpolated_between_frames() {
        let frames = [
            vec![actor(0, 20.0, 0.0, 3.0, 1.0), actor(2, 2.0, 0.0, 0.0, 0.0)],
            vec![actor(0, 21.0, 0.0, -3.0, 1.0), actor(1, 9.0, 9.0, 0.0, 4.0), actor(2, 30.0, 0.0, 0.0, 0.0)],
            vec![],
            vec![actor(0, 27.0, 2.0, -3.0, 2.0)],
        ];
        let traffic = Traffic::between(&frames, &[Class::MotorVehicle; 3], &BODY);
        let at = |sample: usize, track: usize| traffic.objects[sample].iter().find(|o| o.track == track);
        let body = at(2, 0).unwrap().body;
        assert!((body.center.x - 20.4).abs() < 1e-12);
        // Over the jump of the angle.
        let expected = 3.0 + 0.4 * (std::f64::consts::TAU - 6.0);
        assert!((body.forward - DVec2::from_angle(expected)).length() < 1e-12);
        // Over a frame without the track.
        assert!((at(10, 0).unwrap().body.center - DVec2::new(24.0, 1.0)).length() < 1e-12);
        assert!(at(15, 0).is_some() && at(16, 0).is_none());
        // A track of one frame stands there; one that touches the ego is left out.
        assert!(at(0, 1).is_some() && at(40, 1).is_some() && at(5, 2).is_none());
        assert!((traffic.first[&0].speed_mps - 1.0).abs() < 1e-12);
    }

    #[test]
    fn predictions_are_straight() {
        let actors =
            [actor(0, 20.0, 5.0, 0.0, -3.0), actor(1, 150.0, 0.0, 0.0, 0.0), actor(2, 2.0, 0.0, 0.0, 1.0)];
        let traffic = Traffic::predicted(&actors, &[Class::MotorVehicle; 3], &BODY);
        let x = |sample: usize| traffic.objects[sample].iter().find(|o| o.track == 0).unwrap().body.center.x;
        assert_eq!([x(0), x(1), x(2)].map(|x| (x * 1e9).round() / 1e9), [20.0, 20.0, 19.4]);
        assert!(traffic.objects[0].len() == 2 && traffic.ignored == [2].into());
    }
}
