//! Motion of all road users except the ego.
//!
//! # How it works
//! After the warm-up, a policy takes over each actor that it supports as soon as the actor is near the ego.
//! The other actors follow the log and are removed when their track ends. An actor under a policy continues
//! beyond the end of its track. It is removed permanently once it is far from the ego, because it could only
//! jump back to its logged position. All actors react to the same state, so the result does not depend on
//! their order.
//!
//! Actors that a scenario moves follow its script rather than a policy, unless it hands them to the
//! Intelligent Driver Model. Its conditions are tested at each instant, after all have moved; the times at
//! which they were met are part of the state.

mod idm;
mod leader;
mod reactive;

pub use idm::idm_step;

use std::collections::{BTreeMap, BTreeSet};

use glam::DVec3;
use point_skeleton::dataset::{Class, Command, TrackBox, Triggers};
use point_skeleton::geometry::Cuboid;
use serde::{Deserialize, Serialize};

use self::idm::Follower;
use self::leader::Others;
use self::reactive::ReactiveActor;
use super::recorded::Recorded;
use super::time::seconds;
use super::{ActorPolicy, EgoState, Instant, SimActor};

/// Policies move only actors within this distance of the ego, meters.
const REACH_M: f64 = 100.0;

/// Actors taken over from the log, by track.
#[derive(Clone, Debug, Default)]
pub(super) struct ControlledActors {
    pub(super) movers: BTreeMap<usize, Mover>,
    /// Actors removed permanently.
    pub(super) gone: BTreeSet<usize>,
    /// Times of the scenario's changes.
    pub(super) triggers: Triggers,
}

/// Motion model of an actor.
#[derive(Clone, Debug)]
pub(super) enum Mover {
    Idm(Follower),
    Reactive(ReactiveActor),
}

impl Mover {
    /// Takes over an actor from the log at a time (microseconds), if the policy supports it.
    fn join(
        policy: ActorPolicy,
        recorded: &Recorded<'_>,
        actor: &SimActor,
        t_us: i64,
        triggers: &Triggers,
    ) -> Option<Self> {
        let class = recorded.log.tracks[actor.track].class;
        match (policy, class) {
            (ActorPolicy::Idm, Class::MotorVehicle | Class::Cycle) => {
                Follower::join(recorded, actor, t_us, triggers).map(Self::Idm)
            }
            (ActorPolicy::Reactive, Class::MotorVehicle | Class::Cycle | Class::Pedestrian) => {
                Some(Self::Reactive(ReactiveActor::join(recorded, actor, t_us)))
            }
            _ => None,
        }
    }

    /// Returns the state required to restore the mover for the same log.
    pub(super) fn save(&self) -> SavedMover {
        match self {
            Self::Idm(follower) => SavedMover::Idm {
                joined_us: follower.joined_us,
                way_m: follower.way_m,
                speed_mps: follower.speed_mps,
            },
            Self::Reactive(cruiser) => SavedMover::Reactive(*cruiser),
        }
    }

    /// Advances the actor by one step. `sizes` are without and with the scenario's changes of its size at the
    /// next step, meters; `None` if there are no such changes.
    fn step(&mut self, actor: &SimActor, others: &Others, dt_s: f64, sizes: Option<[DVec3; 2]>) -> SimActor {
        let moved = match self {
            Self::Idm(follower) => follower.step(actor, others, dt_s),
            Self::Reactive(cruiser) => cruiser.step(actor, others, dt_s),
        };
        let Some([of_path, size]) = sizes else { return moved };
        let cuboid = match self {
            // The heights along the path are for the unchanged size.
            Self::Idm(_) => Cuboid { size: of_path, ..moved.cuboid },
            Self::Reactive(_) => moved.cuboid,
        };
        SimActor { cuboid: cuboid.resized(size), ..moved }
    }
}

/// Serialized form of a [`Mover`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub(super) enum SavedMover {
    Idm { joined_us: i64, way_m: f64, speed_mps: f64 },
    Reactive(ReactiveActor),
}

impl SavedMover {
    /// Restores the mover; `None` if the log has no such actor.
    pub(super) fn open(&self, recorded: &Recorded<'_>, track: usize, triggers: &Triggers) -> Option<Mover> {
        match *self {
            Self::Idm { joined_us, way_m, speed_mps } => {
                let known = recorded.log.script.known_at(triggers, joined_us);
                let actors = recorded.actors_at(joined_us, &known);
                let actor = actors.iter().find(|actor| actor.track == track)?;
                let joined = Follower::join(recorded, actor, joined_us, &known)?;
                joined.placed(way_m, speed_mps).map(Mover::Idm)
            }
            Self::Reactive(cruiser) => Some(Mover::Reactive(cruiser)),
        }
    }
}

/// Returns all actors at the next step, sorted by track; `next` holds its time and the ego's state then.
pub(super) fn advance(
    policy: ActorPolicy,
    recorded: &Recorded<'_>,
    driven: &mut ControlledActors,
    now: &Instant,
    next: (i64, &EgoState),
) -> Vec<SimActor> {
    let (t_us, ego) = next;
    let by_log = recorded.actors_at(t_us, &driven.triggers);
    if policy == ActorPolicy::Replay && recorded.log.edits.first_simulated().is_none() {
        return by_log;
    }
    let near = |ego: &EgoState, actor: &SimActor| {
        ego.position_m().distance(actor.cuboid.pose.translation.truncate()) <= REACH_M
    };
    for actor in now.actors.iter().filter(|actor| near(&now.ego, actor)) {
        let policy = match recorded.log.script.command(actor.track, t_us, &driven.triggers) {
            Command::Idm => ActorPolicy::Idm,
            Command::Free => policy,
            Command::Script | Command::Absent => ActorPolicy::Replay,
        };
        if policy == ActorPolicy::Replay {
            driven.movers.remove(&actor.track);
        } else if !driven.movers.contains_key(&actor.track) {
            let mover = Mover::join(policy, recorded, actor, now.t_us, &driven.triggers);
            driven.movers.extend(mover.map(|mover| (actor.track, mover)));
        }
    }
    let others = Others::new(now);
    let dt_s = seconds(now.t_us, t_us);
    let mut actors = Vec::new();
    for actor in &now.actors {
        let Some(mover) = driven.movers.get_mut(&actor.track) else { continue };
        let sizes = recorded.log.script.sizes_at(actor.track, t_us, &driven.triggers);
        let moved = mover.step(actor, &others, dt_s, sizes);
        if near(ego, &moved) {
            actors.push(moved);
        } else {
            driven.movers.remove(&actor.track);
            driven.gone.insert(actor.track);
        }
    }
    let is_scripted =
        |track: usize| recorded.log.script.command(track, t_us, &driven.triggers) == Command::Script;
    let follows = |a: &SimActor| {
        !driven.movers.contains_key(&a.track) && (!driven.gone.contains(&a.track) || is_scripted(a.track))
    };
    actors.extend(by_log.into_iter().filter(follows));
    actors.sort_by_key(|actor| actor.track);
    actors
}

/// Tests the conditions of the scenario at an instant, and moves the actors whose changes begin or end there.
pub(super) fn meet_conditions(recorded: &Recorded<'_>, instant: &mut Instant, driven: &mut ControlledActors) {
    let (script, t_us) = (&recorded.log.script, instant.t_us);
    let cuboid_of = |track: usize| instant.actors.iter().find(|a| a.track == track).map(|a| a.cuboid);
    if !script.fire(t_us, instant.ego.position_m(), &cuboid_of, &mut driven.triggers) {
        return;
    }
    let triggers = &driven.triggers;
    let moved =
        |track: usize| matches!(script.command(track, t_us, triggers), Command::Script | Command::Absent);
    driven.movers.retain(|track, _| !moved(*track));
    instant.actors.retain(|a| driven.movers.contains_key(&a.track) || script.tracks().all(|t| t != a.track));
    for actor in &mut instant.actors {
        if let Some([_, size]) = script.sizes_at(actor.track, t_us, triggers) {
            actor.cuboid = actor.cuboid.resized(size);
        }
    }
    let free = script.tracks().filter(|track| !driven.movers.contains_key(track));
    let free = free.filter(|track| !driven.gone.contains(track) || moved(*track));
    let actor = |track: usize| {
        let cuboid = script.box_at(track, t_us, triggers)?;
        Some(recorded.actor_of(TrackBox { track, cuboid }, t_us, triggers))
    };
    instant.actors.extend(free.filter_map(actor));
    instant.actors.sort_by_key(|actor| actor.track);
}

/// Returns the recorded state at a time after its conditions are tested; `None` outside the log.
pub(super) fn replayed(
    recorded: &Recorded<'_>,
    step: usize,
    t_us: i64,
    driven: &mut ControlledActors,
) -> Option<Instant> {
    let mut instant = recorded.instant(step, t_us, &driven.triggers)?;
    meet_conditions(recorded, &mut instant, driven);
    Some(instant)
}
