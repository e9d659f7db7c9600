//! Conversion of one scene's tables to a [`Log`].

use std::collections::BTreeMap;
use std::path::Path;

use rustc_hash::{FxHashMap, FxHashSet};

use super::tables::{Attribute, LogRecord, MapRecord, Sample, Scene, Table, Visibility};
use super::{annotations, choose, frames};
use crate::dataset::{DatasetError, Frame, Log, RigCamera};
use crate::error::FileError;
use crate::files::input::DataRoot;

/// Number of skipped or missing items by kind.
pub(super) type Notes = BTreeMap<String, usize>;

/// Counts a skipped item.
pub(super) fn note(notes: &mut Notes, kind: &str) {
    *notes.entry(kind.to_owned()).or_default() += 1;
}

/// Samples of a scene in time order.
pub(super) struct Chain {
    /// Timestamp of each sample.
    pub(super) times_us: Vec<i64>,
    /// Index in the chain by token.
    pub(super) place: FxHashMap<String, usize>,
}

/// Reads the log of a scene. Also returns the stated number of LiDAR points per frame and box.
pub(super) fn read(
    root: &DataRoot,
    tables: &Path,
    wanted_scene: Option<&str>,
) -> Result<(Log, Vec<Vec<u32>>), DatasetError> {
    let scenes = Table::<Scene>::load_all(tables)?;
    let scene = choose::choose_scene(&scenes, wanted_scene)?;
    let logs = Table::<LogRecord>::load_all(tables)?;
    let recorded = logs.get(&scene.log_token, || format!("scene {}", scene.token))?;
    // These three tables are unused, but a dataset without them is damaged.
    Table::<Attribute>::load_all(tables)?;
    Table::<Visibility>::load_all(tables)?;
    Table::<MapRecord>::load_all(tables)?;

    let mut notes = Notes::new();
    let chain = read_chain(tables, scene, &mut notes)?;
    let shots = frames::read(root, tables, &chain, &mut notes)?;
    let annotated = annotations::read(tables, &chain)?;
    let (mut log_frames, mut box_points) = (Vec::new(), Vec::new());
    for ((t_us, shot), (boxes, points)) in chain.times_us.iter().zip(shots.frames).zip(annotated.frames) {
        let (sweeps, images, between_images) = (shot.sweeps, shot.images, shot.between_images);
        let global_from_ego = shot.global_from_ego;
        log_frames.push(Frame { t_us: *t_us, global_from_ego, sweeps, images, between_images, boxes });
        box_points.push(points);
    }
    let log = Log {
        name: scene.name.clone(),
        location: recorded.location.clone(),
        description: scene.description.clone(),
        cameras: shots.cameras,
        rig: RigCamera::first_used(&log_frames),
        tracks: annotated.tracks,
        frames: log_frames,
        notes,
        ..Log::default()
    };
    Ok((log, box_points))
}

/// Follows the chain of a scene's samples from the first one.
fn read_chain(tables: &Path, scene: &Scene, notes: &mut Notes) -> Result<Chain, DatasetError> {
    let samples = Table::<Sample>::load_all(tables)?;
    let mut chain = Chain { times_us: Vec::new(), place: FxHashMap::default() };
    let mut seen = FxHashSet::default();
    if scene.first_sample_token.is_empty() {
        let found = format!("none in scene {}", scene.token);
        return Err(FileError::content("a first sample", found, &tables.join("scene.json")).into());
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
            let found = format!("{t_us} in sample {token} after {last}");
            return Err(content("timestamps that grow along the chain of samples", found).into());
        }
        chain.place.insert(token.clone(), chain.times_us.len());
        chain.times_us.push(t_us);
        by = format!("sample {token}");
        token = &sample.next;
    }
    for sample in &samples.records {
        if sample.scene_token == scene.token && !seen.contains(&sample.token) {
            note(notes, "samples outside of the scene's chain");
        }
    }
    Ok(chain)
}
