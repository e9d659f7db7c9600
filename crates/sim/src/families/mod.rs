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

use point_skeleton::Log;
use point_skeleton::dataset::{Action, ActorEdits, Change, EditError};

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
            log's end, found none"
    )]
    Slow {
        /// Minimum speed, meters per second.
        min_mps: f64,
        /// Minimum time until the end of the log, seconds.
        seconds: f64,
    },
    /// Something is always in the way.
    #[error(
        "expected free space for a {} scenario, found {found} in the last of {DRAWS} draws",
        family.name()
    )]
    Blocked {
        /// The family.
        family: Family,
        /// What is in the way.
        found: String,
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
    let no_frames = || SimError::NoFrames { log: recording.name.clone() };
    let recorded = Recorded::new(recording).ok_or_else(no_frames)?;
    let road = log.map().and_then(|map| Road::new(map.vector_map()));
    // Others come from beside the road.
    let stays_on_road = matches!(family, Family::Stationary | Family::Frontal | Family::CutIn);
    let road = road.as_ref().filter(|_| stays_on_road);
    let starts = course::starts(&recorded);
    if starts.is_empty() {
        return Err(FamilyError::Slow { min_mps: course::MIN_SPEED_MPS, seconds: course::AHEAD_S });
    }
    let mut found = String::new();
    for number in 0..DRAWS {
        let draw = Draw { family: family.name(), seed, number };
        let Some(mut course) = Course::drawn(&recorded, family, &starts, draw) else { continue };
        let (mut edited, mut removed) = (log.edited(&course.edits)?, 0);
        let obstacle = loop {
            match in_the_way(&recorded, edited.recording(), &course, road, space) {
                Some(Obstacle::Actor(track, _)) if removed < MAX_REMOVED => {
                    course.edits.changes.push(Change {
                        track,
                        action: Action::Remove,
                        start: None,
                        end: None,
                    });
                    removed += 1;
                    edited = log.edited(&course.edits)?;
                }
                Some(Obstacle::Actor(track, at)) => break Some(format!("track {track} {at}")),
                Some(Obstacle::Fixed(text)) => break Some(text),
                None => break None,
            }
        };
        if let Some(obstacle) = obstacle {
            found = obstacle;
            continue;
        }
        match trial::run(&edited, &course)? {
            Ok(collision_us) => {
                return Ok(FamilyScenario { edits: course.edits, start_us: course.start_us, collision_us });
            }
            Err(other) => found = other,
        }
    }
    Err(FamilyError::Blocked { family, found })
}
