mod av2;
mod build;
mod clouds;
mod network;
mod nuplan;
mod nuscenes;
mod peers;
mod pictures;
mod rollout;
mod skeleton;
mod texts;

use std::path::PathBuf;

use serde_json::Value;
use tempfile::TempDir;

use crate::edits::edit;
use crate::{Memory, Seed, Target};

/// All of them, by family.
pub static TARGETS: std::sync::LazyLock<Vec<Target>> = std::sync::LazyLock::new(|| {
    let mut all = Vec::new();
    all.extend(clouds::TARGETS);
    all.extend(nuscenes::TARGETS);
    all.extend(nuplan::TARGETS);
    all.extend(av2::TARGETS);
    all.extend(skeleton::TARGETS);
    all.extend(build::TARGETS);
    all.extend(network::TARGETS);
    all.extend(rollout::TARGETS);
    all.extend(peers::TARGETS);
    all.extend(pictures::TARGETS);
    all.extend(texts::TARGETS);
    all
});

/// Of readers of one file: a buffer of a megabyte is the most that they begin with.
const SMALL: Memory = Memory { fixed: 4 << 20, factor: 100 };
/// Of readers of whole data sets.
const LARGE: Memory = Memory { fixed: 16 << 20, factor: 1000 };

/// A folder for files that a target writes anew each time.
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

/// Edits of whatever JSON there is: down by some steps, then each kind of change.
fn edit_seeds() -> Vec<Seed> {
    let edits = |kind: u8| {
        let down = [kind, 0, kind / 3, 1];
        [&down[..], &[255], &down[..2], &[255, kind, 7, 7]].concat()
    };
    let mut seeds: Vec<Seed> = (0..16).map(|kind| seed(&format!("edit{kind}"), edits(kind))).collect();
    seeds.push(seed("none", []));
    seeds
}
