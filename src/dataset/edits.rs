use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::Value;

use super::scenario::{Action, Change};
use crate::error::FileError;
use crate::files::input::read_table;
use crate::files::json;
use crate::files::text::printable;
use crate::geometry::ParseOptionError;

/// Text form of [`Appearance::Template`].
const TEMPLATE: &str = "template";

/// Changes of a log's actors: the content of a scenario file (`docs/src/reference/scenarios.md`).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ActorEdits {
    /// Tracks that stand in all frames where they are at a time, absolute microseconds.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub hold: BTreeMap<String, i64>,
    /// Tracks that look like something else, on their own paths.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub replace: BTreeMap<String, Appearance>,
    /// Length, width and height of tracks in all frames, on the same ground, meters.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub size_m: BTreeMap<String, [f64; 3]>,
    /// Changes with a begin and an end, in the order in which they apply.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub changes: Vec<Change>,
}

/// What a track looks like.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Appearance {
    /// Another track of the log: its points, category and size.
    Track(String),
    /// The template of its category, as if it had no points of its own.
    Template,
    /// Points of a PLY or NPY file in the frame of the box: x forward, the origin in its center, meters.
    File(PathBuf),
    /// The points of a track in another skeleton.
    Skeleton {
        /// Folder of the skeleton.
        skeleton: PathBuf,
        /// Track in it.
        track: String,
    },
}

/// Edits that a log does not allow.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
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
    /// Size of a track that no box can have.
    #[error("expected sizes of boxes, found {size_m:?} m of track {}", printable(track))]
    Size {
        /// The track.
        track: String,
        /// Length, width and height, meters.
        size_m: [f64; 3],
    },
    /// Change that does not fit the log.
    #[error("expected {expected} in change {number}, of track {}, found {found}", printable(track))]
    Change {
        /// Number of the change, from 1.
        number: usize,
        /// Its track.
        track: String,
        /// What was expected.
        expected: String,
        /// What was found.
        found: String,
    },
}

impl ActorEdits {
    /// Reads a scenario file. Files of points are relative to its folder.
    ///
    /// # Errors
    /// Fails if the file cannot be read or has other fields or values.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let mut edits = Self::parse(&read_table(path)?, path)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        for appearance in edits.replace.values_mut() {
            if let Appearance::File(file) | Appearance::Skeleton { skeleton: file, .. } = appearance {
                *file = folder.join(&*file);
            }
        }
        Ok(edits)
    }

    /// Parses the bytes of a scenario file; `path` is for messages.
    ///
    /// # Errors
    /// Fails if the bytes have other fields or values.
    pub fn parse(bytes: &[u8], path: &Path) -> Result<Self, FileError> {
        const EXPECTED: &str = "a scenario";
        // An empty array would pass for a value without any of the optional fields.
        match json::parse(bytes, EXPECTED, path)? {
            Value::Object(_) => json::parse(bytes, EXPECTED, path),
            _ => Err(FileError::content(EXPECTED, "no object", path)),
        }
    }

    /// Returns whether nothing is changed.
    pub fn is_empty(&self) -> bool {
        self.hold.is_empty() && self.replace.is_empty() && self.size_m.is_empty() && self.changes.is_empty()
    }

    /// Returns these edits with others on top, which decide where both hold, replace or resize a track.
    #[must_use]
    pub fn and(mut self, other: &Self) -> Self {
        self.hold.extend(other.hold.clone());
        self.replace.extend(other.replace.clone());
        self.size_m.extend(other.size_m.clone());
        self.changes.extend(other.changes.iter().cloned());
        self
    }

    /// Returns whether a change inserts a track.
    pub fn inserts(&self, track: &str) -> bool {
        self.changes.iter().any(|change| change.track == track && matches!(change.action, Action::Insert(_)))
    }

    /// Returns the number of the first change that needs a simulation, from 1; `None` if the log alone
    /// decides where all actors are.
    pub fn first_simulated(&self) -> Option<usize> {
        self.changes.iter().position(|change| change.action == Action::Idm).map(|index| index + 1)
    }

    /// Returns the files and folders with the points of actors.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.replace.values().filter_map(|appearance| match appearance {
            Appearance::File(path) | Appearance::Skeleton { skeleton: path, .. } => Some(path.as_path()),
            _ => None,
        })
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
            // Points of files are assets of the track itself.
            None | Some(Self::File(_) | Self::Skeleton { .. }) => Some(track),
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
            Self::File(path) => return write!(f, "{}", path.display()),
            Self::Skeleton { skeleton, track } => return write!(f, "{track} of {}", skeleton.display()),
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
        match self.clone() {
            Self::Track(_) | Self::Template => serializer.collect_str(self),
            Self::File(file) => AppearanceFile::Points { file }.serialize(serializer),
            Self::Skeleton { skeleton, track } => {
                AppearanceFile::Skeleton { skeleton, track }.serialize(serializer)
            }
        }
    }
}

impl<'de> Deserialize<'de> for Appearance {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(match AppearanceFile::deserialize(deserializer)? {
            AppearanceFile::Name(name) => name.as_str().into(),
            AppearanceFile::Points { file } => Self::File(file),
            AppearanceFile::Skeleton { skeleton, track } => Self::Skeleton { skeleton, track },
        })
    }
}

/// Appearance in files.
#[derive(Serialize, Deserialize)]
#[serde(untagged, deny_unknown_fields)]
#[serde(expecting = "expected the id of a track, template, {\"file\"}, or {\"skeleton\", \"track\"}")]
enum AppearanceFile {
    Name(String),
    Points { file: PathBuf },
    Skeleton { skeleton: PathBuf, track: String },
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
            ..ActorEdits::default()
        };
        let json = serde_json::to_string(&edits).unwrap();
        assert_eq!(json, r#"{"hold":{"a":5},"replace":{"b":"template"}}"#);
    }
}
