//! Saves a drive: its trajectory, and the rollout along it.

use std::path::{Path, PathBuf};

use point_skeleton::conditions::write::meta::PromptParts;
use point_skeleton::error::with_causes;
use point_skeleton::files::Inputs as ReadFiles;
#[cfg(feature = "mcap")]
use point_skeleton::files::OutputFile;
use point_skeleton::raster::{MapKind, MapSet};
use pskel_sim::TrajectoryFile;
#[cfg(feature = "mcap")]
use pskel_sim::rollout::MCAP;
use pskel_sim::rollout::{ImageGenerator, InputPaths, Rollout, RolloutInputs, RolloutOptions, rollout_extra};
use serde::Serialize;
use serde_json::Value;

use super::live::Live;
use super::{Desk, Engine, Stage, command};
use crate::hub::ClientId;
use crate::inputs::LiveGenerator;
use crate::message::{ServerMessage, to_json};

/// Maximum length of a name.
const MAX_NAME: usize = 64;
/// Video of a rollout.
const VIDEO: &str = "rollout.mp4";

/// Answer to the request to save.
#[derive(Serialize)]
#[serde(tag = "type", rename = "saved")]
struct Saved<'a> {
    name: &'a str,
    folder: String,
    /// Paths of the rollout's page and video on the server.
    page: String,
    video: Option<String>,
    /// MCAP file.
    mcap: Option<String>,
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
        let generator = self.generation.running();
        let (every, window) = self.planning();
        let simulation = live.replay_options(every, window).map_err(|error| with_causes(&error))?;
        let file = trajectory.as_ref().map_or_else(String::new, |path| path.display().to_string());
        let follow_log = self.actors_follow_log(live);
        let own = self.drive_arguments(live, &file);
        if let Some(path) = &trajectory {
            self.write_trajectory(path)?;
        }
        let mut kinds = self.view.kinds(&self.cameras);
        if kinds == MapSet::NONE {
            kinds = MapSet::of(&[MapKind::Color]);
        }
        let options = self.view.options(kinds);
        let read = ReadFiles::new([self.inputs.skeleton_path.clone()]);
        #[cfg(feature = "mcap")]
        let mcap = self.options.out.join(format!("{name}.mcap"));
        let record = generator.map_or(Value::Null, |generator| generator.record.clone());
        let options = RolloutOptions {
            simulation,
            conditions: (*options.conditions).clone(),
            selection: options.selection,
            extra: rollout_extra(desk.report, record).map_err(|error| error.to_string())?,
            facts: generator.iter().map(|generator| generator.fact.clone()).collect(),
            hide: self.view.hide.clone(),
            #[cfg(feature = "mcap")]
            mcap: Some(OutputFile::open(&mcap, MCAP, &read).map_err(|error| with_causes(&error))?),
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
        let rollout = Rollout::open(inputs, options, Some((&folder, &read)), None);
        let rollout = rollout.map_err(|error| with_causes(&error))?;
        let (mut done, of) = (0, rollout.steps_left());
        let hub = self.hub;
        let mut on_step = |_: &str| {
            done += 1;
            hub.tell(None, ServerMessage::Progress { what: "saving", done, of }.json());
        };
        let open = |generator: &LiveGenerator| (generator.open)(self.inputs, follow_log);
        let session = generator.map(open).transpose();
        let mut session = session.map_err(|error| with_causes(&*error))?;
        let images = session.as_mut().map(|session| &mut **session as &mut dyn ImageGenerator);
        let report = rollout.run(desk.renderer, images, &mut on_step).map_err(|error| with_causes(&error))?;
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
        #[cfg(feature = "mcap")]
        let mcap = Some(mcap.display().to_string());
        #[cfg(not(feature = "mcap"))]
        let mcap = None;
        let saved = Saved {
            name: &name,
            folder: folder.display().to_string(),
            page: format!("/rollouts/{name}/index.html"),
            video: folder.join(VIDEO).exists().then(|| format!("/rollouts/{name}/{VIDEO}")),
            mcap,
            trajectory: trajectory.map(|path| path.display().to_string()),
            command: line,
        };
        self.hub.tell(Some(client), to_json(&saved));
        Ok(())
    }

    /// Returns how many steps apart a rollout of the drive plans, and how many plans its warm-up has at
    /// least.
    fn planning(&self) -> (usize, usize) {
        match self.generation.running() {
            Some(generator) => (self.generation.every(), generator.window),
            None => (1, 0),
        }
    }

    /// Returns the arguments of `pskel simulate` for a drive along a trajectory.
    pub(super) fn drive_arguments(&self, live: &Live<'_>, trajectory: &str) -> Vec<String> {
        let (every, window) = self.planning();
        let mut arguments = live.arguments(trajectory, every, window);
        arguments.extend(self.generation.running().iter().flat_map(|running| running.arguments.clone()));
        arguments
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
