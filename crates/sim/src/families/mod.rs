//! Scenarios on collision course, chosen by a seed.
//!
//! # How it works
//! The kinds stationary, frontal and side come from NeuroNCAP (W. Ljungbergh et al., "NeuroNCAP:
//! photorealistic closed-loop safety testing for autonomous driving", ECCV 2024); cut-ins and crossing
//! pedestrians follow the same rule: an ego that keeps its recorded motion collides within 4 s. Unlike
//! there, no scene is chosen by hand: `course` draws a time of the log, a time to the collision and an
//! actor, `space` tests that nothing is in its way, and `trial` simulates an ego that keeps its plan, which
//! must collide, and one that brakes by a rule, which must not. Draws that fail are drawn again.

mod course;
mod draw;
mod family;
mod space;
mod trial;

use std::collections::BTreeMap;

use point_skeleton::Log;
use point_skeleton::dataset::{Action, ActorEdits, Change, EditError};
use point_skeleton::files::text::printable;

use self::course::Course;
use self::draw::Draw;
pub use self::family::{Family, TRACK};
pub use self::space::StaticSpace;
use self::space::{Obstacle, in_the_way};
use crate::recorded::Recorded;
use crate::{SimError, metrics::Road};

/// Number of draws until a scenario is refused.
const DRAWS: u64 = 60;
/// Number of the log's actors that a scenario removes at most, since they are in the way.
const MAX_REMOVED: usize = 3;

/// Scenario of a family.
#[derive(Clone, Debug, PartialEq)]
pub struct FamilyScenario {
    /// Changes of the log's actors.
    pub edits: ActorEdits,
    /// Begin of the changes, absolute microseconds.
    pub start_us: i64,
    /// Time at which an ego that keeps its recorded motion collides, absolute microseconds.
    pub collision_us: i64,
}

/// Reason why a log has no scenario of a family for a seed.
#[derive(Debug, thiserror::Error)]
pub enum FamilyError {
    /// The ego is never fast enough.
    #[error(
        "expected an ego with {min_mps} m/s or more about 3 s after a time that is {seconds} s before the \
            end of log {log}, found none"
    )]
    Slow {
        /// Name of the log.
        log: String,
        /// Minimum speed, meters per second.
        min_mps: f64,
        /// Minimum time until the end of the log, seconds.
        seconds: f64,
    },
    /// Something is always in the way.
    #[error(
        "expected free space for a {} scenario of log {log}, found in the way of {DRAWS} draws: {}",
        family.name(),
        counted(found)
    )]
    Blocked {
        /// The family.
        family: Family,
        /// Name of the log.
        log: String,
        /// What is in the way, with the number of draws.
        found: BTreeMap<String, usize>,
    },
    /// The log cannot be edited.
    #[error(transparent)]
    Edit(#[from] EditError),
    /// The log cannot be simulated.
    #[error(transparent)]
    Simulation(#[from] SimError),
}

/// Returns a scenario of a log without edits. `space` has the static points of its skeleton, if it is known.
///
/// # Errors
/// Fails if the log is too slow or too short, or if something is in the way of all draws.
pub fn family_scenario(
    log: &Log,
    family: Family,
    seed: u64,
    space: Option<&StaticSpace>,
) -> Result<FamilyScenario, FamilyError> {
    let recording = log.recording();
    let name = || recording.shown_name().into_owned();
    let no_frames = || SimError::NoFrames { log: recording.name.clone() };
    let recorded = Recorded::new(recording).ok_or_else(no_frames)?;
    let road = log.map().and_then(|map| Road::new(map.vector_map()));
    // Others come from beside the road.
    let stays_on_road = matches!(family, Family::Stationary | Family::Frontal | Family::CutIn);
    let road = road.as_ref().filter(|_| stays_on_road);
    let starts = course::starts(&recorded);
    if starts.is_empty() {
        let (log, min_mps, seconds) = (name(), course::MIN_SPEED_MPS, course::AHEAD_S);
        return Err(FamilyError::Slow { log, min_mps, seconds });
    }
    let mut found = BTreeMap::new();
    for number in 0..DRAWS {
        let draw = Draw { family: family.name(), seed, number };
        let mut count = |what: String| *found.entry(what).or_insert(0) += 1;
        let Some(mut course) = Course::drawn(&recorded, family, &starts, draw) else {
            count("a slow ego".to_owned());
            continue;
        };
        let (mut edited, mut removed) = (log.edited(&course.edits)?, 0);
        let obstacle = loop {
            match in_the_way(&recorded, edited.recording(), &course, road, space) {
                Some(Obstacle::Actor(track)) if removed < MAX_REMOVED => {
                    course.edits.changes.push(Change {
                        track,
                        action: Action::Remove,
                        start: None,
                        end: None,
                    });
                    removed += 1;
                    edited = log.edited(&course.edits)?;
                }
                Some(Obstacle::Actor(track)) => break Some(format!("track {}", printable(&track))),
                Some(Obstacle::Fixed(text)) => break Some(text.to_owned()),
                None => break None,
            }
        };
        if let Some(obstacle) = obstacle {
            count(obstacle);
            continue;
        }
        match trial::run(&edited, &course)? {
            Ok(collision_us) => {
                return Ok(FamilyScenario { edits: course.edits, start_us: course.start_us, collision_us });
            }
            Err(other) => count(other.to_owned()),
        }
    }
    Err(FamilyError::Blocked { family, log: name(), found })
}

/// Lists what is in the way with the number of draws, the most frequent first.
fn counted(found: &BTreeMap<String, usize>) -> String {
    let mut all: Vec<(&String, &usize)> = found.iter().collect();
    all.sort_by_key(|(_, count)| std::cmp::Reverse(**count));
    all.iter().map(|(what, count)| format!("{what} ({count})")).collect::<Vec<_>>().join(", ")
}
