//! Tracks of a log in a list, from which scenarios name them.

use glam::DVec2;
use serde::Serialize;

use super::Recording;
use super::recording::median_size;
use crate::geometry::Cuboid;

/// Minimum distance between counted positions, meters: boxes of standing actors move less by noise.
const KNOT_STEP_M: f64 = 0.5;

/// Track of a log.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrackSummary {
    /// Track id.
    pub track: String,
    /// Dotted category as in nuScenes, like `vehicle.car`.
    pub category: String,
    /// Median length, width and height, meters.
    pub size_m: [f64; 3],
    /// Times of the first and last box, absolute microseconds.
    pub t_us: [i64; 2],
    /// Number of frames with a box.
    pub frames: usize,
    /// Path length of the box center, meters: steps of at least 0.5 m.
    pub path_m: f64,
}

impl TrackSummary {
    /// Summarizes the tracks of a log that have boxes, in its order: by track id.
    pub fn of(log: &Recording) -> Vec<Self> {
        let mut boxes: Vec<Vec<(i64, Cuboid)>> = vec![Vec::new(); log.tracks.len()];
        for frame in &log.frames {
            for item in &frame.boxes {
                boxes[item.track].push((frame.t_us, item.cuboid));
            }
        }
        let summary = |(track, boxes): (&super::Track, &Vec<(i64, Cuboid)>)| {
            let ends = boxes.first().zip(boxes.last())?;
            Some(Self {
                track: track.id.clone(),
                category: track.category.clone(),
                size_m: median_size(boxes.iter().map(|(_, cuboid)| cuboid.size)).to_array(),
                t_us: [ends.0.0, ends.1.0],
                frames: boxes.len(),
                path_m: path_m(boxes.iter().map(|(_, cuboid)| cuboid.pose.translation.truncate())),
            })
        };
        log.tracks.iter().zip(&boxes).filter_map(summary).collect()
    }
}

/// Returns the length of a path without steps that are shorter than the noise, meters.
fn path_m(positions: impl Iterator<Item = DVec2>) -> f64 {
    let mut last: Option<DVec2> = None;
    let mut length_m = 0.0;
    for position in positions {
        let step_m = last.map_or(f64::INFINITY, |last| last.distance(position));
        if step_m >= KNOT_STEP_M {
            length_m += last.map_or(0.0, |_| step_m);
            last = Some(position);
        }
    }
    length_m
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::dataset::{Class, Frame, Track, TrackBox};
    use crate::geometry::Pose;

    #[test]
    fn tracks_have_times_sizes_and_lengths() {
        let track =
            |id: &str| Track { id: id.into(), category: "vehicle.car".into(), class: Class::MotorVehicle };
        let cuboid = |x: f64, length: f64| {
            Cuboid::new(Pose::from_yaw(0.0, DVec3::new(x, 1.0, 0.0)), DVec3::new(length, 2.0, 1.5)).unwrap()
        };
        // "a" drives 2 m a frame from the second of four frames on; "b" trembles; "c" has no box.
        let frame = |i: usize| {
            let moving = TrackBox { track: 0, cuboid: cuboid(2.0 * i as f64, 4.0 + i as f64 / 10.0) };
            let parked = TrackBox { track: 1, cuboid: cuboid(0.2 * (i % 2) as f64, 5.0) };
            let boxes = if i == 0 { vec![parked] } else { vec![moving, parked] };
            let (sweeps, images, between_images) = Default::default();
            let (t_us, global_from_ego) = (100_000 * i as i64, Pose::IDENTITY);
            Frame { t_us, global_from_ego, sweeps, images, between_images, boxes }
        };
        let tracks = ["a", "b", "c"].map(track).to_vec();
        let log = Recording { tracks, frames: (0..4).map(frame).collect(), ..Recording::default() };
        let [moving, parked] = TrackSummary::of(&log).try_into().unwrap();
        assert_eq!((moving.track.as_str(), moving.frames, moving.t_us), ("a", 3, [100_000, 300_000]));
        assert_eq!((moving.size_m, moving.path_m), ([4.2, 2.0, 1.5], 4.0));
        assert_eq!((parked.t_us, parked.path_m), ([0, 300_000], 0.0));
    }
}
