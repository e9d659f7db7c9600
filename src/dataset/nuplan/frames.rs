//! Frames: one per row of `lidar_pc`, with the sweep that it references.

use rustc_hash::FxHashMap;

use super::clocks::note_pose_times;
use super::database::{Database, Query, Row, hex};
use super::pickle;
use super::place::LogPaths;
use crate::dataset::clock::Unit;
use crate::dataset::recording::notes::{DANGLING_DATA, NO_SWEEP, Notes};
use crate::dataset::{DatasetError, Gap, SweepRecord};
use crate::error::FileError;
use crate::geometry::Pose;

/// Frame without images and boxes.
pub(super) struct FrameRecord {
    pub(super) token: Vec<u8>,
    /// Token of its scene, if any.
    pub(super) scene: Option<Vec<u8>>,
    pub(super) t_us: i64,
    pub(super) global_from_ego: Pose,
    /// `None` if its LiDAR is missing.
    pub(super) sweep: Option<SweepRecord>,
}

/// Pose columns of `ego_pose`. They follow the referencing token and the own token in a query.
pub(super) const POSE_COLUMNS: [&str; 7] =
    ["ego_pose.x", "ego_pose.y", "ego_pose.z", "ego_pose.qw", "ego_pose.qx", "ego_pose.qy", "ego_pose.qz"];

/// Reads all frames of the log or of a scene, in time order. Counts those without an ego pose instead. Also
/// returns the first and last time of the whole log.
///
/// # Errors
/// Fails if times do not increase from frame to frame or along `next_token`, or if there is no frame.
pub(super) fn read(
    database: &Database,
    place: &LogPaths,
    scene: Option<&[u8]>,
    notes: &mut Notes,
) -> Result<(Vec<FrameRecord>, [i64; 2]), DatasetError> {
    let lidars = lidars(database)?;
    let [x, y, z, qw, qx, qy, qz] = POSE_COLUMNS;
    let columns = &[
        "lidar_pc.token",
        "lidar_pc.timestamp",
        "lidar_pc.next_token",
        "lidar_pc.scene_token",
        "lidar_pc.lidar_token",
        "lidar_pc.filename",
        "lidar_pc.ego_pose_token",
        "ego_pose.token",
        x,
        y,
        z,
        qw,
        qx,
        qy,
        qz,
    ];
    let from = "FROM lidar_pc LEFT JOIN ego_pose ON ego_pose.token = lidar_pc.ego_pose_token \
        ORDER BY lidar_pc.timestamp, lidar_pc.token";
    let query = Query { table: "lidar_pc", columns, from };
    let mut shots = Vec::new();
    // Time by token, and for each `next_token` the token and time of the referencing row.
    let (mut times, mut nexts) = (FxHashMap::default(), Vec::new());
    database.rows(&query, |row| {
        let (token, t_us) = (row.blob(0)?, row.time_us(1)?);
        times.insert(token.to_owned(), t_us);
        if !row.is_null(2) {
            nexts.push((row.blob(2)?.to_owned(), token.to_owned(), t_us));
        }
        if scene.is_none_or(|wanted| !row.is_null(3) && row.blob(3).is_ok_and(|token| token == wanted)) {
            shots.extend(shot(row, database, place, &lidars, notes)?);
        }
        Ok(())
    })?;
    if let (true, Some(gap)) = (shots.is_empty(), notes.gaps.first()) {
        let found = format!("none ({gap})");
        return Err(FileError::content(
            "at least one row in lidar_pc with an ego pose",
            found,
            database.path(),
        )
        .into());
    }
    check_times(&shots, &nexts, &times, database)?;
    note_pose_times(database, notes)?;
    let ends = times.values().min().zip(times.values().max());
    Ok((shots, ends.map_or([0; 2], |(first, last)| [*first, *last])))
}

/// Returns the frame of a row; `None` if its ego pose is missing.
fn shot(
    row: &Row<'_>,
    database: &Database,
    place: &LogPaths,
    lidars: &FxHashMap<Vec<u8>, Pose>,
    notes: &mut Notes,
) -> Result<Option<FrameRecord>, DatasetError> {
    let (token, t_us, lidar) = (row.blob(0)?.to_owned(), row.time_us(1)?, row.reference(4)?);
    let Some(global_from_ego) = ego_pose(row, 6, database)? else {
        notes.gap(row.dangling(DANGLING_DATA, "ego_pose", row.reference(6)?));
        return Ok(None);
    };
    let name = row.text(5)?;
    let path = place.sensors.resolve(name).map_err(|error| row.wrong(5, &error.expected, &error.found))?;
    let ego_from_lidar = lidar.and_then(|lidar| lidars.get(lidar));
    if ego_from_lidar.is_none() {
        notes.gap(row.dangling(DANGLING_DATA, "lidar", lidar));
        notes.gap(Gap::record(NO_SWEEP, format!("frame at {t_us}"), database.path()));
    }
    let sweep = ego_from_lidar.map(|ego_from_lidar| SweepRecord {
        path,
        row: None,
        t_us,
        global_from_ego,
        ego_from_lidar: *ego_from_lidar,
        is_key: true,
    });
    let scene = row.reference(3)?.map(<[u8]>::to_owned);
    Ok(Some(FrameRecord { token, scene, t_us, global_from_ego, sweep }))
}

/// Returns the pose of a joined row of `ego_pose`, if there is one. Column `by` is the referencing token;
/// `ego_pose.token` and [`POSE_COLUMNS`] follow.
pub(super) fn ego_pose(row: &Row<'_>, by: usize, database: &Database) -> Result<Option<Pose>, DatasetError> {
    let token = row.reference(by)?.filter(|_| !row.is_null(by + 1));
    token.map(|token| pose(row, by + 2, &format!("ego_pose {}", hex(token)), database)).transpose()
}

/// Reads a pose from translation and quaternion columns; the quaternion `w x y z` comes last.
fn pose(row: &Row<'_>, first: usize, record: &str, database: &Database) -> Result<Pose, DatasetError> {
    let [x, y, z, qw, qx, qy, qz] = row.numbers(first)?;
    Pose::from_wxyz([qw, qx, qy, qz], [x, y, z]).map_err(|source| DatasetError::Pose {
        source,
        record: record.to_owned(),
        path: database.path().to_owned(),
    })
}

/// Checks that times increase from frame to frame and along `next_token`.
fn check_times(
    shots: &[FrameRecord],
    nexts: &[(Vec<u8>, Vec<u8>, i64)],
    times: &FxHashMap<Vec<u8>, i64>,
    database: &Database,
) -> Result<(), DatasetError> {
    let content =
        |expected: &str, found: String| Err(FileError::content(expected, found, database.path()).into());
    if shots.is_empty() {
        return content("at least one row in lidar_pc", "none".to_owned());
    }
    for pair in shots.windows(2) {
        if pair[0].t_us == pair[1].t_us {
            let (t_us, tokens) = (pair[0].t_us, [&pair[0].token, &pair[1].token].map(|token| hex(token)));
            let hint = Unit::MICROS.hint(t_us as f64);
            let found = format!("{t_us} in lidar_pc {} and {}{hint}", tokens[0], tokens[1]);
            return content("timestamps that grow from frame to frame", found);
        }
    }
    for (next, token, t_us) in nexts {
        // Logs are cut from longer recordings, so the last row may reference a missing one.
        if let Some(after) = times.get(next).filter(|after| *after <= t_us) {
            let found = format!("{after} in lidar_pc {} after {t_us} in {}", hex(next), hex(token));
            return content("timestamps that grow along next_token", found);
        }
    }
    Ok(())
}

/// Reads the extrinsics of the LiDARs, by token.
fn lidars(database: &Database) -> Result<FxHashMap<Vec<u8>, Pose>, DatasetError> {
    let mut lidars = FxHashMap::default();
    let query = Query { table: "lidar", columns: &["token", "translation", "rotation"], from: "FROM lidar" };
    database.rows(&query, |row| {
        lidars.insert(row.blob(0)?.to_owned(), extrinsics(row, 1, database)?);
        Ok(())
    })?;
    Ok(lidars)
}

/// Returns the extrinsics of a sensor from two adjacent columns of pickles: translation and rotation.
pub(super) fn extrinsics(row: &Row<'_>, first: usize, database: &Database) -> Result<Pose, DatasetError> {
    let translation = unpickled(row, first, "a pickled list of 3 numbers", pickle::Value::vector)?;
    let rotation = unpickled(row, first + 1, "a pickled list of 4 numbers", pickle::Value::vector)?;
    Pose::from_wxyz(rotation, translation).map_err(|source| DatasetError::Pose {
        source,
        record: row.name(),
        path: database.path().to_owned(),
    })
}

/// Decodes a pickle column of an expected shape.
pub(super) fn unpickled<T>(
    row: &Row<'_>,
    column: usize,
    expected: &str,
    shape: impl FnOnce(&pickle::Value) -> Option<T>,
) -> Result<T, DatasetError> {
    let value = pickle::decode(row.blob(column)?).map_err(|e| row.wrong(column, expected, &e.to_string()))?;
    shape(&value).ok_or_else(|| row.wrong(column, expected, &format!("{value}")))
}
