use point_skeleton::geometry::{Polyline, Pose};

/// Path of poses by arc length. Position and rotation are interpolated between poses; beyond both ends the
/// path continues straight with the end's rotation.
#[derive(Clone, Debug)]
pub(crate) struct PosePath {
    line: Polyline,
    /// One pose per point of the line.
    poses: Vec<Pose>,
}

impl PosePath {
    /// Creates a path through poses; `None` if there are fewer than two, two neighbors coincide in x and y,
    /// or one is not finite.
    pub(crate) fn new(poses: Vec<Pose>) -> Option<Self> {
        let line = Polyline::new(poses.iter().map(|pose| pose.translation.truncate()))?;
        (line.points().len() == poses.len()).then_some(Self { line, poses })
    }

    /// Returns the path in x and y.
    pub(crate) fn line(&self) -> &Polyline {
        &self.line
    }

    /// Returns the pose at a station, meters.
    pub(crate) fn at(&self, station_m: f64) -> Pose {
        let piece = self.line.piece(station_m);
        let (from_m, to_m) = (self.line.stations_m()[piece], self.line.stations_m()[piece + 1]);
        let s = ((station_m - from_m) / (to_m - from_m)).clamp(0.0, 1.0);
        let mut pose = self.poses[piece].interpolate(&self.poses[piece + 1], s);
        let (position, _) = self.line.at(station_m);
        pose.translation = position.extend(pose.translation.z);
        pose
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn interpolates_and_extrapolates_poses() {
        let pose = |x: f64, z: f64, yaw: f64| Pose::from_yaw(yaw, DVec3::new(x, 5.0, z));
        let path = PosePath::new(vec![pose(0.0, 1.0, 0.1), pose(2.0, 2.0, 0.3)]).unwrap();
        assert_eq!(path.line().length_m(), 2.0);
        let half = path.at(1.0);
        assert!((half.translation - DVec3::new(1.0, 5.0, 1.5)).length() < 1e-12);
        assert!((half.yaw_rad() - 0.2).abs() < 1e-12);
        let beyond = path.at(12.0);
        assert!((beyond.translation - DVec3::new(12.0, 5.0, 2.0)).length() < 1e-12);
        assert!((beyond.yaw_rad() - 0.3).abs() < 1e-12);
        assert!(PosePath::new(vec![pose(0.0, 1.0, 0.1), pose(0.0, 2.0, 0.1)]).is_none());
    }
}
