//! Inputs of a rollout, which must be the same to resume it.

use std::fmt::Write;
use std::hash::{Hash, Hasher};
use std::path::Path;

use point_skeleton::conditions::write::meta::PromptParts;
use point_skeleton::dataset::Recording;
use point_skeleton::error::FileError;
use point_skeleton::skeleton::Skeleton;
use serde::Serialize;
use serde_json::Value;

use super::InputPaths;
use crate::Scenario;

/// Inputs recorded in `rollout.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Sources {
    /// Number of frames and their time range, and the fingerprint of the recording.
    frames: String,
    /// Point count of the skeleton, and a hash of its manifest.
    skeleton: String,
    /// Fingerprint of the HD map; `None` if there is none or if it cannot be read.
    map: Option<String>,
    /// Prompt parts.
    prompt: PromptParts,
}

impl Sources {
    pub(super) fn new(
        Scenario { log, map, .. }: &Scenario<'_>,
        skeleton: &Skeleton,
        prompt: &PromptParts,
    ) -> serde_json::Result<Self> {
        let manifest = &skeleton.manifest;
        let chunks = manifest.background.iter().map(|chunk| chunk.points);
        let points: usize = chunks.chain(manifest.actors.iter().map(|asset| asset.points)).sum();
        let hash = hashed(&serde_json::to_vec(manifest)?);
        Ok(Self {
            frames: frames(log),
            skeleton: format!("{points} points {hash}"),
            map: map.as_ref().map(|map| map.vector_map().fingerprint()),
            prompt: prompt.clone(),
        })
    }

    /// Compares with the sources of a rollout in `rollout.json`.
    pub(super) fn check(
        &self,
        before: &Value,
        rollout: &Path,
        paths: &InputPaths<'_>,
    ) -> Result<(), FileError> {
        let now = serde_json::to_value(self)
            .map_err(|error| FileError::content("sources", error.to_string(), rollout))?;
        let none = Path::new("none");
        let parts = [
            ("frames", paths.log),
            ("skeleton", paths.skeleton),
            ("map", paths.log),
            ("prompt", paths.prompt.unwrap_or(none)),
        ];
        for (name, file) in parts {
            let [before, now] = [before, &now].map(|sources| sources.get(name).cloned().unwrap_or_default());
            if before != now {
                let expected = format!("the {name} of {}, {before}", rollout.display());
                return Err(FileError::content(expected, format!("{now}; use another folder"), file));
            }
        }
        Ok(())
    }
}

fn frames(log: &Recording) -> String {
    let mut text = format!("{} frames", log.frames.len());
    if let (Some(first), Some(last)) = (log.frames.first(), log.frames.last()) {
        let _ = write!(text, " from {} to {} us", first.t_us, last.t_us); // writing to a string cannot fail
    }
    format!("{text} {}", log.fingerprint())
}

fn hashed(bytes: &[u8]) -> String {
    let mut hasher = rand_seeder::SipHasher::new();
    bytes.hash(&mut hasher);
    format!("{:016x}", hasher.finish())
}
