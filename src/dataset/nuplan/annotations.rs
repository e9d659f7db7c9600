//! Tracks and boxes of a log.

use glam::DVec3;
use rustc_hash::{FxHashMap, FxHashSet};

use super::database::{Database, Query, Row, hex};
use super::frames::FrameRecord;
use crate::dataset::notes::{FLAT_BOX, Notes, note, note_unknown_category};
use crate::dataset::{CategoryKind, Class, DatasetError, Gap, Track, TrackBox};
use crate::error::FileError;
use crate::geometry::{Cuboid, Pose, PoseError};

/// Tracks with a box in at least one frame, and the boxes of each frame.
pub(super) struct Annotations {
    /// Sorted by id.
    pub(super) tracks: Vec<Track>,
    /// Boxes per frame, sorted by track.
    pub(super) frames: Vec<Vec<TrackBox>>,
}

/// Reads the boxes of the frames. Counts boxes without a size and boxes of frames that are missing from the log.
pub(super) fn read(
    database: &Database,
    shots: &[FrameRecord],
    notes: &mut Notes,
) -> Result<Annotations, DatasetError> {
    let all = tracks(database)?;
    let by_token: FxHashMap<&[u8], usize> =
        all.iter().enumerate().map(|(i, (token, _))| (token.as_slice(), i)).collect();
    let places: FxHashMap<&[u8], usize> =
        shots.iter().enumerate().map(|(i, shot)| (shot.token.as_slice(), i)).collect();
    let mut others = None;
    let mut frames: Vec<Vec<TrackBox>> = shots.iter().map(|_| Vec::new()).collect();
    let columns =
        &["token", "lidar_pc_token", "track_token", "x", "y", "z", "length", "width", "height", "yaw"];
    database.rows(&Query { table: "lidar_box", columns, from: "FROM lidar_box" }, |row| {
        let (frame, track) = (row.blob(1)?, row.blob(2)?);
        let Some(place) = places.get(frame) else {
            // The frame belongs to another scene or is missing, since logs are cut from longer recordings.
            let others = match &mut others {
                Some(others) => others,
                empty => empty.insert(frame_tokens(database)?),
            };
            note(notes, "boxes of frames that are not there", usize::from(!others.contains(frame)));
            return Ok(());
        };
        let track = *by_token.get(track).ok_or_else(|| row.dangling("track", track))?;
        match cuboid(row, database)? {
            Some(cuboid) => {
                if CategoryKind::of(&all[track].1.category).is_none() {
                    note_unknown_category(notes, &all[track].1.category, 1);
                }
                frames[*place].push(TrackBox { track, cuboid });
            }
            None => notes.gap(Gap::record(FLAT_BOX, row.name(), database.path())),
        }
        Ok(())
    })?;
    drop(by_token);
    for (boxes, shot) in frames.iter_mut().zip(shots) {
        boxes.sort_by_key(|b| b.track);
        if let Some(pair) = boxes.windows(2).find(|pair| pair[0].track == pair[1].track) {
            let found =
                format!("two of track {} in lidar_pc {}", hex(&all[pair[0].track].0), hex(&shot.token));
            return Err(FileError::content("one box per track and frame", found, database.path()).into());
        }
    }
    Ok(without_unseen(all, frames))
}

/// Reads all tracks in token order.
fn tracks(database: &Database) -> Result<Vec<(Vec<u8>, Track)>, DatasetError> {
    let columns = &["track.token", "track.category_token", "category.token", "category.name"];
    let from = "FROM track LEFT JOIN category ON category.token = track.category_token ORDER BY track.token";
    let mut tracks = Vec::new();
    database.rows(&Query { table: "track", columns, from }, |row| {
        let (token, category) = (row.blob(0)?, row.blob(1)?);
        if row.is_null(2) {
            return Err(row.dangling("category", category));
        }
        let category = row.text(3)?.to_owned();
        let class = Class::from_category(&category);
        tracks.push((token.to_owned(), Track { id: hex(token), category, class }));
        Ok(())
    })?;
    Ok(tracks)
}

/// Reads the tokens of all frames of the log.
pub(super) fn frame_tokens(database: &Database) -> Result<FxHashSet<Vec<u8>>, DatasetError> {
    let mut tokens = FxHashSet::default();
    database.rows(&Query { table: "lidar_pc", columns: &["token"], from: "FROM lidar_pc" }, |row| {
        tokens.insert(row.blob(0)?.to_owned());
        Ok(())
    })?;
    Ok(tokens)
}

/// Returns the box of a row, from its center and yaw in the global frame. `None` if a side is zero or negative.
fn cuboid(row: &Row<'_>, database: &Database) -> Result<Option<Cuboid>, DatasetError> {
    let [x, y, z, length, width, height, yaw_rad] = row.numbers(3)?;
    let (record, path) = (row.name(), database.path().to_owned());
    if let Some(value) = [x, y, z, yaw_rad].into_iter().find(|v| !v.is_finite()) {
        return Err(DatasetError::Pose { source: PoseError::NotFinite { value }, record, path });
    }
    let pose = Pose::from_yaw(yaw_rad, DVec3::new(x, y, z));
    let cuboid = Cuboid::unless_flat(pose, DVec3::new(length, width, height));
    cuboid.map_err(|source| DatasetError::Cuboid { source, record, path })
}

/// Removes tracks without a box and renumbers the others in the same order.
fn without_unseen(all: Vec<(Vec<u8>, Track)>, mut frames: Vec<Vec<TrackBox>>) -> Annotations {
    let seen: FxHashSet<usize> = frames.iter().flatten().map(|b| b.track).collect();
    let (mut tracks, mut places) = (Vec::new(), vec![0; all.len()]);
    for (i, (_, track)) in all.into_iter().enumerate() {
        if seen.contains(&i) {
            places[i] = tracks.len();
            tracks.push(track);
        }
    }
    frames.iter_mut().flatten().for_each(|b| b.track = places[b.track]);
    Annotations { tracks, frames }
}
