//! Actors that are drawn otherwise than they were recorded.

use std::collections::BTreeSet;

use clap::Args;
use point_skeleton::Log;
use point_skeleton::dataset::{ActorEdits, HeldTrack, ReplacedTrack};

use crate::WrongUsage;

/// Heading of these options in help texts.
const HEADING: &str = "Actors";

/// Changes of a log's actors.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct ActorArgs {
    /// Leave these actors out of all maps; a simulation has them all the same
    #[arg(long, help_heading = HEADING, value_name = "TRACK,..", value_delimiter = ',')]
    hide: Vec<String>,
    /// Hold these actors in all frames where they are in the log at a time, absolute microseconds
    #[arg(long, help_heading = HEADING, value_name = "TRACK@T_US,..", value_delimiter = ',')]
    hold: Vec<HeldTrack>,
    /// Give these actors, on their own paths, the points, category and size of another actor of the log, or
    /// the template of their own category
    #[arg(long, help_heading = HEADING, value_name = "TRACK=TRACK|template,..", value_delimiter = ',')]
    replace: Vec<ReplacedTrack>,
}

impl ActorArgs {
    /// Returns the track ids of hidden actors.
    pub(crate) fn hidden(&self) -> BTreeSet<String> {
        self.hide.iter().cloned().collect()
    }

    /// Returns the edits of the log.
    pub(crate) fn edits(&self) -> ActorEdits {
        ActorEdits {
            hold: self.hold.iter().map(|HeldTrack(track, t_us)| (track.clone(), *t_us)).collect(),
            replace: self
                .replace
                .iter()
                .map(|ReplacedTrack(track, by)| (track.clone(), by.clone()))
                .collect(),
        }
    }

    /// Returns the log with the edits.
    ///
    /// # Errors
    /// Fails if the log does not have a track at its time.
    pub(crate) fn edit(&self, log: &Log) -> Result<Log, WrongUsage> {
        log.edited(&self.edits()).map_err(|error| WrongUsage(error.to_string()))
    }
}
