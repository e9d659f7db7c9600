//! Inputs of a rollout, which must be the same to resume it.

use std::fmt::Write;
use std::hash::{Hash, Hasher};
use std::path::Path;

use point_skeleton::conditions::meta::PromptParts;
use point_skeleton::dataset::Recording;
use point_skeleton::error::FileError;
use point_skeleton::geometry::{Cuboid, Pose};
use point_skeleton::skeleton::Skeleton;
use serde::Serialize;
use serde_json::Value;

use super::InputPaths;

/// Inputs recorded in `rollout.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Sources {
    /// Number of frames and their time range, and a hash of poses, boxes, tracks and lights.
    frames: String,
    /// Number of points of the skeleton, and a hash of its manifest.
    skeleton: String,
    /// Prompt parts.
    prompt: PromptParts,
}

impl Sources {
    pub(super) fn new(
        log: &Recording,
        skeleton: &Skeleton,
        prompt: &PromptParts,
    ) -> serde_json::Result<Self> {
        let manifest = &skeleton.manifest;
        let chunks = manifest.background.iter().map(|chunk| chunk.points);
        let points: usize = chunks.chain(manifest.actors.iter().map(|asset| asset.points)).sum();
        let hash = hashed(&serde_json::to_vec(manifest)?);
        Ok(Self { frames: frames(log), skeleton: format!("{points} points {hash}"), prompt: prompt.clone() })
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
        let parts =
            [("frames", paths.log), ("skeleton", paths.skeleton), ("prompt", paths.prompt.unwrap_or(none))];
        for (name, file) in parts {
            let [before, now] = [before, &now].map(|sources| sources.get(name).cloned().unwrap_or_default());
            if before != now {
                let expected = format!("the {name} of {}, {before}", rollout.display());
                return Err(FileError::content(expected, now.to_string(), file));
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
    let mut hasher = rand_seeder::SipHasher::new();
    for frame in &log.frames {
        frame.t_us.hash(&mut hasher);
        pose_bits(&frame.global_from_ego).hash(&mut hasher);
        for item in &frame.boxes {
            let Cuboid { pose, size } = &item.cuboid;
            (item.track, pose_bits(pose), size.to_array().map(f64::to_bits)).hash(&mut hasher);
        }
    }
    for track in &log.tracks {
        (&track.id, &track.category).hash(&mut hasher);
    }
    for light in &log.lights {
        (light.frame, &light.lane_connector, &light.color).hash(&mut hasher);
    }
    format!("{text} {:016x}", hasher.finish())
}

fn pose_bits(pose: &Pose) -> ([u64; 4], [u64; 3]) {
    (pose.rotation.to_array().map(f64::to_bits), pose.translation.to_array().map(f64::to_bits))
}

fn hashed(bytes: &[u8]) -> String {
    let mut hasher = rand_seeder::SipHasher::new();
    bytes.hash(&mut hasher);
    format!("{:016x}", hasher.finish())
}
