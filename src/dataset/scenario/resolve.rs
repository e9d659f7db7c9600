use std::collections::BTreeMap;

use glam::{DVec2, DVec3};

use super::change::{Action, Anchor, Change, EgoWithin, Place, Shift, Time, When};
use super::ground::Ground;
use super::motion::Motion;
use super::place::Axes;
use super::script::{Deed, Event, Script, ScriptActor, Step, Target};
use crate::dataset::{Appearance, EditError, EgoTrack, Recording};
use crate::files::text::printable;
use crate::geometry::{Cuboid, Pose};

/// Maximum number of changes, which bounds the time for a box.
const MAX_CHANGES: usize = 1000;
/// Maximum speed, meters per second.
const MAX_SPEED_MPS: f64 = 100.0;
/// Maximum distance from the log, or from an actor in its own frame, meters.
const MAX_DISTANCE_M: f64 = 1e5;
/// Maximum shift along an axis, meters.
const MAX_SHIFT_M: f64 = 1e3;

/// Checks changes against a log and places them in its global frame. The log has its inserted tracks, without
/// boxes; `sizes` has the changed tracks, meters.
///
/// # Errors
/// Fails if a track, time or number of a change does not fit the log.
pub(in crate::dataset) fn resolve(
    changes: &[Change],
    log: &Recording,
    sizes: &BTreeMap<usize, DVec3>,
) -> Result<Script, EditError> {
    let times_us: Vec<i64> = log.frames.iter().map(|frame| frame.t_us).collect();
    let mut script = Script { times_us, ground: Ground::of(log), ..Script::default() };
    let origin = log.frames.first().map_or(DVec2::ZERO, |f| f.global_from_ego.translation.truncate());
    let context = Context { log, ego: EgoTrack::new(log), ends_us: log.ends_us(), origin };
    for (index, change) in changes.iter().enumerate() {
        let wrong = |(expected, found): Mismatch| EditError::Change {
            number: index + 1,
            track: change.track.clone(),
            expected,
            found,
        };
        if index == MAX_CHANGES {
            return Err(wrong((format!("at most {MAX_CHANGES} changes"), changes.len().to_string())));
        }
        let step = context.step(change, &script).map_err(wrong)?;
        let boxes = || log.frames.iter().map(|frame| frame.cuboid_of(step.track)).collect();
        let size = sizes.get(&step.track).copied().unwrap_or(DVec3::ONE);
        let new = || ScriptActor { boxes: boxes(), size, steps: Vec::new() };
        script.actors.entry(step.track).or_insert_with(new).steps.push(index);
        script.steps.push(step);
        script.check_start(index).map_err(wrong)?;
    }
    Ok(script)
}

/// What was expected and what was found.
pub(super) type Mismatch = (String, String);

struct Context<'a> {
    log: &'a Recording,
    ego: EgoTrack,
    /// First and last frame, absolute microseconds.
    ends_us: Option<[i64; 2]>,
    /// First ego origin, global meters.
    origin: DVec2,
}

impl Context<'_> {
    fn step(&self, change: &Change, script: &Script) -> Result<Step, Mismatch> {
        let track = self.track(&change.track)?;
        let is_first = !script.actors.contains_key(&track);
        let deed = match &change.action {
            Action::Insert(insert) if is_first => {
                let axes = self.axes(&insert.at.anchor)?;
                let axes = axes.ok_or_else(|| mismatch("a place in the frame of ego or globe", "actor"))?;
                self.check_place(&insert.at, Some(axes))?;
                Deed::Insert(insert.at.clone(), axes)
            }
            Action::Insert(_) => return Err(mismatch("a track that no earlier change has", "another one")),
            Action::Remove => Deed::Remove,
            Action::Move(place) => {
                let axes = self.axes(&place.anchor)?;
                self.check_place(place, axes)?;
                Deed::Move(place.clone(), axes)
            }
            Action::Shift(shift) => Deed::Shift(checked_shift(*shift)?),
            Action::Path(path) => {
                let points = path.points.iter().map(|p| (DVec2::new(p.x_m, p.y_m), p.speed_mps));
                let points: Vec<(DVec2, f64)> = points.collect();
                let axes = self.axes(&path.anchor)?;
                let is_near = |(point, speed): &(DVec2, f64)| {
                    *speed <= MAX_SPEED_MPS && self.is_near(axes, point.x, point.y)
                };
                let motion = Motion::new(&points).filter(|_| points.iter().all(is_near));
                let motion = motion.ok_or_else(|| {
                    let expected = format!(
                        "a path of two or more points that differ, at most {MAX_DISTANCE_M} m away, with \
                            speeds of 0 to {MAX_SPEED_MPS} m/s, of consecutive ones at most one 0"
                    );
                    (
                        expected,
                        format!("{:?}", points.iter().map(|(p, v)| [p.x, p.y, *v]).collect::<Vec<_>>()),
                    )
                })?;
                Deed::Path(motion, axes)
            }
            Action::Idm => Deed::Idm,
            Action::Resize(size_m) => Deed::Resize(checked_size(*size_m)?),
            Action::Replace(look) => self.replaced(track, look)?,
        };
        let own = match &deed {
            Deed::Insert(place, axes) => Target::Point(axes.place(place).0),
            _ => Target::Track(track),
        };
        let first = When::TUs(self.ends_us.map_or(0, |[first_us, _]| first_us));
        let start = self.event(change.start.as_ref().unwrap_or(&first), &own, true)?;
        let end = change.end.as_ref().map(|end| self.event(end, &Target::Track(track), false)).transpose()?;
        let waits = [Some(&start), end.as_ref()].into_iter().flatten().any(|e| matches!(e, Event::Near(..)));
        if waits && matches!(deed, Deed::Replace(..)) {
            return Err(mismatch("replace from a time on, to a time", "a condition"));
        }
        if let (Event::At(start_us), Some(Event::At(end_us))) = (&start, &end)
            && end_us <= start_us
        {
            return Err((format!("an end after the start at {start_us} us"), end_us.to_string()));
        }
        Ok(Step { track, deed, start, end })
    }

    fn track(&self, id: &str) -> Result<usize, Mismatch> {
        let found = self.log.tracks.iter().position(|track| track.id == id);
        found.ok_or_else(|| {
            let expected = format!("a track of log {} or an inserted one", self.log.shown_name());
            (expected, format!("{:?}", printable(id)))
        })
    }

    /// Returns the deed of another look.
    fn replaced(&self, track: usize, look: &Appearance) -> Result<Deed, Mismatch> {
        let size = match look {
            Appearance::Template => None,
            Appearance::Track(other) => {
                let class = self.log.tracks[track].class;
                let fits = |other: &usize| {
                    self.log.tracks[*other].class == class && !self.log.track_boxes(*other).is_empty()
                };
                let found = self.log.tracks.iter().position(|known| known.id == *other).filter(fits);
                let missing =
                    || mismatch("the look of a track with the actor's class", &format!("{other:?}"));
                Some(self.log.median_size(found.ok_or_else(missing)?))
            }
            Appearance::File(_) | Appearance::Skeleton { .. } => {
                return Err(mismatch(
                    "a track of the log, or template: files are for the whole log",
                    "a file",
                ));
            }
        };
        Ok(Deed::Replace(look.clone(), size))
    }

    /// Returns the axes of an anchor; `None` for the actor's own.
    fn axes(&self, anchor: &Anchor) -> Result<Option<Axes>, Mismatch> {
        Ok(match anchor {
            Anchor::Global => Some(Axes::GLOBAL),
            Anchor::Actor => None,
            Anchor::Ego(time) => {
                let t_us = self.time(*time)?;
                let pose = self.ego.at(t_us).ok_or_else(|| self.outside(t_us))?;
                Some(Axes::of(&pose))
            }
        })
    }

    /// Returns a time within the log, absolute microseconds.
    fn time(&self, time: Time) -> Result<i64, Mismatch> {
        let t_us = self.absolute(time)?;
        let [first_us, last_us] = self.ends_us.unwrap_or_default();
        if (first_us..=last_us).contains(&t_us) { Ok(t_us) } else { Err(self.outside(t_us)) }
    }

    fn absolute(&self, time: Time) -> Result<i64, Mismatch> {
        let [first_us, _] = self.ends_us.unwrap_or_default();
        match time {
            Time::TUs(t_us) => Ok(t_us),
            Time::AfterS(s) if s.abs() < 1e9 => Ok(first_us.saturating_add((s * 1e6).round() as i64)),
            Time::AfterS(s) => Err(mismatch("seconds after the first frame", &s.to_string())),
        }
    }

    fn outside(&self, t_us: i64) -> Mismatch {
        let [first_us, last_us] = self.ends_us.unwrap_or_default();
        (format!("a time of the log ({first_us} to {last_us} us)"), t_us.to_string())
    }

    /// Returns an event; `own` is the target by default. Ends may lie after the log, where a simulation may
    /// go on.
    fn event(&self, when: &When, own: &Target, is_start: bool) -> Result<Event, Mismatch> {
        let time = match when {
            When::TUs(t_us) => Time::TUs(*t_us),
            When::AfterS(s) => Time::AfterS(*s),
            When::EgoWithin(condition) => return self.near(condition, own),
        };
        Ok(Event::At(if is_start { self.time(time)? } else { self.absolute(time)? }))
    }

    fn near(&self, condition: &EgoWithin, own: &Target) -> Result<Event, Mismatch> {
        let EgoWithin { distance_m, track, point_m } = condition;
        if !(*distance_m > 0.0 && *distance_m <= MAX_DISTANCE_M) {
            let expected = format!("a distance of more than 0 and at most {MAX_DISTANCE_M} m");
            return Err((expected, distance_m.to_string()));
        }
        let target = match (track, point_m) {
            (Some(_), Some(_)) => return Err(mismatch("the distance from a track or a point", "both")),
            (Some(track), None) => Target::Track(self.track(track)?),
            (None, Some(point)) => Target::Point(finite_point(*point)?),
            (None, None) => own.clone(),
        };
        Ok(Event::Near(*distance_m, target))
    }

    /// Checks that an actor can stand at a place.
    fn check_place(&self, place: &Place, axes: Option<Axes>) -> Result<(), Mismatch> {
        if place.yaw_deg.is_finite() && self.is_near(axes, place.x_m, place.y_m) {
            return Ok(());
        }
        let expected = format!("a place at most {MAX_DISTANCE_M} m away, with a finite yaw_deg");
        Err((expected, format!("{:?}", [place.x_m, place.y_m, place.yaw_deg])))
    }

    /// Returns whether a point (meters) is near the log, or near the actor in its own frame.
    fn is_near(&self, axes: Option<Axes>, x_m: f64, y_m: f64) -> bool {
        let arm = match axes {
            Some(axes) => axes.point(x_m, y_m) - self.origin,
            None => DVec2::new(x_m, y_m),
        };
        arm.abs().max_element() <= MAX_DISTANCE_M // not for NaN
    }
}

impl Script {
    /// Checks that an actor is there when a change of it begins, as far as the time is known.
    fn check_start(&self, index: usize) -> Result<(), Mismatch> {
        let step = &self.steps[index];
        let needs_box = matches!(step.deed, Deed::Move(_, None) | Deed::Path(_, None));
        let (Event::At(t_us), true) = (&step.start, needs_box) else { return Ok(()) };
        let mut before = self.timed();
        before.0.truncate(index);
        match self.box_at(step.track, *t_us, &before) {
            Some(_) => Ok(()),
            None => Err(mismatch("an actor with a box at the start, for a place in its frame", "none")),
        }
    }
}

fn checked_shift(shift: Shift) -> Result<Shift, Mismatch> {
    let Shift { forward_m, left_m, up_m, yaw_deg } = shift;
    let is_near = [forward_m, left_m, up_m].iter().all(|part| part.abs() <= MAX_SHIFT_M);
    if is_near && yaw_deg.is_finite() {
        return Ok(shift);
    }
    let expected = format!("a shift of at most {MAX_SHIFT_M} m and a finite yaw_deg");
    Err((expected, format!("{shift:?}")))
}

fn checked_size(size_m: [f64; 3]) -> Result<DVec3, Mismatch> {
    let is_size = Cuboid::new(Pose::IDENTITY, size_m.into()).is_ok();
    if is_size { Ok(size_m.into()) } else { Err(mismatch("the size of a box", &format!("{size_m:?} m"))) }
}

fn finite_point(point: [f64; 2]) -> Result<DVec2, Mismatch> {
    let at = DVec2::from(point);
    if at.is_finite() { Ok(at) } else { Err(mismatch("a finite point_m", &format!("{point:?}"))) }
}

pub(super) fn mismatch(expected: &str, found: &str) -> Mismatch {
    (expected.to_owned(), found.to_owned())
}
