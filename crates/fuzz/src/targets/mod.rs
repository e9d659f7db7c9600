mod av2;
mod build;
mod cells;
mod clouds;
mod export;
mod network;
mod nuplan;
mod nuscenes;
mod peers;
mod pictures;
mod py123d;
mod rollout;
mod rollout_files;
mod scenario;
mod skeleton;
mod texts;

use std::path::PathBuf;

use serde_json::Value;
use tempfile::TempDir;

use crate::edits::edit;
use crate::{Memory, Seed, Target};

/// All targets, by family.
pub static TARGETS: std::sync::LazyLock<Vec<Target>> = std::sync::LazyLock::new(|| {
    let mut all = Vec::new();
    all.extend(clouds::TARGETS);
    all.extend(nuscenes::TARGETS);
    all.extend(nuplan::TARGETS);
    all.extend(av2::TARGETS);
    all.extend(cells::TARGETS);
    all.extend(py123d::TARGETS);
    all.extend(skeleton::TARGETS);
    all.extend(build::TARGETS);
    all.extend(network::TARGETS);
    all.extend(rollout::TARGETS);
    all.extend(rollout_files::TARGETS);
    all.extend(scenario::TARGETS);
    all.extend(export::TARGETS);
    all.extend(peers::TARGETS);
    all.extend(pictures::TARGETS);
    all.extend(texts::TARGETS);
    all
});

/// Limit for readers of one file, which start with at most a buffer of one megabyte.
const SMALL: Memory = Memory { fixed: 4 << 20, factor: 100 };
/// Limit for readers of whole data sets.
const LARGE: Memory = Memory { fixed: 16 << 20, factor: 1000 };

/// Folder for files that a target rewrites in every run.
struct Scratch(TempDir);

impl Scratch {
    fn new() -> Self {
        Self(tempfile::tempdir().expect("a temporary folder"))
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn put(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.path(name);
        std::fs::write(&path, bytes).expect("a file of ours");
        path
    }
}

fn seed(name: &str, bytes: impl Into<Vec<u8>>) -> Seed {
    (name.to_owned(), bytes.into())
}

fn edited(base: &Value, edits: &[u8]) -> Value {
    let mut value = base.clone();
    edit(&mut value, edits);
    value
}

/// Returns seeds that edit any JSON: they descend some levels and apply each kind of change.
fn edit_seeds() -> Vec<Seed> {
    let edits = |kind: u8| {
        let down = [kind, 0, kind / 3, 1];
        [&down[..], &[255], &down[..2], &[255, kind, 7, 7]].concat()
    };
    let mut seeds: Vec<Seed> = (0..16).map(|kind| seed(&format!("edit{kind}"), edits(kind))).collect();
    seeds.push(seed("none", []));
    seeds
}
