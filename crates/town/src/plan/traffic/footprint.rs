use glam::{DVec2, DVec3};
use point_skeleton::geometry::{Footprint, Polyline, Pose};

/// Returns the footprint of a body with its middle on a path at `along_m` meters, oriented as if axles
/// `base_m` apart were on the path, too.
pub(super) fn on_path(path: &Polyline, along_m: f64, base_m: f64, size_m: DVec2) -> Footprint {
    let [rear, front] = [-0.5, 0.5].map(|share| path.at(along_m + share * base_m).0);
    let (center, direction) = path.at(along_m);
    Footprint { center, forward: (front - rear).normalize_or(direction), half_m: size_m / 2.0 }
}

/// Returns the footprint of a body with a pose on the ground below its middle.
pub(super) fn of_pose(pose: &Pose, size_m: DVec2) -> Footprint {
    let forward = (pose.rotation * DVec3::X).truncate().normalize_or(DVec2::X);
    Footprint { center: pose.translation.truncate(), forward, half_m: size_m / 2.0 }
}
