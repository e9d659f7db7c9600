//! Saves a drive: its trajectory, and the rollout along it.

use std::path::{Path, PathBuf};

use point_skeleton::conditions::write::meta::PromptParts;
use point_skeleton::error::with_causes;
use point_skeleton::files::Inputs as ReadFiles;
use point_skeleton::raster::{MapKind, MapSet};
use pskel_sim::TrajectoryFile;
use pskel_sim::rollout::{InputPaths, Rollout, RolloutInputs, RolloutOptions, rollout_extra};
use serde::Serialize;
use serde_json::Value;

use super::{Desk, Engine, Stage, command};
use crate::hub::ClientId;
use crate::message::{ServerMessage, to_json};

/// Maximum length of a name.
const MAX_NAME: usize = 64;

/// Answer to the request to save.
#[derive(Serialize)]
#[serde(tag = "type", rename = "saved")]
struct Saved<'a> {
    name: &'a str,
    folder: String,
    /// Path of the rollout's page on the server.
    page: String,
    trajectory: Option<String>,
    command: String,
}

impl Engine<'_> {
    /// Returns the file of the present drive's trajectory.
    pub(super) fn trajectory_path(&self) -> PathBuf {
        self.options.out.join("trajectory.json")
    }

    /// Writes the trajectory of the drive from the takeover on.
    ///
    /// # Errors
    /// Fails if no simulation runs, the log drives, or the file cannot be written.
    pub(super) fn write_trajectory(&mut self, path: &Path) -> Result<(), String> {
        let driven = self.live()?.driven();
        if driven.is_empty() {
            return Ok(()); // the log drives: there is nothing that the command needs
        }
        let folder = path.parent().unwrap_or(Path::new("."));
        std::fs::create_dir_all(folder)
            .map_err(|error| format!("cannot create the folder: {error}: {}", folder.display()))?;
        let file = TrajectoryFile::new(driven.to_vec()).map_err(|error| with_causes(&error))?;
        file.write(path).map_err(|error| with_causes(&error))
    }

    /// Simulates the drive again along its trajectory, and writes the rollout.
    ///
    /// # Errors
    /// Fails if there is no drive, or if the rollout fails.
    pub(super) fn save(
        &mut self,
        client: ClientId,
        name: Option<&str>,
        desk: &mut Desk<'_, '_>,
    ) -> Result<(), String> {
        let name = match name {
            Some(name) => checked(name)?.to_owned(),
            None => self.next_name(),
        };
        let Stage::Live(live) = &self.stage else {
            return Err("no simulation runs: there is nothing to save".to_owned());
        };
        if live.instant().step == 0 {
            return Err("no step is simulated yet: there is nothing to save".to_owned());
        }
        let folder = self.options.out.join(&name);
        let trajectory = live.takeover.map(|_| self.options.out.join(format!("{name}.json")));
        if folder.exists() || trajectory.as_ref().is_some_and(|path| path.exists()) {
            return Err(format!("expected a new name, found one that exists: {}", folder.display()));
        }
        let simulation = live.replay_options().map_err(|error| with_causes(&error))?;
        let file = trajectory.as_ref().map_or_else(String::new, |path| path.display().to_string());
        let own = live.arguments(&file);
        if let Some(path) = &trajectory {
            self.write_trajectory(path)?;
        }
        let mut kinds = self.view.kinds(&self.cameras);
        if kinds == MapSet::NONE {
            kinds = MapSet::of(&[MapKind::Color]);
        }
        let options = self.view.options(kinds);
        let options = RolloutOptions {
            simulation,
            conditions: (*options.conditions).clone(),
            selection: options.selection,
            extra: rollout_extra(desk.report, Value::Null).map_err(|error| error.to_string())?,
            hide: self.view.hide.clone(),
            ..RolloutOptions::default()
        };
        let (scenario, prompt) = (self.scenario(), PromptParts::default());
        let paths = InputPaths {
            log: Path::new(&self.inputs.log_name),
            skeleton: &self.inputs.skeleton_path,
            prompt: None,
        };
        let inputs =
            RolloutInputs { scenario: &scenario, skeleton: &self.inputs.skeleton, prompt: &prompt, paths };
        let read = ReadFiles::new([self.inputs.skeleton_path.clone()]);
        let rollout = Rollout::open(inputs, options, Some((&folder, &read)), None);
        let rollout = rollout.map_err(|error| with_causes(&error))?;
        let (mut done, of) = (0, rollout.steps_left());
        let hub = self.hub;
        let mut on_step = |_: &str| {
            done += 1;
            hub.tell(None, ServerMessage::Progress { what: "saving", done, of }.json());
        };
        let report = rollout.run(desk.renderer, None, &mut on_step).map_err(|error| with_causes(&error))?;
        if let Some(failure) = report.failure.as_ref().or(report.summary_failure.as_ref()) {
            return Err(with_causes(failure));
        }
        let skeleton = self.inputs.skeleton_path.display().to_string();
        let first = ["pskel", "simulate", &self.inputs.log_name, "--skeleton", &skeleton].map(str::to_owned);
        let log = self.inputs.log_arguments.iter().cloned();
        let out = ["--out".to_owned(), folder.display().to_string()];
        let line = command::line(
            first.into_iter().chain(log).chain(own).chain(self.view.arguments(kinds)).chain(out),
        );
        let saved = Saved {
            name: &name,
            folder: folder.display().to_string(),
            page: format!("/rollouts/{name}/index.html"),
            trajectory: trajectory.map(|path| path.display().to_string()),
            command: line,
        };
        self.hub.tell(Some(client), to_json(&saved));
        Ok(())
    }

    /// Returns the first name that is not taken.
    fn next_name(&mut self) -> String {
        loop {
            self.saved += 1;
            let name = format!("drive-{:03}", self.saved);
            if !self.options.out.join(&name).exists() {
                return name;
            }
        }
    }
}

/// Returns a name if it can be that of a folder.
pub(super) fn checked(name: &str) -> Result<&str, String> {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    if name.is_empty() || name.len() > MAX_NAME || !name.chars().all(is_plain) {
        return Err(format!(
            "expected a name of letters, digits, - and _, at most {MAX_NAME}, found {name:?}"
        ));
    }
    Ok(name)
}
