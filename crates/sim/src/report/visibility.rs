//! Visible actors of a step, and which of them the logged images did not show.
//!
//! # How it works
//! The instance maps show which actors are visible. Visibility in the log is determined by boxes: a logged
//! image shows a track if the rectangle around its logged box, projected into the image, intersects the
//! image. Occlusion does not count, so an actor that was merely occluded is not reported as new. If a frame's
//! image is missing, as in a partly unpacked log, the camera at the frame's ego pose replaces it.

use glam::{DVec2, DVec3};
use point_skeleton::conditions::ConditionSet;
use point_skeleton::dataset::{Frame, Recording, RigCamera};
use point_skeleton::geometry::{Camera, Cuboid, Pose};
use serde::{Deserialize, Serialize};

/// Minimum number of pixels in one camera for an actor to count as visible.
pub const MIN_VISIBLE_PX: u32 = 30;
/// Maximum time difference of logged images to compare with, microseconds.
pub const AROUND_US: i64 = 500_000;
/// Near plane at which boxes are clipped, meters.
const NEAR_M: f64 = 0.1;

/// Visible part of an actor in a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct VisibleActor {
    /// Index of the camera.
    pub camera: usize,
    /// Number of visible pixels.
    pub pixels: u32,
    /// Left and top, and exclusive right and bottom, in pixels of the map.
    pub bounds: [u32; 4],
}

/// Returns, per actor of a step, the cameras whose instance maps show it; `None` if a camera has no instance
/// map.
pub fn visible_actors(set: &ConditionSet, actors: usize) -> Option<Vec<Vec<VisibleActor>>> {
    let mut all = vec![Vec::new(); actors];
    for (camera, maps) in set.cameras.iter().enumerate() {
        let none = VisibleActor { camera, pixels: 0, bounds: [u32::MAX, u32::MAX, 0, 0] };
        let mut found = vec![none; actors];
        for (row, numbers) in (0..).zip(maps.instance.as_ref()?.chunks(maps.width.max(1) as usize)) {
            for (column, number) in (0..).zip(numbers).filter(|(_, number)| **number > 0) {
                let Some(seen) = found.get_mut(*number as usize - 1) else { continue };
                let [left, top, right, bottom] = seen.bounds;
                seen.pixels += 1;
                seen.bounds = [left.min(column), top.min(row), right.max(column + 1), bottom.max(row + 1)];
            }
        }
        for (actor, seen) in all.iter_mut().zip(found).filter(|(_, seen)| seen.pixels > 0) {
            actor.push(seen);
        }
    }
    Some(all)
}

/// Returns whether a camera of the log (a channel) showed a track in its images around a time (microseconds).
pub fn was_in_logged_images(log: &Recording, track: usize, channel: usize, t_us: i64) -> bool {
    let near = |at_us: i64| at_us.abs_diff(t_us) <= AROUND_US as u64;
    // Images are up to a frame older than the frame that they belong to.
    let first = log.frames.partition_point(|f| f.t_us < t_us.saturating_sub(AROUND_US)).saturating_sub(1);
    let shown_in = |frame: &Frame| {
        let Some(cuboid) = frame.cuboid_of(track) else { return false };
        let all = frame.images.iter().chain(&frame.between_images);
        let mut images = all.filter(|image| image.channel == channel && near(image.t_us));
        images.any(|image| shows(&image.camera, &image.camera_from_global(), &cuboid))
            || near(frame.t_us)
                && missing(log, frame, channel).is_some_and(|(camera, pose)| shows(camera, &pose, &cuboid))
    };
    log.frames[first..].iter().take_while(|f| f.t_us.saturating_sub(t_us) <= 2 * AROUND_US).any(shown_in)
}

/// Returns a camera whose image is missing in a frame, with its inverse pose at the frame's ego pose.
fn missing<'a>(log: &'a Recording, frame: &Frame, channel: usize) -> Option<(&'a Camera, Pose)> {
    if frame.images.iter().any(|image| image.channel == channel) {
        return None;
    }
    let rig: &RigCamera = log.rig.iter().find(|rig| rig.channel == channel)?;
    Some((&rig.camera, (frame.global_from_ego * rig.ego_from_camera).inverse()))
}

fn shows(camera: &Camera, camera_from_global: &Pose, cuboid: &Cuboid) -> bool {
    let corners = cuboid.corners().map(|corner| camera_from_global.transform_point(corner));
    projected(camera, &corners).is_some_and(|[low, high]| {
        let size = DVec2::new(f64::from(camera.width), f64::from(camera.height));
        low.cmplt(size).all() && high.cmpgt(DVec2::ZERO).all()
    })
}

/// Returns the rectangle around the part of a box in front of a camera. The corners, in the order of
/// [`Cuboid::corners`], are in camera coordinates.
fn projected(camera: &Camera, corners: &[DVec3; 8]) -> Option<[DVec2; 2]> {
    let pixel = |p: DVec3| {
        let p = camera.intrinsics * p;
        p.truncate() / p.z
    };
    let ends = (0..8_usize).flat_map(|a| [1, 2, 4].map(|bit| [a, a ^ bit])).filter(|[a, b]| a < b);
    let mut bounds: Option<[DVec2; 2]> = None;
    for [a, b] in ends {
        let (from, to) = (corners[a], corners[b]);
        let cut =
            |p: DVec3, q: DVec3| if p.z >= NEAR_M { p } else { p.lerp(q, (NEAR_M - p.z) / (q.z - p.z)) };
        if from.z < NEAR_M && to.z < NEAR_M {
            continue;
        }
        for end in [cut(from, to), cut(to, from)].map(pixel) {
            bounds = Some(bounds.map_or([end; 2], |[low, high]| [low.min(end), high.max(end)]));
        }
    }
    bounds
}

#[cfg(test)]
mod tests {
    use glam::{DMat3, DQuat};

    use super::*;
    use point_skeleton::conditions::CameraConditions;
    use point_skeleton::dataset::{Class, ImageRecord, Track, TrackBox};

    #[test]
    fn counts_actor_pixels_per_camera() {
        let mut instance = vec![0; 24];
        (instance[6 + 2], instance[12 + 2], instance[12 + 4], instance[23]) = (2, 2, 2, 9);
        let maps =
            |instance| CameraConditions { width: 6, height: 4, instance, ..CameraConditions::default() };
        let mut set = ConditionSet { cameras: vec![maps(Some(vec![0; 24])), maps(Some(instance))] };
        let found = visible_actors(&set, 2).unwrap();
        assert_eq!(found, [vec![], vec![VisibleActor { camera: 1, pixels: 3, bounds: [2, 1, 5, 3] }]]);
        set.cameras[0] = maps(None);
        assert_eq!(visible_actors(&set, 2), None);
    }

    /// Log of a 90-degree camera at the origin that looks along x, at 0, 1 and 2 s; a 1 m box is at `at` per
    /// frame.
    fn log(at: [DVec3; 3]) -> Recording {
        let axes = DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X);
        let ego_from_camera = Pose { rotation: DQuat::from_mat3(&axes), translation: DVec3::ZERO };
        let camera =
            Camera::new("c", 100, 100, [[50.0, 0.0, 50.0], [0.0, 50.0, 50.0], [0.0, 0.0, 1.0]]).unwrap();
        let frame = |(i, at): (i64, DVec3)| {
            let t_us = i * 1_000_000;
            let pose = Pose { rotation: DQuat::IDENTITY, translation: at };
            let image = ImageRecord {
                token: "i".into(),
                channel: 0,
                path: "i".into(),
                row: None,
                t_us: t_us - 20_000,
                global_from_ego: Pose::IDENTITY,
                ego_from_camera,
                camera: camera.clone().into(),
            };
            let boxes = vec![TrackBox { track: 0, cuboid: Cuboid::new(pose, DVec3::ONE).unwrap() }];
            let (sweeps, between_images) = Default::default();
            Frame {
                t_us,
                global_from_ego: Pose::IDENTITY,
                sweeps,
                images: vec![image],
                between_images,
                boxes,
            }
        };
        let track = Track { id: "a".into(), category: "vehicle.car".into(), class: Class::MotorVehicle };
        Recording { tracks: vec![track], frames: (0..).zip(at).map(frame).collect(), ..Recording::default() }
    }

    #[test]
    fn logged_images_show_projected_actors() {
        let ahead = DVec3::new(10.0, 0.0, 0.0);
        let beside = DVec3::new(10.0, 12.0, 0.0);
        for (place, expected) in [
            (ahead, true),
            // The box's right front corner is at (10.5, 10.4), just within 45 degrees; the next one is just
            // outside.
            (DVec3::new(10.0, 10.9, 0.0), true),
            (DVec3::new(10.0, 11.1, 0.0), false),
            (DVec3::new(-10.0, 0.0, 0.0), false),
            // The box surrounds the camera.
            (DVec3::ZERO, true),
            (beside, false),
        ] {
            assert_eq!(was_in_logged_images(&log([place; 3]), 0, 0, 1_000_000), expected, "{place}");
        }
        // Only the middle image shows it, so it counts up to half a second from that image.
        let log = log([beside, ahead, beside]);
        for (t_us, expected) in [
            (0, false),
            (400_000, false),
            (480_000, true),
            (1_000_000, true),
            (1_480_000, true),
            (1_500_000, false),
        ] {
            assert_eq!(was_in_logged_images(&log, 0, 0, t_us), expected, "{t_us}");
        }
        assert!(
            !was_in_logged_images(&log, 1, 0, 1_000_000)
                && !was_in_logged_images(&Recording::default(), 0, 0, 0)
        );
        // Another camera did not show it.
        assert!(!was_in_logged_images(&log, 0, 1, 1_000_000));
    }

    #[test]
    fn rig_cameras_replace_missing_images() {
        let (ahead, beside) = (DVec3::new(10.0, 0.0, 0.0), DVec3::new(10.0, 12.0, 0.0));
        let mut log = log([beside, ahead, beside]);
        log.rig = vec![RigCamera::from(&log.frames[0].images[0])];
        // While there is an image, its own time counts; the frame is 20 ms later.
        assert!(was_in_logged_images(&log, 0, 0, 480_000) && !was_in_logged_images(&log, 0, 0, 1_490_000));
        for frame in &mut log.frames {
            frame.images.clear();
        }
        for (t_us, expected) in
            [(0, false), (499_999, false), (500_000, true), (1_500_000, true), (1_500_001, false)]
        {
            assert_eq!(was_in_logged_images(&log, 0, 0, t_us), expected, "{t_us}");
        }
        // Now the ego of that frame is turned away.
        log.frames[1].global_from_ego.rotation = DQuat::from_rotation_z(1.6);
        assert!(!was_in_logged_images(&log, 0, 0, 1_000_000));
    }
}
