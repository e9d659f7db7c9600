//! Results of a method, and what keeps them from being compared with those of another.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use point_skeleton::error::FileError;
use point_skeleton::files::json;
use serde::Deserialize;
use serde_json::Value;

use super::super::report::COLUMNS;
use crate::table::{interval, number};
use crate::{Distance, MeanInterval};

/// File with the results in the folder of a protocol.
pub(super) const RESULTS: &str = "results.json";

/// Content of `results.json` that is used here.
#[derive(Debug, Deserialize)]
pub(super) struct Results {
    pub(super) protocol: String,
    pub(super) method: MethodName,
    networks: Networks,
    mask_rule: String,
    pub(super) parts: Vec<PartResults>,
    /// Content of `protocol.json`.
    #[serde(skip)]
    settings: Value,
}

#[derive(Debug, Deserialize)]
pub(super) struct MethodName {
    pub(super) name: String,
    references: usize,
    pub(super) remark: Option<String>,
}

#[derive(Debug, PartialEq, Deserialize)]
struct Networks {
    inception: Option<String>,
    i3d: Option<String>,
    segmentor: Option<String>,
}

#[derive(Debug, Deserialize)]
pub(super) struct PartResults {
    pub(super) name: String,
    clips: usize,
    frames: usize,
    driving: Driving,
    fid: Option<Distance>,
    fvd: Option<Distance>,
    images: Images,
}

#[derive(Debug, Deserialize)]
struct Driving {
    at_fault_collisions: usize,
    off_road_share: Option<MeanInterval>,
}

#[derive(Debug, Deserialize)]
struct Images {
    mean: BTreeMap<String, Option<MeanInterval>>,
    rollouts: Vec<Rollout>,
}

#[derive(Debug, Deserialize)]
struct Rollout {
    folder: String,
    sizes: Vec<String>,
    scores: Steps,
}

#[derive(Debug, Deserialize)]
struct Steps {
    steps: usize,
}

/// Options of `protocol.json` that belong to the method, not to the clips.
const OF_METHODS: [&str; 5] = ["generator", "method", "images", "prompt", "captions"];

impl Results {
    /// Reads the results in a folder of `pskel protocol`.
    pub(super) fn read(folder: &Path) -> Result<Self, FileError> {
        let found: Self = json::read(&folder.join(RESULTS), "results of a protocol")?;
        let settings = json::read(&folder.join("protocol.json"), "options of a protocol")?;
        Ok(Self { settings, ..found })
    }

    /// Returns why the rows of another method cannot be compared with those of this one.
    pub(super) fn differences(&self, other: &Self) -> Vec<String> {
        let [one, two] = [self, other].map(|results| &results.method.name);
        let mut notes = Vec::new();
        let mut note = |text: String| notes.push(format!("Not comparable: {text}"));
        let fields = |results: &Self| results.settings.as_object().cloned().unwrap_or_default();
        let [ours, theirs] = [fields(self), fields(other)];
        let keys: BTreeSet<&String> = ours.keys().chain(theirs.keys()).collect();
        for key in keys.into_iter().filter(|key| !OF_METHODS.contains(&key.as_str())) {
            if ours.get(key) != theirs.get(key) {
                note(format!("{one} and {two} differ in the option {key} (protocol.json)"));
            }
        }
        let networks = [
            ("Inception", &self.networks.inception, &other.networks.inception),
            ("I3D", &self.networks.i3d, &other.networks.i3d),
            ("segmentor", &self.networks.segmentor, &other.networks.segmentor),
        ];
        for (name, ours, theirs) in networks {
            if let (Some(ours), Some(theirs)) = (ours, theirs)
                && ours != theirs
            {
                note(format!("{one} has {name} of {ours}, {two} of {theirs}"));
            }
        }
        if self.mask_rule != other.mask_rule {
            note(format!("{one} has the mask rule {}, {two} {}", self.mask_rule, other.mask_rule));
        }
        if self.method.references != other.method.references {
            let [ours, theirs] = [self.method.references, other.method.references];
            note(format!("{one} begins with {ours} recorded frames, {two} with {theirs}"));
        }
        for part in &self.parts {
            let Some(theirs) = other.parts.iter().find(|found| found.name == part.name) else { continue };
            let [a, b] = [part, theirs].map(PartResults::frames_of_clips);
            let differs = |clip: &&&str| a.get(**clip) != b.get(**clip);
            let clips: BTreeSet<&str> = a.keys().chain(b.keys()).copied().collect();
            let differing: Vec<&&str> = clips.iter().filter(differs).collect();
            if let Some(first) = differing.first() {
                let (count, name, all) = (differing.len(), &part.name, clips.len());
                note(format!(
                    "{one} and {two} differ in the frames of {count} of {all} clips of {name}, first {first}"
                ));
            }
        }
        notes
    }
}

impl PartResults {
    /// Returns the number of scored frames of each clip.
    fn frames_of_clips(&self) -> BTreeMap<&str, usize> {
        self.images.rollouts.iter().map(|clip| (clip.folder.as_str(), clip.scores.steps)).collect()
    }

    pub(super) fn row(&self, method: &str) -> Vec<String> {
        let mean = |metric: &str| self.images.mean.get(metric).copied().flatten();
        let scored: usize = self.images.rollouts.iter().map(|clip| clip.scores.steps).sum();
        let frames =
            if scored == self.frames { scored.to_string() } else { format!("{scored} of {}", self.frames) };
        let sizes: BTreeSet<&str> =
            self.images.rollouts.iter().flat_map(|clip| &clip.sizes).map(String::as_str).collect();
        let sizes = sizes.into_iter().collect::<Vec<_>>().join(", ");
        let means = COLUMNS.map(|(metric, _, digits)| interval(mean(metric), digits));
        let distances = [&self.fid, &self.fvd].map(|found| number(found.map(|found| found.distance), 2));
        let iou = interval(mean("iou_masks").map(|iou| iou.scaled(100.0)), 1);
        let Driving { at_fault_collisions, off_road_share } = &self.driving;
        let driving = [at_fault_collisions.to_string(), interval(*off_road_share, 3)];
        let first = [method.to_owned(), self.clips.to_string(), frames, sizes];
        first.into_iter().chain(means).chain(distances).chain([iou]).chain(driving).collect()
    }
}
