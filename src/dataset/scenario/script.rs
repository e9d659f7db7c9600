use std::collections::BTreeMap;

use glam::{DQuat, DVec2, DVec3};

use super::change::{Place, Shift};
use super::ground::Ground;
use super::motion::Motion;
use super::place::{Axes, standing};
use super::triggers::Triggers;
use crate::dataset::{Appearance, Recording};
use crate::geometry::{Cuboid, Pose};

/// Timed changes of a log's actors, in its global frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Script {
    /// In the order of the changes.
    pub(super) steps: Vec<Step>,
    /// Changed tracks.
    pub(super) actors: BTreeMap<usize, ScriptActor>,
    /// Times of the log's frames, absolute microseconds.
    pub(super) times_us: Vec<i64>,
    pub(super) ground: Ground,
}

/// Actor of a script.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ScriptActor {
    /// Box in each frame without timed changes.
    pub(super) boxes: Vec<Option<Cuboid>>,
    /// Length, width and height where the script places it, meters.
    pub(super) size: DVec3,
    /// Its changes, as indices in ascending order.
    pub(super) steps: Vec<usize>,
}

/// One change.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Step {
    pub(super) track: usize,
    pub(super) deed: Deed,
    pub(super) start: Event,
    pub(super) end: Option<Event>,
}

impl Step {
    /// Returns whether a change between two times applies at a time, absolute microseconds.
    fn applies(&self, t_us: i64) -> bool {
        matches!(self.start, Event::At(start_us) if start_us <= t_us)
            && self.end.as_ref().is_none_or(|end| matches!(end, Event::At(end_us) if t_us < *end_us))
    }
}

/// What a change does.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Deed {
    Insert(Place, Axes),
    Remove,
    /// `None` for the actor's own axes at the start.
    Move(Place, Option<Axes>),
    Shift(Shift),
    /// As `Move`; the motion is in the frame of the axes.
    Path(Motion, Option<Axes>),
    Idm,
    /// Length, width and height, meters.
    Resize(DVec3),
    /// With the size of the track that is looked like, meters.
    Replace(Appearance, Option<DVec3>),
}

impl Deed {
    /// Returns whether it changes how an actor moves rather than its size or look.
    fn moves(&self) -> bool {
        !matches!(self, Self::Resize(_) | Self::Replace(..))
    }

    /// Returns the size that it gives an actor, meters.
    fn size(&self) -> Option<DVec3> {
        match self {
            Self::Resize(size) => Some(*size),
            Self::Replace(_, size) => *size,
            _ => None,
        }
    }
}

/// Begin or end of a change.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Event {
    /// Absolute microseconds.
    At(i64),
    /// The ego is within a distance (meters) of a target.
    Near(f64, Target),
}

/// What the ego is near to.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Target {
    Track(usize),
    /// Global meters.
    Point(DVec2),
}

/// Who moves an actor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// The log, or the policy of a simulation.
    Free,
    /// The script.
    Script,
    /// The Intelligent Driver Model, along the path of log or script.
    Idm,
    /// The actor is removed.
    Absent,
}

impl Script {
    /// Returns whether there are no changes.
    pub fn is_empty(&self) -> bool {
        self.steps.is_empty()
    }

    /// Returns the changed tracks, in ascending order.
    pub fn tracks(&self) -> impl Iterator<Item = usize> {
        self.actors.keys().copied()
    }

    /// Returns a changed track's boxes in the log's frames without timed changes; `None` for other tracks.
    pub fn boxes_of_log(&self, track: usize) -> Option<Vec<(i64, Cuboid)>> {
        let boxes = self.actors.get(&track)?.boxes.iter().zip(&self.times_us);
        Some(boxes.filter_map(|(cuboid, t_us)| Some((*t_us, (*cuboid)?))).collect())
    }

    /// Returns who moves an actor at a time, absolute microseconds.
    pub fn command(&self, track: usize, t_us: i64, triggers: &Triggers) -> Command {
        let last = self.applying(track, t_us, triggers).find(|(deed, _)| deed.moves());
        last.map_or(Command::Free, |(deed, _)| match deed {
            Deed::Idm => Command::Idm,
            Deed::Remove => Command::Absent,
            _ => Command::Script,
        })
    }

    /// Returns the begin of the change that decides where an actor is at a time, both absolute microseconds;
    /// `None` if none applies.
    pub fn since(&self, track: usize, t_us: i64, triggers: &Triggers) -> Option<i64> {
        self.applying(track, t_us, triggers).find(|(deed, _)| deed.moves()).map(|(_, since_us)| since_us)
    }

    /// Returns the changes of an actor that apply at a time with their begins (both absolute microseconds),
    /// the last one first.
    fn applying(&self, track: usize, t_us: i64, triggers: &Triggers) -> impl Iterator<Item = (&Deed, i64)> {
        let steps = self.actors.get(&track).map_or(&[][..], |actor| &actor.steps);
        steps
            .iter()
            .rev()
            .filter_map(move |step| Some((&self.steps[*step].deed, triggers.since(*step, t_us)?)))
    }

    /// Returns what a track looks like at a time (absolute microseconds) by its last change of the look;
    /// `None` without one.
    pub fn look_at(&self, track: usize, t_us: i64) -> Option<&Appearance> {
        let changed = self.actors.get(&track)?.steps.iter().rev().map(|step| &self.steps[*step]);
        changed.filter(|step| step.applies(t_us)).find_map(|step| match &step.deed {
            Deed::Replace(look, _) => Some(look),
            _ => None,
        })
    }

    /// Returns the sizes (meters) of a track that has changes of its size: without any, and at a time,
    /// absolute microseconds. `None` for other tracks.
    pub fn sizes_at(&self, track: usize, t_us: i64, triggers: &Triggers) -> Option<[DVec3; 2]> {
        let actor = self.actors.get(&track)?;
        actor.steps.iter().find(|step| self.steps[**step].deed.size().is_some())?;
        let now = self.applying(track, t_us, triggers).find_map(|(deed, _)| deed.size());
        Some([actor.size, now.unwrap_or(actor.size)])
    }

    /// Returns whether an actor that follows a driver model drives along the path of the script rather than
    /// the log's.
    pub fn has_path(&self, track: usize, t_us: i64, triggers: &Triggers) -> bool {
        self.applying(track, t_us, triggers).any(|(deed, _)| deed.moves() && !matches!(deed, Deed::Idm))
    }

    /// Returns the box of a changed track at a time (absolute microseconds), which may lie after the log;
    /// `None` if it is not there. Actors under [`Command::Idm`] are where they would be without it.
    pub fn box_at(&self, track: usize, t_us: i64, triggers: &Triggers) -> Option<Cuboid> {
        let actor = self.actors.get(&track)?;
        let cuboid = self.before(actor, actor.steps.len(), t_us, triggers)?;
        let size = self.applying(track, t_us, triggers).find_map(|(deed, _)| deed.size());
        Some(size.map_or(cuboid, |size| cuboid.resized(size)))
    }

    /// Returns the box of an actor by its first `count` changes, without changes of its size. The last one
    /// that applies decides.
    fn before(&self, actor: &ScriptActor, count: usize, t_us: i64, triggers: &Triggers) -> Option<Cuboid> {
        for (place, step) in actor.steps[..count].iter().enumerate().rev() {
            let Some(since_us) = triggers.since(*step, t_us) else { continue };
            let anchored = |given: &Option<Axes>| match given {
                Some(axes) => Some((*axes, 0.0)),
                None => self.before(actor, place, since_us, triggers).map(|cuboid| self.anchor(&cuboid)),
            };
            let ((center, yaw_rad), rise_m) = match &self.steps[*step].deed {
                Deed::Idm | Deed::Resize(_) | Deed::Replace(..) => continue,
                Deed::Remove => return None,
                Deed::Shift(shift) => {
                    return self.before(actor, place, t_us, triggers).map(|cuboid| shifted(&cuboid, shift));
                }
                Deed::Insert(place, axes) => (axes.place(place), 0.0),
                Deed::Move(place, given) => {
                    let (axes, rise_m) = anchored(given)?;
                    (axes.place(place), rise_m)
                }
                Deed::Path(motion, given) => {
                    let (axes, rise_m) = anchored(given)?;
                    let (point, yaw_rad) = motion.at((t_us - since_us) as f64 / 1e6);
                    ((axes.point(point.x, point.y), axes.yaw_rad + yaw_rad), rise_m)
                }
            };
            let mut cuboid = standing(center, yaw_rad, actor.size, &self.ground);
            cuboid.pose.translation.z += rise_m;
            return Some(cuboid);
        }
        self.logged(actor, t_us)
    }

    /// Returns the axes of a box, and how high it is above the ground (meters): roads rise to their sides.
    fn anchor(&self, cuboid: &Cuboid) -> (Axes, f64) {
        let Pose { translation, .. } = cuboid.pose;
        let ground_m = self.ground.height_m(translation.truncate());
        (Axes::of(&cuboid.pose), translation.z - cuboid.size.z / 2.0 - ground_m)
    }

    /// Returns the box of the log, interpolated as [`Recording::boxes_at`] does.
    fn logged(&self, actor: &ScriptActor, t_us: i64) -> Option<Cuboid> {
        let next = self.times_us.partition_point(|time| *time < t_us);
        let after = actor.boxes.get(next).copied().flatten()?;
        if self.times_us[next] == t_us {
            return Some(after);
        }
        let [from_us, to_us] = [*self.times_us.get(next.checked_sub(1)?)?, self.times_us[next]];
        let before = actor.boxes[next - 1]?;
        Some(before.interpolate(&after, (t_us - from_us) as f64 / (to_us - from_us) as f64))
    }

    /// Returns the triggers that are known without an ego.
    pub fn timed(&self) -> Triggers {
        let at = |event: &Event| match event {
            Event::At(t_us) => Some(*t_us),
            Event::Near(..) => None,
        };
        Triggers(self.steps.iter().map(|s| [at(&s.start), s.end.as_ref().and_then(at)]).collect())
    }

    /// Returns whether triggers can belong to this script: one pair per change, with its times.
    pub fn fits(&self, triggers: &Triggers) -> bool {
        let timed = self.timed();
        let fits = |(timed, found): (&[Option<i64>; 2], &[Option<i64>; 2])| {
            timed.iter().zip(found).all(|(timed, found)| timed.is_none() || timed == found)
        };
        timed.0.len() == triggers.0.len() && timed.0.iter().zip(&triggers.0).all(fits)
    }

    /// Returns the triggers of the recorded ego in all frames before a time, absolute microseconds.
    pub fn recorded(&self, log: &Recording, before_us: i64) -> Triggers {
        let mut triggers = self.timed();
        for frame in log.frames.iter().filter(|frame| frame.t_us < before_us) {
            let known = triggers.clone();
            let of = |track: usize| match self.actors.contains_key(&track) {
                true => self.box_at(track, frame.t_us, &known),
                false => frame.cuboid_of(track),
            };
            self.fire(frame.t_us, frame.global_from_ego.translation.truncate(), &of, &mut triggers);
        }
        triggers
    }

    /// Returns the triggers as they were known at a time, absolute microseconds.
    pub fn known_at(&self, triggers: &Triggers, t_us: i64) -> Triggers {
        let mut known = triggers.clone();
        for (step, times) in self.steps.iter().zip(&mut known.0) {
            for (event, time) in [Some(&step.start), step.end.as_ref()].into_iter().zip(times) {
                let is_later = matches!(event, Some(Event::Near(..))) && time.is_some_and(|time| time > t_us);
                *time = time.filter(|_| !is_later);
            }
        }
        known
    }

    /// Sets the triggers whose conditions are met at a time (absolute microseconds), with the ego (global
    /// meters) and the actors there. Returns whether there are any. A change of an actor that is not there
    /// waits, unless it inserts the actor; an end waits for the start.
    pub fn fire(
        &self,
        t_us: i64,
        ego: DVec2,
        cuboid_of: &dyn Fn(usize) -> Option<Cuboid>,
        triggers: &mut Triggers,
    ) -> bool {
        let is_met = |event: &Event| match event {
            Event::At(_) => false,
            Event::Near(distance_m, target) => {
                let place = match target {
                    Target::Track(track) => cuboid_of(*track).map(|c| c.pose.translation.truncate()),
                    Target::Point(point) => Some(*point),
                };
                place.is_some_and(|place| place.distance(ego) <= *distance_m)
            }
        };
        let mut has_fired = false;
        for (step, [start, end]) in self.steps.iter().zip(&mut triggers.0) {
            if start.is_none() {
                let waits = !matches!(step.deed, Deed::Insert(..)) && cuboid_of(step.track).is_none();
                if !waits && is_met(&step.start) {
                    (*start, has_fired) = (Some(t_us), true);
                }
            } else if end.is_none()
                && start.is_some_and(|start| start < t_us)
                && step.end.as_ref().is_some_and(is_met)
            {
                (*end, has_fired) = (Some(t_us), true);
            }
        }
        has_fired
    }
}

/// Returns a box displaced in its own frame.
fn shifted(cuboid: &Cuboid, shift: &Shift) -> Cuboid {
    let Shift { forward_m, left_m, up_m, yaw_deg } = *shift;
    let rotation = DQuat::from_rotation_z(yaw_deg.to_radians());
    let moved = Pose { rotation, translation: DVec3::new(forward_m, left_m, up_m) };
    Cuboid { pose: cuboid.pose * moved, ..*cuboid }
}
