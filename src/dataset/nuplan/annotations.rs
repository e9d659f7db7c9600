//! Tracks and boxes of a log.

use glam::DVec3;
use rustc_hash::{FxHashMap, FxHashSet};

use super::database::{Database, Query, Row, hex};
use super::frames::FrameRecord;
use crate::dataset::recording::notes::{
    DANGLING_BOX, FLAT_BOX, NO_ANNOTATIONS, Notes, note, note_unknown_category,
};
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

/// Row of `track`.
struct TrackRow {
    token: Vec<u8>,
    /// Token of its category, if any.
    category: Option<Vec<u8>>,
    /// `None` if its category is missing.
    track: Option<Track>,
}

/// Reads the boxes of the frames. Counts boxes without a size, and those that refer to frames, tracks or
/// categories that are missing from the log.
pub(super) fn read(
    database: &Database,
    shots: &[FrameRecord],
    notes: &mut Notes,
) -> Result<Annotations, DatasetError> {
    let all = tracks(database)?;
    let by_token: FxHashMap<&[u8], usize> =
        all.iter().enumerate().map(|(i, row)| (row.token.as_slice(), i)).collect();
    let places: FxHashMap<&[u8], usize> =
        shots.iter().enumerate().map(|(i, shot)| (shot.token.as_slice(), i)).collect();
    let (mut others, mut has_boxes) = (None, false);
    let mut frames: Vec<Vec<TrackBox>> = shots.iter().map(|_| Vec::new()).collect();
    let columns =
        &["token", "lidar_pc_token", "track_token", "x", "y", "z", "length", "width", "height", "yaw"];
    database.rows(&Query { table: "lidar_box", columns, from: "FROM lidar_box" }, |row| {
        has_boxes = true;
        let (frame, token) = (row.blob(1)?, row.reference(2)?);
        let Some(place) = places.get(frame) else {
            // The frame belongs to another scene or is missing, since logs are cut from longer recordings.
            let others = match &mut others {
                Some(others) => others,
                empty => empty.insert(frame_tokens(database)?),
            };
            note(notes, "boxes of frames that are not there", usize::from(!others.contains(frame)));
            return Ok(());
        };
        let Some(index) = token.and_then(|token| by_token.get(token)).copied() else {
            notes.gap(row.dangling(DANGLING_BOX, "track", token));
            return Ok(());
        };
        let TrackRow { category, track, .. } = &all[index];
        let Some(track) = track else {
            notes.gap(row.dangling(DANGLING_BOX, "category", category.as_deref()));
            return Ok(());
        };
        match cuboid(row, database)? {
            Some(cuboid) => {
                if CategoryKind::of(&track.category).is_none() {
                    note_unknown_category(notes, &track.category, 1);
                }
                frames[*place].push(TrackBox { track: index, cuboid });
            }
            None => notes.gap(Gap::record(FLAT_BOX, row.name(), database.path())),
        }
        Ok(())
    })?;
    drop(by_token);
    if !has_boxes {
        notes.gap(Gap::record(NO_ANNOTATIONS, "frames are without actors", database.path()));
    }
    for (boxes, shot) in frames.iter_mut().zip(shots) {
        boxes.sort_by_key(|b| b.track);
        if let Some(pair) = boxes.windows(2).find(|pair| pair[0].track == pair[1].track) {
            let found =
                format!("two of track {} in lidar_pc {}", hex(&all[pair[0].track].token), hex(&shot.token));
            return Err(FileError::content("one box per track and frame", found, database.path()).into());
        }
    }
    Ok(without_unseen(all, frames))
}

/// Reads all tracks in token order.
fn tracks(database: &Database) -> Result<Vec<TrackRow>, DatasetError> {
    let columns = &["track.token", "track.category_token", "category.token", "category.name"];
    let from = "FROM track LEFT JOIN category ON category.token = track.category_token ORDER BY track.token";
    let mut tracks = Vec::new();
    database.rows(&Query { table: "track", columns, from }, |row| {
        let (token, category) = (row.blob(0)?.to_owned(), row.reference(1)?.map(<[u8]>::to_owned));
        let name = if row.is_null(2) { None } else { Some(row.text(3)?) };
        let track = name.map(|name| {
            let class = Class::from_category(name);
            Track { id: hex(&token), category: name.to_owned(), class }
        });
        tracks.push(TrackRow { token, category, track });
        Ok(())
    })?;
    Ok(tracks)
}

/// Reads all frame tokens of the log.
pub(super) fn frame_tokens(database: &Database) -> Result<FxHashSet<Vec<u8>>, DatasetError> {
    let mut tokens = FxHashSet::default();
    database.rows(&Query { table: "lidar_pc", columns: &["token"], from: "FROM lidar_pc" }, |row| {
        tokens.insert(row.blob(0)?.to_owned());
        Ok(())
    })?;
    Ok(tokens)
}

/// Returns the box of a row, from its center and yaw in the global frame; `None` if it has no size.
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
fn without_unseen(all: Vec<TrackRow>, mut frames: Vec<Vec<TrackBox>>) -> Annotations {
    let seen: FxHashSet<usize> = frames.iter().flatten().map(|b| b.track).collect();
    let (mut tracks, mut places) = (Vec::new(), vec![0; all.len()]);
    for (i, row) in all.into_iter().enumerate() {
        if let Some(track) = row.track.filter(|_| seen.contains(&i)) {
            places[i] = tracks.len();
            tracks.push(track);
        }
    }
    frames.iter_mut().flatten().for_each(|b| b.track = places[b.track]);
    Annotations { tracks, frames }
}
