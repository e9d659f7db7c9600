use std::collections::BTreeSet;
use std::path::Path;

use point_skeleton::conditions::write::meta::PromptParts;
use point_skeleton::conditions::{ConditionOptions, MapFormat};
use point_skeleton::dataset::ActorEdits;
#[cfg(feature = "mcap")]
use point_skeleton::files::OutputFile;
use point_skeleton::scene::{SelectionOptions, SubstituteReport};
use point_skeleton::sequence::LidarOutput;
use point_skeleton::skeleton::Skeleton;
use serde::Serialize;
use serde_json::{Map, Value};

use crate::{Scenario, SimOptions};

/// Options of a rollout: the simulation, and what is rendered and written at each step.
#[derive(Clone, Debug, Default)]
pub struct RolloutOptions {
    /// Steps, rates and policies.
    pub simulation: SimOptions,
    /// Maps to render, and their sizes.
    pub conditions: ConditionOptions,
    /// Selection of actors and templates.
    pub selection: SelectionOptions,
    /// Track ids of actors that are not drawn.
    pub hide: BTreeSet<String>,
    /// File format of the maps.
    pub format: MapFormat,
    /// Number of planning steps to forecast and render at each planning step.
    pub forecast_steps: usize,
    /// Also writes a contact sheet per step.
    pub sheets: bool,
    /// LiDAR sweeps to write beside the maps of each step.
    pub lidar: Option<LidarOutput>,
    /// Further entries of `rollout.json`, which must be equal to resume, such as the options of the
    /// generator.
    pub extra: Map<String, Value>,
    /// Further lines for the web page.
    pub facts: Vec<String>,
    /// MCAP file to write at the end, outside of the output folder; without an output folder it has no
    /// images.
    #[cfg(feature = "mcap")]
    pub mcap: Option<OutputFile>,
}

/// Inputs of a rollout.
#[derive(Clone, Copy)]
pub struct RolloutInputs<'a> {
    /// Log, HD map and default rates.
    pub scenario: &'a Scenario<'a>,
    /// Skeleton that was built from the log.
    pub skeleton: &'a Skeleton,
    /// Parts of the prompt in `meta.json`.
    pub prompt: &'a PromptParts,
    /// Paths of the inputs.
    pub paths: InputPaths<'a>,
}

/// Paths of the inputs, for errors.
#[derive(Clone, Copy)]
pub struct InputPaths<'a> {
    /// File or folder of the log.
    pub log: &'a Path,
    /// Folder of the skeleton.
    pub skeleton: &'a Path,
    /// File of the prompt.
    pub prompt: Option<&'a Path>,
}

/// Returns the options of templates, assets and generator for [`RolloutOptions::extra`].
///
/// # Errors
/// Fails if they cannot be serialized.
pub fn rollout_extra(
    substitutes: &SubstituteReport,
    generator: Value,
) -> serde_json::Result<Map<String, Value>> {
    let mut extra = match serde_json::to_value(substitutes)? {
        Value::Object(fields) => fields,
        _ => Map::new(),
    };
    extra.insert("generator".to_owned(), generator);
    Ok(extra)
}

/// Step of an earlier rollout in the same folder after which to resume.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResumeAfter {
    /// The last step; starts at step 0 if there is none.
    Last,
    /// This step; later ones are simulated again.
    Step(usize),
}

/// Options and inputs of a rollout in `rollout.json` and `index.json`.
#[derive(Clone, Debug, Serialize)]
pub(super) struct RolloutRecord {
    #[serde(flatten)]
    pub(super) conditions: ConditionOptions,
    #[serde(flatten)]
    pub(super) selection: SelectionOptions,
    #[serde(skip_serializing_if = "BTreeSet::is_empty")]
    pub(super) hide: BTreeSet<String>,
    #[serde(flatten)]
    pub(super) edits: ActorEdits,
    pub(super) format: MapFormat,
    pub(super) forecast_steps: usize,
    pub(super) sheets: bool,
    #[serde(flatten)]
    pub(super) lidar: Option<LidarOutput>,
    pub(super) log: String,
    pub(super) sources: super::sources::Sources,
    pub(super) simulation: SimOptions,
    /// Simulation steps per second.
    pub(super) sim_hz: f64,
    /// Planning steps per second.
    pub(super) plan_hz: f64,
    /// Last step of the warm-up.
    pub(super) takeover_step: usize,
    /// Name of the HD map, if the log has files of one.
    pub(super) map_name: Option<String>,
    /// Ids of the route's roadblocks at the first plan.
    pub(super) roadblocks: Vec<String>,
    #[serde(flatten)]
    pub(super) extra: Map<String, Value>,
}
