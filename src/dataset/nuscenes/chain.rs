//! The chain of a scene's samples.

use rustc_hash::{FxHashMap, FxHashSet};

use super::tables::{Sample, Scene, Table};
use crate::dataset::DatasetError;
use crate::dataset::clock::Unit;
use crate::dataset::recording::notes::{Notes, note};
use crate::error::FileError;

/// Samples of a scene in time order.
pub(super) struct Chain {
    /// Timestamp of each sample.
    pub(super) times_us: Vec<i64>,
    /// Index in the chain by token.
    pub(super) place: FxHashMap<String, usize>,
}

impl Chain {
    /// Follows the chain of a scene's samples from the first one.
    pub(super) fn of(
        samples: &Table<Sample>,
        scene: &Scene,
        notes: &mut Notes,
    ) -> Result<Self, DatasetError> {
        let mut chain = Self { times_us: Vec::new(), place: FxHashMap::default() };
        let mut seen = FxHashSet::default();
        if scene.first_sample_token.is_empty() {
            let found = format!("none in scene {}", scene.token);
            return Err(FileError::content(
                "a first sample",
                found,
                &samples.path.with_file_name("scene.json"),
            )
            .into());
        }
        let (mut token, mut by) = (&scene.first_sample_token, format!("scene {}", scene.token));
        while !token.is_empty() {
            let sample = samples.get(token, || by.clone())?;
            let content = |expected: &str, found: String| FileError::content(expected, found, &samples.path);
            if !seen.insert(token) {
                return Err(content("a chain of samples that ends", format!("sample {token} twice")).into());
            }
            if sample.scene_token != scene.token {
                let found = format!("sample {token} of scene {}", sample.scene_token);
                return Err(content(&format!("samples of scene {} in its chain", scene.token), found).into());
            }
            let t_us = sample.timestamp.0;
            if let Some(last) = chain.times_us.last().filter(|last| **last >= t_us) {
                let found =
                    format!("{t_us} in sample {token} after {last}{}", Unit::MICROS.hint(t_us as f64));
                return Err(content("timestamps that grow along the chain of samples", found).into());
            }
            chain.place.insert(token.clone(), chain.times_us.len());
            chain.times_us.push(t_us);
            by = format!("sample {token}");
            token = &sample.next;
        }
        for sample in &samples.records {
            if sample.scene_token == scene.token && !seen.contains(&sample.token) {
                note(notes, "samples outside of the scene's chain", 1);
            }
        }
        Ok(chain)
    }
}
