use std::collections::BTreeMap;

use glam::DVec3;

use super::change::{Action, Insert};
use super::resolve::{Mismatch, mismatch, resolve};
use crate::dataset::{ActorEdits, Appearance, CategoryKind, EditError, Frame, Recording, Track, TrackBox};
use crate::geometry::{Cuboid, Pose};

/// Adds the inserted tracks and the script of timed changes to a log, and the boxes where the recorded ego
/// meets them. `source` is the log without edits, `log` the one with its other edits.
///
/// # Errors
/// Fails if a change does not fit the log.
pub(in crate::dataset) fn apply(
    edits: &ActorEdits,
    source: &Recording,
    log: &mut Recording,
) -> Result<(), EditError> {
    if edits.changes.is_empty() {
        return Ok(());
    }
    let mut new_sizes = BTreeMap::new();
    for (index, change) in edits.changes.iter().enumerate() {
        let Action::Insert(insert) = &change.action else { continue };
        let (track, size) =
            new_actor(edits, source, &change.track, insert).map_err(|(expected, found)| {
                EditError::Change { number: index + 1, track: change.track.clone(), expected, found }
            })?;
        if new_sizes.insert(track.id.clone(), size).is_none() {
            add_track(log, track);
        }
    }
    let size = |track: usize| new_sizes.get(&log.tracks[track].id).copied();
    let is_changed = |id: &str| edits.changes.iter().any(|change| change.track == id);
    let changed = (0..log.tracks.len()).filter(|track| is_changed(&log.tracks[*track].id));
    let sizes = changed.map(|track| (track, size(track).unwrap_or_else(|| log.median_size(track)))).collect();
    log.script = resolve(&edits.changes, log, &sizes)?;
    perform(log);
    Ok(())
}

/// Returns the track and the size (meters) of a new actor.
fn new_actor(
    edits: &ActorEdits,
    source: &Recording,
    id: &str,
    insert: &Insert,
) -> Result<(Track, DVec3), Mismatch> {
    let find = |id: &str| source.tracks.iter().position(|track| track.id == id);
    if id.is_empty() || find(id).is_some() {
        return Err(mismatch("a track that the log does not have", &format!("{id:?}")));
    }
    let like = match edits.replace.get(id) {
        Some(Appearance::Track(other)) => {
            let like = find(other).filter(|track| !source.track_boxes(*track).is_empty());
            Some(like.ok_or_else(|| mismatch("a track of the log to look like", &format!("{other:?}")))?)
        }
        _ => None,
    };
    let category = insert.category.clone().or(like.map(|like| source.tracks[like].category.clone()));
    let category = category.ok_or_else(|| mismatch("a category, or a track to look like", "none"))?;
    let Some(kind) = CategoryKind::of(&category) else {
        return Err(mismatch("a category as in nuScenes, like vehicle.car", &format!("{category:?}")));
    };
    let size = insert.size_m.map(DVec3::from).or(like.map(|like| source.median_size(like)));
    let size = size.ok_or_else(|| mismatch("size_m, or a track to look like", "none"))?;
    match Cuboid::new(Pose::IDENTITY, size) {
        Ok(_) => Ok((Track { id: id.to_owned(), category, class: kind.class() }, size)),
        Err(_) => Err(mismatch("the size_m of a box", &format!("{:?}", size.to_array()))),
    }
}

/// Adds a track, in the order of ids.
fn add_track(log: &mut Recording, track: Track) {
    let place = log.tracks.partition_point(|other| other.id < track.id);
    log.tracks.insert(place, track);
    let boxes = log.frames.iter_mut().flat_map(|frame| &mut frame.boxes);
    boxes.filter(|item| item.track >= place).for_each(|item| item.track += 1);
}

/// Gives the frames the boxes of the script with the recorded ego.
fn perform(log: &mut Recording) {
    let script = log.script.clone();
    let triggers = script.recorded(log, i64::MAX);
    let tracks: Vec<usize> = script.tracks().collect();
    for Frame { t_us, boxes, .. } in &mut log.frames {
        let known = script.known_at(&triggers, *t_us);
        boxes.retain(|item| tracks.binary_search(&item.track).is_err());
        let changed = tracks.iter().filter_map(|track| {
            let cuboid = script.box_at(*track, *t_us, &known)?;
            Some(TrackBox { track: *track, cuboid })
        });
        boxes.extend(changed);
        boxes.sort_by_key(|item| item.track);
    }
}
