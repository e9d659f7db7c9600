//! Division of logs into units of work.

use std::collections::BTreeSet;
use std::ops::Range;
use std::str::FromStr;

use point_skeleton::dataset::{LogLocator, LogOutline};
use point_skeleton::geometry::ParseOptionError;

use crate::ExportError;

/// Frames of a log that become one shard.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WorkUnit {
    /// Name of the shard: the log's and its first frame.
    pub name: String,
    /// Key frames, and the images since the previous key frame.
    pub frames: Range<usize>,
}

/// A log and its units.
#[derive(Clone, Debug, PartialEq)]
pub struct ListedLog {
    /// Where the log is.
    pub locator: LogLocator,
    /// Name of the log as a file name without dots.
    pub name: String,
    /// Units in order of frames.
    pub units: Vec<WorkUnit>,
}

/// Units of several logs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WorkList {
    /// Logs in order.
    pub logs: Vec<ListedLog>,
}

/// Part of a work list: number `index` of `count`, counted from 0. Text form: `I/N`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part {
    index: usize,
    count: usize,
}

impl WorkList {
    /// Divides logs into units of at most `shard_frames` key frames. `frames` restricts each log to some key
    /// frames.
    ///
    /// # Errors
    /// Fails if the names of two logs are equal as file names.
    pub fn new(
        logs: impl IntoIterator<Item = (LogLocator, LogOutline)>,
        shard_frames: usize,
        frames: Option<Range<usize>>,
    ) -> Result<Self, ExportError> {
        let mut names = BTreeSet::new();
        let listed = |(locator, outline): (LogLocator, LogOutline)| {
            let name = file_name(&outline.name);
            if !names.insert(name.to_lowercase()) {
                return Err(ExportError::SameName { name });
            }
            let all = 0..outline.frames;
            let frames = frames.clone().map_or(all.clone(), |f| f.start.min(all.end)..f.end.min(all.end));
            let starts = frames.clone().step_by(shard_frames.max(1));
            let unit = |start: usize| WorkUnit {
                name: format!("{name}-{start:06}"),
                frames: start..frames.end.min(start.saturating_add(shard_frames.max(1))),
            };
            Ok(ListedLog { units: starts.map(unit).collect(), locator, name })
        };
        Ok(Self { logs: logs.into_iter().map(listed).collect::<Result<_, _>>()? })
    }

    /// Returns the number of units.
    pub fn len(&self) -> usize {
        self.logs.iter().map(|log| log.units.len()).sum()
    }

    /// Returns whether there are no units.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the units of a part: a contiguous piece of the list, so that few logs are in two parts.
    #[must_use]
    pub fn part(&self, part: Part) -> Self {
        let total = self.len();
        let mut number = 0;
        self.only(|_| {
            number += 1;
            (number - 1) * part.count / total == part.index
        })
    }

    /// Returns the units that `is_in` accepts.
    #[must_use]
    pub fn only(&self, mut is_in: impl FnMut(&WorkUnit) -> bool) -> Self {
        let piece = |log: &ListedLog| {
            let units: Vec<WorkUnit> = log.units.iter().filter(|unit| is_in(unit)).cloned().collect();
            (!units.is_empty()).then(|| ListedLog { units, ..log.clone() })
        };
        Self { logs: self.logs.iter().filter_map(piece).collect() }
    }
}

impl FromStr for Part {
    type Err = ParseOptionError;

    fn from_str(text: &str) -> Result<Self, ParseOptionError> {
        let numbers = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match numbers {
            Some((index, count)) if index < count => Ok(Self { index, count }),
            _ => {
                Err(ParseOptionError { expected: "a part I/N with I from 0 to N-1", found: text.to_owned() })
            }
        }
    }
}

/// Returns a name of letters, digits, `-` and `_` for shards and keys. Others, dots included, become `_`:
/// readers of tar shards end a key at the first dot.
fn file_name(name: &str) -> String {
    let allowed = |c: char| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' };
    let name: String = name.chars().map(allowed).take(100).collect();
    if name.is_empty() { "log".to_owned() } else { name }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list(lengths: &[(&str, usize)]) -> WorkList {
        let log = |&(name, frames): &(&str, usize)| {
            let locator = LogLocator::new(&point_skeleton::dataset::nuscenes::FORMAT, name);
            (locator, LogOutline { name: name.to_owned(), frames })
        };
        WorkList::new(lengths.iter().map(log), 4, None).unwrap()
    }

    #[test]
    fn units_cover_every_frame_once() {
        let list = list(&[("a", 9), ("b", 4), ("c.d", 1), ("empty", 0)]);
        let units: Vec<(&str, Range<usize>)> = list
            .logs
            .iter()
            .flat_map(|log| &log.units)
            .map(|u| (u.name.as_str(), u.frames.clone()))
            .collect();
        let expected = [
            ("a-000000", 0..4),
            ("a-000004", 4..8),
            ("a-000008", 8..9),
            ("b-000000", 0..4),
            ("c_d-000000", 0..1),
        ];
        assert_eq!(units, expected);
    }

    #[test]
    fn parts_cover_the_list() {
        let list = list(&[("a", 9), ("b", 40), ("c", 3)]);
        for count in 1..20 {
            let part = |index| list.part(format!("{index}/{count}").parse().unwrap());
            let units: Vec<WorkUnit> =
                (0..count).flat_map(|i| part(i).logs).flat_map(|log| log.units).collect();
            let all: Vec<WorkUnit> = list.logs.iter().flat_map(|log| log.units.clone()).collect();
            assert_eq!(units, all);
            let sizes: Vec<usize> = (0..count).map(|i| part(i).len()).collect();
            assert!(sizes.iter().max().unwrap() - sizes.iter().min().unwrap() <= 1, "{sizes:?}");
        }
        for text in ["", "1", "2/2", "-1/2", "0/0", "a/b"] {
            assert!(text.parse::<Part>().is_err(), "{text}");
        }
    }

    #[test]
    fn rejects_colliding_names() {
        let log = |name: &str| {
            (
                LogLocator::new(&point_skeleton::dataset::nuscenes::FORMAT, "p"),
                LogOutline { name: name.to_owned(), frames: 1 },
            )
        };
        let error = WorkList::new([log("a.b"), log("A_b")], 4, None).unwrap_err().to_string();
        assert!(error.ends_with("found A_b twice"), "{error}");
    }
}
