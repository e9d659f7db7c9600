use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use serde::{Serialize, Serializer};

use crate::files::text::printable;
use crate::geometry::ParseOptionError;

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
        let edits = ActorEdits {
            hold: [("a".to_owned(), 5)].into(),
            replace: [("b".to_owned(), Appearance::Template)].into(),
        };
        let json = serde_json::to_string(&edits).unwrap();
        assert_eq!(json, r#"{"hold":{"a":5},"replace":{"b":"template"}}"#);
    }
}
