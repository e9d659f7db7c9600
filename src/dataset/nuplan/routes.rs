//! Routes to the destination: one per scene of a log.

use rustc_hash::FxHashMap;

use super::database::{Database, Query};
use super::frames::{FrameRecord, POSE_COLUMNS, ego_pose};
use crate::dataset::recording::notes::{Notes, note};
use crate::dataset::{DatasetError, NavigationRoute};
use crate::geometry::Pose;

/// Roadblocks and goal of a scene.
type SceneRoute = (Vec<String>, Option<Pose>);

/// Reads the routes of the frames; a new one begins where the scene changes. Counts goals whose pose is
/// missing: logs are cut from longer recordings.
pub(super) fn read(
    database: &Database,
    shots: &[FrameRecord],
    notes: &mut Notes,
) -> Result<Vec<NavigationRoute>, DatasetError> {
    let scenes = scenes(database, notes)?;
    let mut routes = Vec::new();
    let mut before = None;
    for (frame, shot) in shots.iter().enumerate() {
        let scene = shot.scene.as_deref();
        if let Some((roadblocks, goal)) = scene.filter(|_| scene != before).and_then(|s| scenes.get(s)) {
            routes.push(NavigationRoute { frame, roadblocks: roadblocks.clone(), goal: *goal });
        }
        before = scene;
    }
    Ok(routes)
}

fn scenes(database: &Database, notes: &mut Notes) -> Result<FxHashMap<Vec<u8>, SceneRoute>, DatasetError> {
    let own = ["scene.token", "scene.roadblock_ids", "scene.goal_ego_pose_token", "ego_pose.token"];
    let columns = &[&own[..], &POSE_COLUMNS].concat();
    let from = "FROM scene LEFT JOIN ego_pose ON ego_pose.token = scene.goal_ego_pose_token";
    let mut scenes = FxHashMap::default();
    database.rows(&Query { table: "scene", columns, from }, |row| {
        let roadblocks = if row.is_null(1) { "" } else { row.text(1)? };
        let has_goal = row.reference(2)?.is_some_and(|token| !token.is_empty());
        let goal = ego_pose(row, 2, database)?;
        note(notes, "missing goals of routes", usize::from(has_goal && goal.is_none()));
        let roadblocks = roadblocks.split_whitespace().map(str::to_owned).collect();
        scenes.insert(row.blob(0)?.to_owned(), (roadblocks, goal));
        Ok(())
    })?;
    Ok(scenes)
}
