use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use serde::{Serialize, Serializer};

use super::{Recording, Track};
use crate::files::text::printable;
use crate::geometry::{Cuboid, ParseOptionError, Pose};

/// Text form of [`Appearance::Template`].
const TEMPLATE: &str = "template";

/// Changes of a log's actors.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ActorEdits {
    /// Tracks that stand in all frames where they are at a time, absolute microseconds.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub hold: BTreeMap<String, i64>,
    /// Tracks that look like something else, on their own paths.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub replace: BTreeMap<String, Appearance>,
}

/// What a track looks like.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Appearance {
    /// Another track of the log: its points, category and size.
    Track(String),
    /// The template of its category, as if it had no points of its own.
    Template,
}

/// Edits that a log does not allow.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EditError {
    /// Track that does not exist or that has no box.
    #[error("expected tracks of log {}, found {:?}", printable(log), printable(track))]
    NoTrack {
        /// The track.
        track: String,
        /// Name of the log.
        log: String,
    },
    /// Time at which a track has no box.
    #[error(
        "expected a time at which track {} of log {} has a box ({first_us} to {last_us} us), found {t_us}",
        printable(track),
        printable(log)
    )]
    NoBox {
        /// The track.
        track: String,
        /// Name of the log.
        log: String,
        /// Times of its first and last box, absolute microseconds.
        first_us: i64,
        /// See `first_us`.
        last_us: i64,
        /// The time, absolute microseconds.
        t_us: i64,
    },
}

impl ActorEdits {
    /// Returns whether nothing is changed.
    pub fn is_empty(&self) -> bool {
        self.hold.is_empty() && self.replace.is_empty()
    }

    /// Returns the track whose points in the skeleton show a track; `None` for those of a template.
    pub fn asset<'a>(&'a self, track: &'a str) -> Option<&'a str> {
        Appearance::asset(self.replace.get(track), track)
    }

    /// Returns the log with the edits; `log` has none.
    ///
    /// # Errors
    /// Fails if a track does not exist, or has no box at the time where it is held.
    pub(super) fn apply(&self, log: &Recording) -> Result<Recording, EditError> {
        let mut edited = log.clone();
        edited.edits = self.clone();
        for (id, t_us) in &self.hold {
            let track = index(log, id)?;
            let held = log.boxes_at(*t_us).into_iter().find(|item| item.track == track);
            let held = held.ok_or_else(|| no_box(log, track, *t_us))?;
            for frame in &mut edited.frames {
                match frame.boxes.binary_search_by_key(&track, |item| item.track) {
                    Ok(at) => frame.boxes[at] = held,
                    Err(at) => frame.boxes.insert(at, held),
                }
            }
        }
        for (id, appearance) in &self.replace {
            let track = index(log, id)?;
            let Appearance::Track(other) = appearance else { continue };
            let like = index(log, other)?;
            let Track { category, class, .. } = log.tracks[like].clone();
            edited.tracks[track] = Track { category, class, ..edited.tracks[track].clone() };
            let size = median_size(log, like);
            let boxes = edited.frames.iter_mut().flat_map(|frame| &mut frame.boxes);
            for item in boxes.filter(|item| item.track == track) {
                item.cuboid = on_ground(&item.cuboid, size);
            }
        }
        Ok(edited)
    }
}

/// Returns the index of a track that has a box.
fn index(log: &Recording, id: &str) -> Result<usize, EditError> {
    let found = log.tracks.iter().position(|track| track.id == id);
    let found = found.filter(|track| log.frames.iter().any(|frame| frame.cuboid_of(*track).is_some()));
    found.ok_or_else(|| EditError::NoTrack { track: id.to_owned(), log: log.name.clone() })
}

fn no_box(log: &Recording, track: usize, t_us: i64) -> EditError {
    let boxes = log.track_boxes(track);
    let time_us = |at: Option<&(usize, Cuboid)>| at.map_or(0, |(frame, _)| log.frames[*frame].t_us);
    let (first_us, last_us) = (time_us(boxes.first()), time_us(boxes.last()));
    let (track, log) = (log.tracks[track].id.clone(), log.name.clone());
    EditError::NoBox { track, log, first_us, last_us, t_us }
}

/// Returns the median length, width and height of a track's boxes, meters; it has at least one.
fn median_size(log: &Recording, track: usize) -> glam::DVec3 {
    let boxes = log.track_boxes(track);
    let median = |axis: usize| {
        let mut sizes: Vec<f64> = boxes.iter().map(|(_, cuboid)| cuboid.size[axis]).collect();
        sizes.sort_by(f64::total_cmp);
        sizes[sizes.len() / 2]
    };
    glam::DVec3::new(median(0), median(1), median(2))
}

/// Returns a box of another size on the same ground.
fn on_ground(cuboid: &Cuboid, size: glam::DVec3) -> Cuboid {
    let up = cuboid.pose.rotation * (glam::DVec3::Z * ((size.z - cuboid.size.z) / 2.0));
    Cuboid { pose: Pose { translation: cuboid.pose.translation + up, ..cuboid.pose }, size }
}

impl Appearance {
    /// Returns the track whose points show a track with this appearance; `None` for those of a template.
    pub(crate) fn asset<'a>(appearance: Option<&'a Self>, track: &'a str) -> Option<&'a str> {
        match appearance {
            None => Some(track),
            Some(Self::Track(other)) => Some(other),
            Some(Self::Template) => None,
        }
    }
}

impl fmt::Display for Appearance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Track(track) => track,
            Self::Template => TEMPLATE,
        })
    }
}

impl From<&str> for Appearance {
    /// Parses the id of a track, or `template`.
    fn from(text: &str) -> Self {
        if text == TEMPLATE { Self::Template } else { Self::Track(text.to_owned()) }
    }
}

impl Serialize for Appearance {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// One track that is held: `TRACK@T_US`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HeldTrack(pub String, pub i64);

/// One track that is replaced: `TRACK=TRACK`, or `TRACK=template`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReplacedTrack(pub String, pub Appearance);

impl FromStr for HeldTrack {
    type Err = ParseOptionError;

    fn from_str(text: &str) -> Result<Self, ParseOptionError> {
        let parts = text.rsplit_once('@').filter(|(track, _)| !track.is_empty());
        let held = parts.and_then(|(track, t_us)| Some(Self(track.to_owned(), t_us.parse().ok()?)));
        let expected = "TRACK@T_US, a track and an absolute time in microseconds";
        held.ok_or_else(|| ParseOptionError { expected, found: text.to_owned() })
    }
}

impl FromStr for ReplacedTrack {
    type Err = ParseOptionError;

    fn from_str(text: &str) -> Result<Self, ParseOptionError> {
        let parts = text.split_once('=').filter(|(track, by)| !track.is_empty() && !by.is_empty());
        let expected = "TRACK=TRACK or TRACK=template";
        let (track, by) = parts.ok_or_else(|| ParseOptionError { expected, found: text.to_owned() })?;
        Ok(Self(track.to_owned(), by.into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{Class, Frame, TrackBox};
    use glam::DVec3;

    /// Two cars and a bus; the second car is only in the first two of three frames.
    fn log() -> Recording {
        let track = |(id, category): (&str, &str)| Track {
            id: id.to_owned(),
            category: category.to_owned(),
            class: Class::from_category(category),
        };
        let cuboid = |x: f64, size: [f64; 3]| {
            let center = DVec3::new(x, 0.0, size[2] / 2.0);
            Cuboid::new(Pose::from_yaw(0.3, center), DVec3::from(size)).unwrap()
        };
        let frame = |i: usize| {
            let x = i as f64 * 2.0;
            let sizes = [[4.0, 2.0, 1.5], [4.5, 2.0, 1.6], [12.0, 2.5, 3.0]];
            let boxes = (0..3).filter(|track| *track != 1 || i < 2);
            let boxes = boxes.map(|track| TrackBox { track, cuboid: cuboid(x + track as f64, sizes[track]) });
            let (sweeps, images, between_images) = Default::default();
            let (t_us, global_from_ego) = (i as i64 * 100_000, Pose::IDENTITY);
            Frame { t_us, global_from_ego, sweeps, images, between_images, boxes: boxes.collect() }
        };
        let tracks =
            [("a", "vehicle.car"), ("b", "vehicle.car"), ("bus", "vehicle.bus.rigid")].map(track).to_vec();
        Recording { name: "log".into(), tracks, frames: (0..3).map(frame).collect(), ..Recording::default() }
    }

    fn edits(hold: &[(&str, i64)], replace: &[(&str, &str)]) -> ActorEdits {
        ActorEdits {
            hold: hold.iter().map(|(track, t_us)| ((*track).to_owned(), *t_us)).collect(),
            replace: replace.iter().map(|(track, by)| ((*track).to_owned(), (*by).into())).collect(),
        }
    }

    #[test]
    fn a_held_track_stands_in_all_frames() {
        let log = log();
        let held = edits(&[("b", 50_000)], &[]).apply(&log).unwrap();
        for (frame, before) in held.frames.iter().zip(&log.frames) {
            let center = frame.cuboid_of(1).unwrap().pose.translation;
            assert!(center.distance(DVec3::new(2.0, 0.0, 0.8)) < 1e-12, "{center}");
            assert_eq!([0, 2].map(|track| frame.cuboid_of(track)), [0, 2].map(|t| before.cuboid_of(t)));
            assert!(frame.boxes.is_sorted_by_key(|item| item.track));
        }
        assert_eq!((&held.tracks, held.edits.asset("b")), (&log.tracks, Some("b")));
    }

    #[test]
    fn a_replaced_track_has_the_size_of_the_other_on_its_own_ground() {
        let log = log();
        let both = edits(&[("a", 0)], &[("a", "bus"), ("bus", "template")]).apply(&log).unwrap();
        assert_eq!(
            (both.tracks[0].id.as_str(), both.tracks[0].category.as_str()),
            ("a", "vehicle.bus.rigid")
        );
        for frame in &both.frames {
            let cuboid = frame.cuboid_of(0).unwrap();
            assert_eq!(cuboid.size, DVec3::new(12.0, 2.5, 3.0));
            assert!(cuboid.pose.translation.distance(DVec3::new(0.0, 0.0, 1.5)) < 1e-12);
        }
        assert_eq!((both.edits.asset("a"), both.edits.asset("bus")), (Some("bus"), None));
        assert_eq!(both.tracks[2], log.tracks[2]);
        assert_ne!(both.fingerprint(), log.fingerprint());
    }

    #[test]
    fn edits_that_change_no_box_have_a_fingerprint_of_their_own() {
        let log = log();
        let template = edits(&[], &[("a", "template")]).apply(&log).unwrap();
        assert_eq!((&template.frames, &template.tracks), (&log.frames, &log.tracks));
        assert_ne!(template.fingerprint(), log.fingerprint());
        assert_eq!(ActorEdits::default().apply(&log).unwrap().fingerprint(), log.fingerprint());
    }

    #[test]
    fn impossible_edits_are_refused() {
        let refused = |edits: ActorEdits| edits.apply(&log()).unwrap_err().to_string();
        for edits in [edits(&[("c", 0)], &[]), edits(&[], &[("c", "a")]), edits(&[], &[("a", "c")])] {
            assert_eq!(refused(edits), "expected tracks of log log, found \"c\"");
        }
        assert_eq!(
            refused(edits(&[("b", 150_000)], &[])),
            "expected a time at which track b of log log has a box (0 to 100000 us), found 150000"
        );
    }

    #[test]
    fn texts() {
        assert_eq!("a@b@-5".parse(), Ok(HeldTrack("a@b".into(), -5)));
        assert_eq!("a=b".parse(), Ok(ReplacedTrack("a".into(), Appearance::Track("b".into()))));
        assert_eq!("a=template".parse(), Ok(ReplacedTrack("a".into(), Appearance::Template)));
        for text in ["", "a", "@5", "a@", "a@1.5"] {
            assert!(text.parse::<HeldTrack>().is_err(), "{text}");
        }
        for text in ["", "a", "=a", "a="] {
            assert!(text.parse::<ReplacedTrack>().is_err(), "{text}");
        }
        let json = serde_json::to_string(&edits(&[("a", 5)], &[("b", "template")])).unwrap();
        assert_eq!(json, r#"{"hold":{"a":5},"replace":{"b":"template"}}"#);
    }
}
