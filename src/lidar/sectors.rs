//! Sectors of a sweep: each is rendered as a pinhole image from where the device is in its middle.

use std::f64::consts::FRAC_PI_2;
use std::ops::Range;

use glam::{DMat3, DQuat, DVec2, DVec3};

use super::cast::Ray;
use super::motion::Motion;
use super::spec::LidarDevice;
use crate::geometry::{Camera, CameraError, Pose, View};

/// Greatest width of a sector, radians: pixels at the edge of wider images differ from those in the middle.
const SECTOR_RAD: f64 = 0.525;
/// What a sector's image shows beyond its rays, radians: neighbors of the outermost rays, which do not begin
/// exactly at the image's center.
const MARGIN_RAD: f64 = 0.035;
/// Angle of a pixel in the middle of an image, radians. The nearest of many points in a larger pixel is
/// nearer than their surface.
const PIXEL_RAD: f64 = 0.0012;

/// A sector of a device's sweep.
#[derive(Clone, Debug)]
pub(super) struct Sector {
    /// Columns of the device.
    pub(super) columns: Range<usize>,
    /// Time of its middle after the time stamp, seconds.
    pub(super) after_s: f64,
    /// Image and pose; the world is the global frame.
    pub(super) view: View,
}

impl Sector {
    /// Divides a device's sweep into sectors of about equal width.
    ///
    /// # Errors
    /// Fails if an image of the device's angles is too large for a camera.
    pub(super) fn all(device: &LidarDevice, motion: &Motion<'_>) -> Result<Vec<Self>, CameraError> {
        let [first, end] = device.azimuth_deg;
        let count = ((end - first).abs().to_radians() / SECTOR_RAD).ceil().max(1.0) as usize;
        let count = count.min(device.columns);
        let edge = |sector: usize| sector * device.columns / count;
        (0..count).map(|sector| Self::new(device, motion, edge(sector)..edge(sector + 1))).collect()
    }

    fn new(device: &LidarDevice, motion: &Motion<'_>, columns: Range<usize>) -> Result<Self, CameraError> {
        let (first, last) = (columns.start, columns.end - 1);
        let middle = |of: &dyn Fn(usize) -> f64| f64::midpoint(of(first), of(last));
        let azimuth_rad = middle(&|column| device.azimuth_rad(column));
        let after_s = middle(&|column| device.offset_s(column));
        let half_rad = (device.azimuth_rad(last) - device.azimuth_rad(first)).abs() / 2.0;
        let camera = camera(device, half_rad)?;
        let global_from_camera =
            motion.ego(after_s) * device.ego_from_lidar() * lidar_from_camera(azimuth_rad);
        let view = View { camera, camera_from_world: global_from_camera.inverse().affine() };
        Ok(Self { columns, after_s, view })
    }

    /// Returns the rays of a column, beam by beam.
    pub(super) fn rays(&self, device: &LidarDevice, motion: &Motion<'_>, column: usize) -> Vec<Ray> {
        let global_from_lidar = motion.ego(device.offset_s(column)) * device.ego_from_lidar();
        let camera_from_world = self.view.camera_from_world;
        let origin = camera_from_world.transform_point3(global_from_lidar.translation);
        let ray = |beam| Ray {
            origin,
            direction: camera_from_world
                .transform_vector3(global_from_lidar.rotation * device.direction(beam, column)),
        };
        (0..device.elevations_deg.len()).map(ray).collect()
    }
}

/// Returns the pose of a camera that looks along an azimuth of a device.
fn lidar_from_camera(azimuth_rad: f64) -> Pose {
    let level = DQuat::from_mat3(&DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X));
    Pose { rotation: DQuat::from_rotation_z(azimuth_rad) * level, translation: DVec3::ZERO }
}

/// Returns a camera that shows all beams of the columns within an angle to both sides of its axis, radians.
fn camera(device: &LidarDevice, half_rad: f64) -> Result<Camera, CameraError> {
    let offset_deg = device.azimuth_offsets_deg.iter().fold(0.0, |most: f64, deg| most.max(deg.abs()));
    let half_rad = half_rad + offset_deg.to_radians() + MARGIN_RAD;
    let ends = device.elevations_deg.iter().fold([FRAC_PI_2, -FRAC_PI_2], |[low, high], deg| {
        [low.min(deg.to_radians()), high.max(deg.to_radians())]
    });
    let focal = 1.0 / PIXEL_RAD;
    // An elevation is farthest from the horizon at the image's edge, and nearest in its middle.
    let row = |elevation_rad: f64, outward: bool| {
        let elevation_rad = if outward { elevation_rad } else { -elevation_rad };
        let at_rad = if elevation_rad > 0.0 { half_rad } else { 0.0 };
        let tangent = elevation_rad.abs().tan() / at_rad.cos() * elevation_rad.signum() + MARGIN_RAD;
        (tangent * focal).ceil()
    };
    let (above, below) = (row(ends[1], true), row(ends[0], false));
    let beside = (half_rad.tan() * focal).ceil();
    let size = DVec2::new(2.0 * beside, above + below);
    let rows = [[focal, 0.0, beside], [0.0, focal, above], [0.0, 0.0, 1.0]];
    Camera::new("LIDAR", size.x as u32, size.y as u32, rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lidar::presets::Preset;
    use crate::scene::SceneState;

    /// Every ray, from where the device is at its time, passes through the image of its sector, at 3 m and
    /// far away, with room for its neighbors.
    #[test]
    fn rays_are_within_their_sectors() {
        let state = |t_us, x| SceneState {
            name: "0".into(),
            t_us,
            global_from_ego: Pose::from_yaw(0.3, DVec3::new(x, 0.0, 0.0)),
            cameras: Vec::new(),
            actors: Vec::new(),
            map: None,
        };
        let (now, before) = (state(100_000, 2.0), state(0, 0.0));
        let motion = Motion::new(&now, Some(&before));
        for device in Preset::ALL.into_iter().flat_map(|preset| preset.spec().devices) {
            let sectors = Sector::all(&device, &motion).unwrap();
            let columns: Vec<usize> = sectors.iter().flat_map(|sector| sector.columns.clone()).collect();
            assert_eq!(columns, (0..device.columns).collect::<Vec<_>>());
            for sector in &sectors {
                let camera = &sector.view.camera;
                let size = DVec2::new(f64::from(camera.width), f64::from(camera.height));
                for column in [sector.columns.start, sector.columns.end - 1] {
                    for ray in sector.rays(&device, &motion, column) {
                        for range_m in [3.0, 100.0] {
                            let at = camera.intrinsics * (ray.origin + ray.direction * range_m);
                            let pixel = at.truncate() / at.z;
                            let inside = pixel.min(size - pixel).min_element();
                            assert!(at.z > 0.0 && inside > 2.0, "{} {pixel} {size}", device.name);
                        }
                    }
                }
            }
        }
    }
}
