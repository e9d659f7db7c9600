//! Options of the protocols that generate clips, and their record in `protocol.json`.

use anyhow::Context;
use clap::Args;
use point_skeleton::conditions::write::meta::PromptParts;
use point_skeleton::conditions::{Captions, ConditionOptions, MapFormat};
use point_skeleton::dataset::{ActorEdits, LogLocator, LogOpener};
use point_skeleton::error::FileError;
use point_skeleton::files::{Checksum, Inputs, OutputFolder, write_json};
use point_skeleton::scene::{SelectionOptions, SubstituteOptions};
use point_skeleton::sequence::LidarOutput;
use pskel_eval::protocol::{Part, Protocol, check_settings};
use pskel_generate::{ImageFolder, ImportOptions};
use pskel_sim::{ActorPolicy, Rates};
use serde::Serialize;
use serde_json::Value;

use super::copy::CopyArgs;
use super::logs::ProtocolLogs;
use crate::args::actors::ScenarioArgs;
use crate::args::generator::GeneratorArgs;
use crate::args::images::ImageArgs;
use crate::args::lidar::LidarArgs;
use crate::args::maps::MapArgs;
use crate::args::metrics::MetricArgs;
use crate::args::names::names;
use crate::args::prompt::PromptArgs;
use crate::args::rasterizer::RasterizerArgs;
use crate::args::substitutes::SubstituteArgs;
use crate::{WrongUsage, logs};

/// Run an evaluation protocol: generate its clips and score them
///
/// Writes a rollout per clip, PART/CLIP, then table.md and results.json, and for a part with a copy of the
/// data set (nuScenes) dataset, in which the generated images of all scenes replace the recorded ones.
/// Finished rollouts are retained and others resumed, so the same command continues an interrupted run. Logs
/// that fail are reported at the end.
#[derive(Debug, Args)]
#[command(mut_arg("generator", |arg| arg.default_value("network")))]
pub(crate) struct ClipProtocolArgs {
    #[command(flatten)]
    pub(super) given: ProtocolLogs,
    /// Parts of the protocol [default: all; of nuplan-simgen replay and lane_change]
    #[arg(long, value_name = "PART,..", value_delimiter = ',')]
    pub(super) parts: Vec<String>,
    /// Accept any logs instead of all logs in the protocol; the table says so
    #[arg(long)]
    pub(super) other_logs: bool,
    /// At most this number of clips per recording and part [default: all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub(super) clips: Option<u16>,
    #[command(flatten)]
    pub(super) copy: CopyArgs,
    /// Policy of the other actors where the ego leaves the log
    #[arg(long, value_name = "POLICY", default_value_t, value_parser = names::<ActorPolicy>())]
    pub(super) actors: ActorPolicy,
    #[command(flatten)]
    pub(super) prompt: PromptArgs,
    #[command(flatten)]
    pub(super) generator: GeneratorArgs,
    #[command(flatten)]
    pub(super) images: ImageArgs,
    /// Name of the method in tables [default: the generator's, or the folder of --images]
    #[arg(long, value_name = "NAME")]
    pub(super) method: Option<String>,
    #[command(flatten)]
    pub(super) maps: MapArgs,
    #[command(flatten)]
    pub(super) lidar: LidarArgs,
    #[command(flatten)]
    pub(super) scenario: ScenarioArgs,
    #[command(flatten)]
    pub(super) substitutes: SubstituteArgs,
    #[command(flatten)]
    pub(super) rasterizer: RasterizerArgs,
    #[command(flatten)]
    pub(super) metrics: MetricArgs,
}

/// Content of `protocol.json`: options that all rollouts of the folder share.
#[derive(Serialize)]
struct Settings<'a> {
    protocol: &'a str,
    actors: &'a str,
    method: &'a str,
    generator: Value,
    /// Images of another program: their checksum and options.
    images: Option<(Checksum, &'a ImportOptions)>,
    maps: ConditionOptions,
    selection: SelectionOptions,
    format: MapFormat,
    #[serde(flatten)]
    lidar: Option<LidarOutput>,
    substitutes: SubstituteOptions,
    /// Fingerprint of the template library.
    #[serde(skip_serializing_if = "Option::is_none")]
    library: Option<String>,
    prompt: PromptParts,
    captions: Option<Captions>,
    /// Changes of the actors.
    #[serde(skip_serializing_if = "ActorEdits::is_empty")]
    scenario: ActorEdits,
}

impl ClipProtocolArgs {
    /// Returns everything that is read, except for skeletons.
    pub(super) fn inputs(&self, logs: &[LogLocator]) -> Inputs {
        let log_paths = logs.iter().flat_map(LogLocator::inputs);
        Inputs::new(log_paths)
            .and(&self.prompt.annotations)
            .and(self.scenario.file())
            .and(self.generator.inputs())
            .and(self.images.inputs())
            .and(self.substitutes.inputs())
            .and(self.lidar.inputs())
            .and(self.metrics.inputs())
    }

    /// Returns the selected parts, in order.
    pub(super) fn parts(&self, protocol: Protocol) -> Result<Vec<Part>, WrongUsage> {
        let mut parts = protocol.parts();
        let names: Vec<&str> = parts.iter().map(|part| part.name).collect();
        if let Some(other) = self.parts.iter().find(|part| !names.contains(&part.as_str())) {
            return Err(WrongUsage(format!("expected --parts of {}, found {other}", names.join(", "))));
        }
        parts.retain(|part| match self.parts.as_slice() {
            [] => !part.is_optional,
            selected => selected.iter().any(|name| name == part.name),
        });
        self.copy.select(&mut parts)?;
        Ok(parts)
    }

    /// Returns the logs to generate: the protocol's logs, each once, or any with `--other-logs`.
    pub(super) fn logs(&self, protocol: Protocol, opener: &LogOpener) -> anyhow::Result<Vec<LogLocator>> {
        let found = self.given.expand()?;
        let mut missing = protocol.logs();
        if self.other_logs || missing.is_empty() {
            return Ok(found);
        }
        let mut ours = Vec::new();
        for locator in found {
            let name = opener.outline(&locator)?.name;
            if let Some(place) = missing.iter().position(|other| *other == name) {
                missing.remove(place);
                ours.push(locator);
            }
        }
        let (count, name) = (missing.len(), protocol.name());
        let Some(first) = missing.first() else { return Ok(ours) };
        let message = format!(
            "expected all recordings of {name}, or --other-logs, found that {count} are missing, the first \
                is {first}"
        );
        Err(WrongUsage(message).into())
    }

    /// Writes the settings, or compares them with an earlier run's. Returns the number of the generator's
    /// reference frames.
    pub(super) fn settle(
        &self,
        protocol: Protocol,
        logs: &[LogLocator],
        opener: &LogOpener,
        files: &OutputFolder,
        images: Option<&ImageFolder>,
    ) -> anyhow::Result<usize> {
        let first = logs.first().context("expected a recording, found none")?;
        let log = logs::open_by(first, opener)?;
        let rates = Rates::of(first.format, log.recording());
        let images = images.map(|folder| Ok::<_, FileError>((folder.checksum()?, folder.options())));
        let images = images.transpose()?;
        let (generator, window) = if images.is_some() {
            (Value::Null, self.generator.images_window()?)
        } else {
            let opened = self.generator.open(&log, rates.plan_hz)?;
            let opened = opened.context("expected a --generator, found none")?;
            (opened.record()?, opened.window())
        };
        let settings = serde_json::to_value(Settings {
            protocol: protocol.name(),
            actors: self.actors.name(),
            method: &self.method_name(),
            generator,
            images,
            maps: self.maps.conditions(self.maps.maps.unwrap_or_default()),
            selection: self.maps.selection(),
            format: self.maps.format,
            lidar: self.lidar.unmounted()?,
            substitutes: self.substitutes.options(),
            library: self.substitutes.options().fingerprint()?,
            prompt: self.prompt.read()?,
            captions: self.generator.all_captions()?,
            scenario: self.scenario.read_for(&log)?,
        })?;
        let path = files.claim("protocol.json")?;
        check_settings(&path, &settings)?;
        write_json(&path, &settings)?;
        Ok(window - 1)
    }

    /// Returns the name of the method in tables.
    pub(super) fn method_name(&self) -> String {
        let folder = self.images.folder().map(|folder| folder.file_name().unwrap_or(folder.as_os_str()));
        let generator = self.generator.generator.as_ref().map(ToString::to_string);
        let default = folder.map(|name| name.to_string_lossy().into_owned()).or(generator);
        self.method.clone().or(default).unwrap_or_default()
    }
}
