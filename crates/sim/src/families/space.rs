use std::collections::BTreeMap;

use glam::{DVec2, DVec3, Vec3};
use point_skeleton::dataset::{EgoTrack, Recording};
use point_skeleton::error::FileError;
use point_skeleton::geometry::{Cuboid, Footprint};
use point_skeleton::skeleton::Skeleton;

use super::course::Course;
use super::family::TRACK;
use crate::metrics::Road;
use crate::recorded::Recorded;
use crate::state::ego_cuboid;

/// Interval at which the way is tested, and time after the collision until which it is, microseconds.
const STEP_US: usize = 200_000;
const AFTER_US: i64 = 1_000_000;
/// Side of the cells of static points, meters.
const CELL_M: f64 = 0.25;
/// Number of points in a cell that are an obstacle.
const MIN_POINTS: u32 = 4;
/// Heights above the ground between which points are obstacles, meters.
const HEIGHTS_M: [f64; 2] = [0.4, 1.8];
/// Maximum distance of static points from the ego's path, meters.
const REACH_M: f64 = 40.0;
/// Maximum share of a vehicle outside the drivable area.
const MAX_OFF_ROAD: f64 = 0.5;

/// Cells with static points of a skeleton near the ego's path.
pub struct StaticSpace(BTreeMap<[i64; 2], u32>);

impl StaticSpace {
    /// Collects the background of a skeleton between 0.4 and 1.8 m above the nearest ego origin of a log.
    ///
    /// # Errors
    /// Fails if points do not match their checksum.
    pub fn new(skeleton: &Skeleton, log: &Recording) -> Result<Self, FileError> {
        let ego = EgoTrack::new(log);
        let origins: Vec<DVec3> = ego.poses().iter().map(|(_, pose)| pose.translation).collect();
        let nearest = |at: DVec2| {
            let distance_m = |origin: &&DVec3| origin.truncate().distance(at);
            let found = origins.iter().min_by(|a, b| distance_m(a).total_cmp(&distance_m(b)));
            found.filter(|origin| origin.truncate().distance(at) <= REACH_M)
        };
        let mut heights: BTreeMap<[i64; 2], Option<f64>> = BTreeMap::new();
        let mut cells = BTreeMap::new();
        let chunks = skeleton.manifest.background.iter().zip(skeleton.background()?);
        for (chunk, points) in chunks {
            for point in points {
                let at = DVec3::from(chunk.origin) + Vec3::from(point.position).as_dvec3();
                if !at.is_finite() {
                    continue;
                }
                let coarse = (at.truncate() / 4.0).floor();
                let ground = heights
                    .entry(coarse.to_array().map(|part| part as i64))
                    .or_insert_with(|| nearest((coarse + 0.5) * 4.0).map(|origin| origin.z));
                if ground.is_some_and(|z| (HEIGHTS_M[0]..HEIGHTS_M[1]).contains(&(at.z - z))) {
                    *cells.entry(cell(at.truncate())).or_insert(0) += 1;
                }
            }
        }
        cells.retain(|_, count| *count >= MIN_POINTS);
        Ok(Self(cells))
    }

    /// Returns whether the center of an occupied cell is in a footprint.
    fn is_in_the_way(&self, body: &Footprint) -> bool {
        let [min, max] = [-1.0, 1.0].map(|sign| cell(body.center + sign * body.radius_m()));
        let center = |key: &[i64; 2]| (DVec2::new(key[0] as f64, key[1] as f64) + 0.5) * CELL_M;
        let columns = (min[0]..=max[0]).flat_map(|x| self.0.range([x, min[1]]..=[x, max[1]]));
        let inside = |place: &DVec2| body.local(*place).abs().cmple(body.half_m).all();
        columns.map(|(key, _)| center(key)).any(|place| inside(&place))
    }
}

fn cell(at: DVec2) -> [i64; 2] {
    (at / CELL_M).floor().to_array().map(|part| part as i64)
}

/// What is in the way of an actor.
pub(super) enum Obstacle {
    /// Track of the log.
    Actor(String),
    /// Something that stays.
    Fixed(&'static str),
}

/// Returns what is in the way of the actor on collision course until shortly after the collision; `None` if
/// nothing is. `edited` has the actor.
pub(super) fn in_the_way(
    recorded: &Recorded<'_>,
    edited: &Recording,
    course: &Course,
    road: Option<&Road>,
    space: Option<&StaticSpace>,
) -> Option<Obstacle> {
    let track = edited.tracks.iter().position(|track| track.id == TRACK)?;
    let triggers = edited.script.timed();
    for t_us in (course.start_us..course.collision_us + AFTER_US).step_by(STEP_US) {
        let Some(cuboid) = edited.script.box_at(track, t_us, &triggers) else { continue };
        let body = Footprint::from(&cuboid);
        let meets = |other: &Cuboid| {
            let other = Footprint::from(other);
            body.center.distance(other.center) <= body.radius_m() + other.radius_m() && body.overlaps(&other)
        };
        let others = edited.boxes_at(t_us).into_iter().filter(|item| item.track != track);
        if let Some(other) = others.into_iter().find(|item| meets(&item.cuboid)) {
            return Some(Obstacle::Actor(edited.tracks[other.track].id.clone()));
        }
        // At the start; later it is the ego that is to be met.
        let ego = recorded.ego_at(t_us).filter(|_| t_us == course.start_us);
        if ego.is_some_and(|ego| meets(&ego_cuboid(&ego.pose))) {
            return Some(Obstacle::Fixed("the ego"));
        }
        if road.is_some_and(|road| road.share_off(&cuboid) > MAX_OFF_ROAD) {
            return Some(Obstacle::Fixed("the edge of the drivable area"));
        }
        if space.is_some_and(|space| space.is_in_the_way(&body)) {
            return Some(Obstacle::Fixed("points of the skeleton"));
        }
    }
    None
}
