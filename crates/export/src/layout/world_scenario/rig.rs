//! `rig_json`: cameras in the f-theta model of DriveWorks, which maps the distance of a pixel from the
//! principal point to the angle of its ray.

use glam::{DMat3, DQuat, DVec3, EulerRot};
use point_skeleton::dataset::RigCamera;
use point_skeleton::geometry::Camera;
use serde_json::{Value, json};

/// Coefficients of the polynomial, from the constant.
const COEFFICIENTS: usize = 6;

/// Returns the rig of cameras with names.
pub(super) fn rig(cameras: &[(&str, &RigCamera)]) -> Value {
    let sensors: Vec<Value> = cameras.iter().map(|(name, camera)| sensor(name, camera)).collect();
    json!({ "rig": { "properties": {}, "sensors": sensors, "vehicle": {}, "version": 2 } })
}

fn sensor(name: &str, rig: &RigCamera) -> Value {
    let Camera { width, height, intrinsics, .. } = rig.camera;
    let [fx, fy] = [intrinsics.x_axis.x, intrinsics.y_axis.y];
    let polynomial = polynomial(fy, farthest_px(&rig.camera)).map(|c| c.to_string()).join(" ");
    let degrees = roll_pitch_yaw(rig.ego_from_camera.rotation).map(f64::to_degrees);
    let none = json!({ "roll-pitch-yaw": [0.0, 0.0, 0.0] });
    json!({
        "name": name,
        "properties": {
            "Model": "ftheta", "cx": intrinsics.z_axis.x.to_string(), "cy": intrinsics.z_axis.y.to_string(),
            "width": width.to_string(), "height": height.to_string(), "polynomial": polynomial,
            "polynomial-type": "pixeldistance-to-angle",
            // Pixels are wider than high by this factor.
            "linear-c": (fx / fy).to_string(), "linear-d": "0", "linear-e": "0",
        },
        "nominalSensor2Rig_FLU": { "t": rig.ego_from_camera.translation.to_array(),
        "roll-pitch-yaw": degrees },
        "correction_sensor_R_FLU": none, "correction_rig_T": [0.0, 0.0, 0.0],
    })
}

/// Returns the largest distance of a pixel from the principal point.
fn farthest_px(camera: &Camera) -> f64 {
    let [cx, cy] = [camera.intrinsics.z_axis.x, camera.intrinsics.z_axis.y];
    let side = |center: f64, length: u32| center.abs().max((f64::from(length) - center).abs());
    side(cx, camera.width).hypot(side(cy, camera.height))
}

/// Returns `k` with `k[0] + k[1] r + .. = atan(r / f)` for pixel distances up to `far_px`: `atan(r / f) / r`,
/// interpolated in nodes that are denser far from the center than Chebyshev's, since an error of the angle is
/// `1 + (r / f)²` times as large in pixels.
pub(super) fn polynomial(focal_px: f64, far_px: f64) -> [f64; COEFFICIENTS] {
    const NODES: usize = COEFFICIENTS - 1;
    /// By trial: errors of the cameras in the test are 0.02, 0.05 and 0.68 px; the best polynomials have
    /// 0.01, 0.03 and 0.53.
    const DENSITY: f64 = 0.57;
    let node = |i: usize| {
        let angle = std::f64::consts::PI * (2 * i + 1) as f64 / (2 * NODES) as f64;
        (0.5 * (1.0 + angle.cos())).powf(DENSITY)
    };
    let nodes: [f64; NODES] = std::array::from_fn(node);
    // Newton's divided differences, in units of the largest distance.
    let mut differences = nodes.map(|s| (s * far_px / focal_px).atan() / s);
    for order in 1..NODES {
        for i in (order..NODES).rev() {
            differences[i] = (differences[i] - differences[i - 1]) / (nodes[i] - nodes[i - order]);
        }
    }
    // From the Newton form to powers.
    let mut powers = [0.0; NODES];
    for i in (0..NODES).rev() {
        for power in (1..NODES).rev() {
            powers[power] = powers[power - 1] - nodes[i] * powers[power];
        }
        powers[0] = differences[i] - nodes[i] * powers[0];
    }
    let mut all = [0.0; COEFFICIENTS];
    for (power, value) in powers.iter().enumerate() {
        all[power + 1] = value / far_px.powi(power as i32 + 1);
    }
    all
}

/// Returns the rotation of a camera in the convention forward, left, up: `Rz(yaw) Ry(pitch) Rx(roll)`.
fn roll_pitch_yaw(ego_from_camera: DQuat) -> [f64; 3] {
    // The camera's axes are right, down, forward.
    let camera_from_flu = DMat3::from_cols(DVec3::Z, DVec3::NEG_X, DVec3::NEG_Y);
    let (yaw, pitch, roll) = (ego_from_camera * DQuat::from_mat3(&camera_from_flu)).to_euler(EulerRot::ZYX);
    [roll, pitch, yaw]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The cameras of nuScenes and one of 120 degrees.
    #[test]
    fn polynomial_approximates_a_pinhole() {
        for (focal, far, bound_px) in [(1266.4, 930.0, 0.03), (809.2, 940.0, 0.06), (554.0, 1100.0, 0.7)] {
            let k = polynomial(focal, far);
            for i in 0..=1000 {
                let r = far * f64::from(i) / 1000.0;
                let angle = k.iter().rev().fold(0.0, |sum, k| sum * r + k);
                let error_px = (focal * angle.tan() - r).abs();
                assert!(error_px < bound_px, "{error_px} px at {r} of {focal}");
            }
        }
    }

    #[test]
    fn yaw_is_positive_to_the_left() {
        let axes = DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X);
        let rotation = DQuat::from_rotation_z(1.2) * DQuat::from_rotation_y(0.1) * DQuat::from_mat3(&axes);
        let [roll, pitch, yaw] = roll_pitch_yaw(rotation);
        assert!(roll.abs() < 1e-12 && (pitch - 0.1).abs() < 1e-12 && (yaw - 1.2).abs() < 1e-12);
    }
}
