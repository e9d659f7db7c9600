//! Cameras of the rig that Cosmos-Transfer2.5 is trained on, and their assignment to other rigs.

use std::f64::consts::TAU;

use glam::DVec3;
use point_skeleton::dataset::RigCamera;

/// A camera of the rig: its name, and the direction of its optical axis, degrees to the left of straight
/// ahead.
struct Slot {
    name: &'static str,
    yaw_deg: f64,
}

/// In order of preference where directions are equal.
const SLOTS: [Slot; 7] = [
    Slot { name: "camera:front:wide:120fov", yaw_deg: 0.0 },
    Slot { name: "camera:cross:left:120fov", yaw_deg: 65.0 },
    Slot { name: "camera:cross:right:120fov", yaw_deg: -65.0 },
    Slot { name: "camera:rear:left:70fov", yaw_deg: 140.0 },
    Slot { name: "camera:rear:right:70fov", yaw_deg: -140.0 },
    Slot { name: "camera:rear:tele:30fov", yaw_deg: 180.0 },
    Slot { name: "camera:front:tele:30fov", yaw_deg: 0.0 },
];

/// Returns the slot name of each camera: pairs with the smallest angle between their directions come first.
/// `None` for cameras beyond seven.
pub(super) fn names(rig: &[RigCamera]) -> Vec<Option<&'static str>> {
    let yaw = |camera: &RigCamera| {
        let axis = camera.ego_from_camera.rotation * DVec3::Z;
        axis.y.atan2(axis.x)
    };
    let angle = |camera: usize, slot: usize| {
        let turn = (yaw(&rig[camera]) - SLOTS[slot].yaw_deg.to_radians()).rem_euclid(TAU);
        turn.min(TAU - turn)
    };
    let mut pairs: Vec<(usize, usize)> =
        (0..rig.len()).flat_map(|camera| (0..SLOTS.len()).map(move |slot| (camera, slot))).collect();
    // Rounded, so that numerical noise does not decide between equal angles.
    let rounded = |(camera, slot): (usize, usize)| (angle(camera, slot) * 1e6).round() as i64;
    pairs.sort_by_key(|pair| (rounded(*pair), pair.1, pair.0));
    let mut names = vec![None; rig.len()];
    let mut taken = [false; SLOTS.len()];
    for (camera, slot) in pairs {
        if names[camera].is_none() && !taken[slot] {
            names[camera] = Some(SLOTS[slot].name);
            taken[slot] = true;
        }
    }
    names
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DQuat};
    use point_skeleton::geometry::{Camera, Pose};

    fn camera(yaw_deg: f64) -> RigCamera {
        let axes = DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X);
        let rotation = DQuat::from_rotation_z(yaw_deg.to_radians()) * DQuat::from_mat3(&axes);
        let rows = [[500.0, 0.0, 400.0], [0.0, 500.0, 225.0], [0.0, 0.0, 1.0]];
        let ego_from_camera = Pose { rotation, translation: DVec3::ZERO };
        RigCamera { channel: 0, ego_from_camera, camera: Camera::new("c", 800, 450, rows).unwrap() }
    }

    /// The six cameras of nuScenes, in ring order.
    #[test]
    fn cameras_get_the_nearest_slot() {
        let rig: Vec<RigCamera> = [0.0, -56.0, -110.0, 180.0, 108.0, 55.0].map(camera).into();
        let expected = [
            "front:wide:120",
            "cross:right:120",
            "rear:right:70",
            "rear:tele:30",
            "rear:left:70",
            "cross:left:120",
        ];
        assert_eq!(
            names(&rig),
            expected.map(|name| Some(format!("camera:{name}fov"))).each_ref().map(Option::as_deref)
        );
        let many: Vec<RigCamera> = (0..9).map(|i| camera(40.0 * f64::from(i))).collect();
        assert_eq!(names(&many).iter().flatten().count(), 7);
    }
}
