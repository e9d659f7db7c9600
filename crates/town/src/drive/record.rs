//! Recording schedule: frames, sweeps, images, boxes.

use std::path::PathBuf;

use glam::DVec3;
use point_skeleton::dataset::{Class, Frame, ImageRecord, RigCamera, SweepRecord, Track, TrackBox};
use point_skeleton::geometry::{Cuboid, Pose};

use super::rig::{CAMERAS, ego_from_lidar};
use crate::TownOptions;
use crate::lidar::RANGE_M;
use crate::plan::{Actor, Traffic};

/// Time of frame 0, microseconds.
pub(super) const START_US: i64 = 1_600_000_000_000_000;
/// Time of traffic before frame 0, seconds: the longest LiDAR rotation, so that everything in the frame is
/// recorded in motion.
pub(super) const LEAD_S: f64 = 0.1;
/// Maximum distance of actors with a box from the ego, meters: the LiDAR's range, plus half the length of a
/// bus and its travel in a frame.
const BOX_RANGE_M: f64 = RANGE_M[1] + 15.0;

/// Returns the seconds since traffic began to move.
pub(super) fn seconds(t_us: i64) -> f64 {
    (t_us - START_US) as f64 * 1e-6 + LEAD_S
}

/// Recorder of a drive, in the global frame.
pub(super) struct Recorder<'a> {
    pub(super) options: &'a TownOptions,
    pub(super) traffic: &'a Traffic,
    pub(super) global_from_town: Pose,
    pub(super) rig: &'a [RigCamera],
}

/// Result of a recording.
pub(super) struct Recorded {
    pub(super) frames: Vec<Frame>,
    /// Tracks that have a box in any frame, sorted by id.
    pub(super) tracks: Vec<Track>,
    /// For each track, its index in the plan's actors.
    pub(super) actors: Vec<usize>,
}

impl Recorder<'_> {
    /// Records all frames and the tracks in them.
    pub(super) fn record(&self) -> Recorded {
        let mut frames: Vec<Frame> = (0..self.options.frames).map(|i| self.frame(i)).collect();
        let mut near: Vec<usize> = frames.iter().flat_map(|f| &f.boxes).map(|b| b.track).collect();
        near.sort_by_key(|i| &self.traffic.actors[*i].id);
        near.dedup();
        let mut track_of = vec![0; self.traffic.actors.len()];
        near.iter().enumerate().for_each(|(track, actor)| track_of[*actor] = track);
        for frame in &mut frames {
            frame.boxes.iter_mut().for_each(|item| item.track = track_of[item.track]);
            frame.boxes.sort_by_key(|item| item.track);
        }
        let track = |actor: &usize| {
            let Actor { id, body, .. } = &self.traffic.actors[*actor];
            let category = body.category();
            Track { id: id.clone(), category: category.to_owned(), class: Class::from_category(category) }
        };
        Recorded { frames, tracks: near.iter().map(track).collect(), actors: near }
    }

    fn global_from_ego(&self, t_us: i64) -> Pose {
        self.global_from_town * self.traffic.ego.pose(seconds(t_us))
    }

    fn time_us(&self, frame: usize) -> i64 {
        START_US + (frame as f64 * 1e6 / self.options.hz).round() as i64
    }

    /// Returns a frame; its boxes have the index of their actor in place of the track's.
    fn frame(&self, index: usize) -> Frame {
        let t_us = self.time_us(index);
        let image = |rig: &RigCamera| {
            let t_us = t_us - CAMERAS[rig.channel].before_us;
            ImageRecord {
                token: format!("{index:06}_{}", CAMERAS[rig.channel].channel),
                channel: rig.channel,
                path: file(CAMERAS[rig.channel].channel, t_us, "jpg"),
                row: None,
                t_us,
                global_from_ego: self.global_from_ego(t_us),
                ego_from_camera: rig.ego_from_camera,
                camera: rig.camera.clone().into(),
            }
        };
        Frame {
            t_us,
            global_from_ego: self.global_from_ego(t_us),
            sweeps: self.sweeps(index, t_us),
            images: self.rig.iter().map(image).collect(),
            between_images: Vec::new(),
            boxes: self.boxes(t_us),
        }
    }

    /// Returns the frame's own sweep, then those back to the previous frame, latest first.
    fn sweeps(&self, index: usize, t_us: i64) -> Vec<SweepRecord> {
        let turn_us = 1e6 / self.options.lidar_hz;
        let before_us = index.checked_sub(1).map_or(t_us - 1, |before| self.time_us(before));
        let times = (0..).map(|i: i32| t_us - (f64::from(i) * turn_us).round() as i64);
        // Skips a rotation that would begin before the previous frame's ended.
        let ended = |t_us: &i64| *t_us == self.time_us(index) || *t_us - before_us >= turn_us.floor() as i64;
        let record = |at_us: i64| SweepRecord {
            path: file("LIDAR_TOP", at_us, "pcd.bin"),
            row: None,
            t_us: at_us,
            global_from_ego: self.global_from_ego(at_us),
            ego_from_lidar: ego_from_lidar(),
            is_key: at_us == t_us,
        };
        times.take_while(ended).map(record).collect()
    }

    fn boxes(&self, t_us: i64) -> Vec<TrackBox> {
        let ego = self.traffic.ego.pose(seconds(t_us)).translation;
        let near = |(track, actor): (usize, &Actor)| {
            let pose = actor.motion.pose(seconds(t_us));
            let cuboid = cuboid(self.global_from_town * pose, actor.body.size_m());
            (pose.translation.distance(ego) < BOX_RANGE_M).then_some(TrackBox { track, cuboid })
        };
        self.traffic.actors.iter().enumerate().filter_map(near).collect()
    }
}

/// Returns the path of a generated record. No such file exists; the path only identifies the record.
fn file(channel: &str, t_us: i64, ending: &str) -> PathBuf {
    format!("{channel}/{channel}__{t_us}.{ending}").into()
}

/// Returns the box of an actor on the ground.
pub(super) fn cuboid(global_from_actor: Pose, size_m: DVec3) -> Cuboid {
    let centre = Pose { translation: DVec3::Z * (size_m.z / 2.0), ..Pose::IDENTITY };
    Cuboid { pose: global_from_actor * centre, size: size_m }
}
