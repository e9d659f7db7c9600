//! Inputs of a rollout, which must be the same to resume it.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::hash::{Hash, Hasher};
use std::path::{Path, PathBuf};

use point_skeleton::conditions::write::meta::PromptParts;
use point_skeleton::dataset::{Appearance, Recording};
use point_skeleton::error::FileError;
use point_skeleton::files::input::read_file;
use point_skeleton::skeleton::Skeleton;
use serde::Serialize;
use serde_json::Value;

use super::{InputPaths, RolloutError};
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
    /// Hash of each file that an actor looks like, by track.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    files: BTreeMap<String, String>,
    /// Their paths, for errors.
    #[serde(skip)]
    paths: BTreeMap<String, PathBuf>,
}

impl Sources {
    /// Identifies the inputs of a rollout.
    ///
    /// # Errors
    /// Fails if a file that an actor of the scenario looks like cannot be read.
    pub(super) fn new(
        Scenario { log, map, .. }: &Scenario<'_>,
        skeleton: &Skeleton,
        prompt: &PromptParts,
    ) -> Result<Self, RolloutError> {
        let manifest = &skeleton.manifest;
        let chunks = manifest.background.iter().map(|chunk| chunk.points);
        let points: usize = chunks.chain(manifest.actors.iter().map(|asset| asset.points)).sum();
        let hash = hashed(&serde_json::to_vec(manifest)?);
        Ok(Self {
            frames: frames(log),
            skeleton: format!("{points} points {hash}"),
            map: map.as_ref().map(|map| map.vector_map().fingerprint()),
            prompt: prompt.clone(),
            files: hashes_of_files(log)?,
            paths: paths_of_files(log).map(|(track, path)| (track.clone(), path.to_owned())).collect(),
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
        self.check_files(before, rollout)
    }

    /// Checks that the files of the scenario have the same content.
    fn check_files(&self, before: &Value, rollout: &Path) -> Result<(), FileError> {
        for (track, now) in &self.files {
            let before = &before["files"][track];
            if *before != *now {
                let expected = format!("the points of {track} in {}, {before}", rollout.display());
                let file = self.paths.get(track).map_or(rollout, PathBuf::as_path);
                return Err(FileError::content(expected, format!("{now:?}; use another folder"), file));
            }
        }
        Ok(())
    }
}

/// Returns the files and skeletons that actors look like, by track.
fn paths_of_files(log: &Recording) -> impl Iterator<Item = (&String, &Path)> {
    log.edits.replace.iter().filter_map(|(track, look)| match look {
        Appearance::File(path) | Appearance::Skeleton { skeleton: path, .. } => Some((track, path.as_path())),
        Appearance::Track(_) | Appearance::Template => None,
    })
}

/// Returns hashes of the files that actors look like, by track: of a skeleton, its manifest's, which has the
/// checksums of all points.
fn hashes_of_files(log: &Recording) -> Result<BTreeMap<String, String>, RolloutError> {
    let hash = |(track, path): (&String, &Path)| {
        let bytes = match log.edits.replace.get(track) {
            Some(Appearance::Skeleton { .. }) => serde_json::to_vec(&Skeleton::open(path)?.manifest)?,
            _ => read_file(path, u64::MAX)?,
        };
        Ok((track.clone(), hashed(&bytes)))
    };
    paths_of_files(log).map(hash).collect()
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
