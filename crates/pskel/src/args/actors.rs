//! Actors that are drawn otherwise than they were recorded.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Args;
use point_skeleton::Log;
use point_skeleton::dataset::{ActorEdits, HeldTrack, ReplacedTrack};

use crate::WrongUsage;

/// Heading of these options in help texts.
const HEADING: &str = "Actors";

/// File of changes of a log's actors.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct ScenarioArgs {
    /// Scenario: actors are inserted, removed, moved, sent along paths and handed to a driver model, at times
    /// or as soon as the ego is near; JSON
    #[arg(long, help_heading = HEADING, value_name = "FILE")]
    scenario: Option<PathBuf>,
}

/// Changes of a log's actors.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct ActorArgs {
    #[command(flatten)]
    scenario: ScenarioArgs,
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

    /// Returns the changes of a scenario alone.
    #[cfg(feature = "network")]
    pub(crate) fn of_scenario(scenario: ScenarioArgs) -> Self {
        Self { scenario, ..Self::default() }
    }

    /// Returns the file that is read.
    pub(crate) fn file(&self) -> Option<&Path> {
        self.scenario.file()
    }

    /// Returns the log with the edits: those of the scenario, then those of the other options.
    ///
    /// # Errors
    /// Fails if the scenario cannot be read, or if the log does not have a track at its time.
    pub(crate) fn edit(&self, log: &Log) -> anyhow::Result<Log> {
        let edits = ActorEdits {
            hold: self.hold.iter().map(|HeldTrack(track, t_us)| (track.clone(), *t_us)).collect(),
            replace: self
                .replace
                .iter()
                .map(|ReplacedTrack(track, by)| (track.clone(), by.clone()))
                .collect(),
            ..ActorEdits::default()
        };
        // Checked alone first, so that an error of the file names it.
        let scenario = self.scenario.read_for(log)?;
        Ok(log.edited(&scenario.and(&edits)).map_err(|error| WrongUsage(error.to_string()))?)
    }
}

impl ScenarioArgs {
    /// Returns the scenario of a file.
    #[cfg(feature = "network")]
    pub(crate) fn of_file(path: &Path) -> Self {
        Self { scenario: Some(path.to_owned()) }
    }

    /// Returns the file that is read.
    pub(crate) fn file(&self) -> Option<&Path> {
        self.scenario.as_deref()
    }

    /// Reads the scenario, empty without a file, and checks it against a log.
    ///
    /// # Errors
    /// Fails if it cannot be read or does not fit the log.
    pub(crate) fn read_for(&self, log: &Log) -> anyhow::Result<ActorEdits> {
        let Some(path) = self.file() else { return Ok(ActorEdits::default()) };
        let edits = ActorEdits::read(path)?;
        log.edited(&edits).with_context(|| format!("scenario {}", path.display()))?;
        Ok(edits)
    }
}
