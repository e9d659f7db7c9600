//! Motion of a scene while a LiDAR scans it.

use crate::geometry::Pose;
use crate::scene::{ActorState, SceneState};

/// Motion of ego and actors through two states: poses are interpolated between them and extrapolated beyond.
#[derive(Clone, Copy, Debug)]
pub struct Motion<'a> {
    state: &'a SceneState,
    /// Another state, and its time after the first, seconds; `None` if nothing moves.
    other: Option<(&'a SceneState, f64)>,
}

impl<'a> Motion<'a> {
    /// Creates the motion through a state and another one, before or after it. Nothing moves without another
    /// one, or if both have the same time.
    pub fn new(state: &'a SceneState, other: Option<&'a SceneState>) -> Self {
        let with_time = |other: &'a SceneState| (other, (other.t_us - state.t_us) as f64 * 1e-6);
        Self { state, other: other.map(with_time).filter(|(_, after_s)| *after_s != 0.0) }
    }

    /// Returns the state at the time of the sweep.
    pub fn state(&self) -> &'a SceneState {
        self.state
    }

    /// Returns `global_from_ego` at a time after the state's, seconds.
    pub fn ego(&self, after_s: f64) -> Pose {
        let pose = self.state.global_from_ego;
        self.other.map_or(pose, |(other, at_s)| pose.interpolate(&other.global_from_ego, after_s / at_s))
    }

    /// Returns the paths of the actors, in the state's order. Actors without another state do not move.
    pub(crate) fn paths(&self) -> Vec<ActorPath> {
        let path = |actor: &ActorState| {
            let other = self.other.and_then(|(other, at_s)| {
                let at = other.actors.binary_search_by(|there| there.track.cmp(&actor.track)).ok()?;
                Some((other.actors[at].cuboid.pose, at_s))
            });
            ActorPath { pose: actor.cuboid.pose, other }
        };
        self.state.actors.iter().map(path).collect()
    }
}

/// Motion of an actor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ActorPath {
    pose: Pose,
    /// Another pose, and its time after the first, seconds.
    other: Option<(Pose, f64)>,
}

impl ActorPath {
    /// Returns `global_from_actor` at a time after the state's, seconds.
    pub(crate) fn at(&self, after_s: f64) -> Pose {
        self.other.map_or(self.pose, |(other, at_s)| self.pose.interpolate(&other, after_s / at_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::Class;
    use crate::geometry::Cuboid;
    use glam::DVec3;

    fn state(t_us: i64, ego_m: f64, actors: &[(&str, f64)]) -> SceneState {
        let pose = |x: f64| Pose::from_yaw(0.0, DVec3::new(x, 0.0, 0.0));
        let actor = |(track, x): &(&str, f64)| ActorState {
            track: (*track).to_owned(),
            category: "vehicle.car".into(),
            class: Class::from_category("vehicle.car"),
            cuboid: Cuboid::new(pose(*x), DVec3::ONE).unwrap(),
            appearance: None,
        };
        SceneState {
            name: "0".into(),
            t_us,
            global_from_ego: pose(ego_m),
            cameras: Vec::new(),
            actors: actors.iter().map(actor).collect(),
            map: None,
        }
    }

    #[test]
    fn poses_between_and_beyond_two_states_are_linear() {
        let (now, before) =
            (state(1_100_000, 10.0, &[("a", 5.0), ("b", 7.0)]), state(1_000_000, 8.0, &[("b", 6.0)]));
        let motion = Motion::new(&now, Some(&before));
        let x = |after_s: f64| {
            let paths = motion.paths();
            [motion.ego(after_s), paths[0].at(after_s), paths[1].at(after_s)].map(|pose| pose.translation.x)
        };
        for (after_s, expected) in [
            (0.0, [10.0, 5.0, 7.0]),
            (-0.05, [9.0, 5.0, 6.5]),
            (-0.1, [8.0, 5.0, 6.0]),
            (0.05, [11.0, 5.0, 7.5]),
        ] {
            let found = x(after_s);
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}");
        }
        let still = Motion::new(&now, None);
        let there: Vec<Pose> = still.paths().iter().map(|path| path.at(1.0)).collect();
        assert_eq!(still.ego(-0.05), now.global_from_ego);
        assert_eq!(there, now.actors.iter().map(|actor| actor.cuboid.pose).collect::<Vec<_>>());
    }
}
