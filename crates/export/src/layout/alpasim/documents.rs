//! JSON documents of a scene. Poses are in local coordinates, and times are microseconds.

use glam::{DMat4, DVec3};
use point_skeleton::dataset::Track;
use point_skeleton::geometry::{Camera, Cuboid, Pose};
use pskel_sim::{EGO_SIZE_M, REAR_AXLE_TO_CENTER_M};
use serde_json::{Map, Value, json};
use sha2::{Digest, Sha256};

use super::super::world_scenario::{Clip, category};
use super::archive::Entry;
use super::cameras::Cameras;

/// Boxes of a track with their times.
type Boxes = Vec<(i64, Cuboid)>;

/// Boxes of a track between which AlpaSim interpolates.
const MIN_BOXES: usize = 2;

/// Returns cameras with their calibrations, and the trajectory of the ego.
pub(super) fn rig_trajectories(clip: &Clip<'_>, cameras: &Cameras<'_>) -> Value {
    let (times_us, poses): (Vec<i64>, Vec<Pose>) = clip.ego_poses().into_iter().unzip();
    let calibration = |name: &str, camera: &Camera, rig_from_camera: &Pose| {
        json!({
            "logical_sensor_name": name,
            "T_sensor_rig": rows(rig_from_camera),
            "camera_model": { "type": "opencv-pinhole", "parameters": pinhole(camera) },
        })
    };
    let calibrations: Map<String, Value> = cameras
        .iter()
        .map(|(name, camera)| {
            (name.to_owned(), calibration(name, &camera.rig.camera, &camera.rig.ego_from_camera))
        })
        .collect();
    // All pixels of an image are of one instant, and AlpaSim expects that a shutter closes after it opens.
    let shutters: Map<String, Value> = cameras
        .iter()
        .map(|(name, camera)| {
            (name.to_owned(), camera.times_us.iter().map(|t_us| json!([t_us - 1, t_us])).collect())
        })
        .collect();
    let center = DVec3::new(REAR_AXLE_TO_CENTER_M, 0.0, 0.5 * EGO_SIZE_M.z);
    json!({
        // Ego and tracks have the same coordinates.
        "world_to_nre": { "matrix": rows(&Pose::IDENTITY) },
        "T_world_base": rows(&clip.clip_from_global.inverse()),
        "camera_calibrations": calibrations,
        "rig_trajectories": [{
            "sequence_id": clip.name,
            "T_rig_world_timestamps_us": times_us,
            "T_rig_worlds": poses.iter().map(rows).collect::<Vec<_>>(),
            "cameras_frame_timestamps_us": shutters,
            "rig_bbox": {
                "centroid": center.to_array(), "dim": EGO_SIZE_M.to_array(), "rot": [0.0, 0.0, 0.0]
            },
        }],
    })
}

/// Returns the actors, and the number of tracks that are left out because they have a single box.
///
/// All are `CONTROLLABLE`: AlpaSim takes others for a part of the background and does not name them to the
/// renderer. The size of a track is the median of its boxes.
pub(super) fn sequence_tracks(clip: &Clip<'_>) -> (Value, usize) {
    let mut boxes: Vec<Boxes> = vec![Vec::new(); clip.log.tracks.len()];
    for frame in clip.frames {
        for item in &frame.boxes {
            boxes[item.track].push((frame.t_us, item.cuboid));
        }
    }
    for of_track in &mut boxes {
        of_track.dedup_by_key(|(t_us, _)| *t_us);
    }
    let skipped = boxes.iter().filter(|boxes| boxes.len() == 1).count();
    let (tracks, boxes): (Vec<&Track>, Vec<Boxes>) =
        clip.log.tracks.iter().zip(boxes).filter(|(_, boxes)| boxes.len() >= MIN_BOXES).unzip();
    let pose = |pose: Pose| {
        let pose = clip.clip_from_global * pose;
        let [x, y, z] = pose.translation.to_array();
        let [qx, qy, qz, qw] = pose.rotation.to_array();
        [x, y, z, qx, qy, qz, qw]
    };
    let poses = |boxes: &Boxes| boxes.iter().map(|(_, cuboid)| json!(pose(cuboid.pose))).collect();
    let times_us = |boxes: &Boxes| boxes.iter().map(|(t_us, _)| *t_us).collect();
    let size = |boxes: &Boxes| median(boxes.iter().map(|(_, cuboid)| cuboid.size));
    let labels: Vec<&str> = tracks.iter().map(|track| category(&track.category)).collect();
    let document = json!({
        clip.name.clone(): {
            "tracks_data": {
                "tracks_id": tracks.iter().map(|track| track.id.as_str()).collect::<Vec<_>>(),
                "tracks_label_class": labels,
                "tracks_flags": vec![["CONTROLLABLE"]; tracks.len()],
                "tracks_timestamps_us": boxes.iter().map(times_us).collect::<Vec<Vec<i64>>>(),
                "tracks_poses": boxes.iter().map(poses).collect::<Vec<Value>>(),
            },
            "cuboidtracks_data": { "cuboids_dims": boxes.iter().map(size).collect::<Vec<_>>() },
        },
    });
    (document, skipped)
}

/// Returns the metadata. Hashes are those of the other files.
pub(super) fn metadata(clip: &Clip<'_>, cameras: &Cameras<'_>, entries: &[Entry]) -> Value {
    let mut hash = Sha256::new();
    for Entry { path, bytes } in entries {
        hash.update(path.as_bytes());
        hash.update([0]);
        hash.update((bytes.len() as u64).to_le_bytes());
        hash.update(bytes);
    }
    let hash: String = hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    let [first_us, last_us] = clip.times_us().map_or([0, 0], |times| [*times.start(), *times.end()]);
    let names: Vec<&str> = cameras.iter().map(|(name, _)| name).collect();
    json!({
        "scene_id": clip.name,
        "version_string": concat!("point-skeleton ", env!("CARGO_PKG_VERSION")),
        // Nothing was trained.
        "training_date": "1970-01-01",
        "dataset_hash": hash,
        "uuid": uuid(&hash),
        "is_resumable": false,
        "sensors": { "camera_ids": names, "lidar_ids": [] },
        "logger": {},
        "time_range": { "start": first_us, "end": last_us },
        "training_step_outputs": {},
    })
}

/// Returns a UUID of version 8, whose bits are free, from the start of a hash in hexadecimal digits.
fn uuid(hash: &str) -> String {
    format!("{}-{}-8{}-8{}-{}", &hash[..8], &hash[8..12], &hash[13..16], &hash[17..20], &hash[20..32])
}

/// Returns the rows of a pose as a 4×4 matrix.
fn rows(pose: &Pose) -> [[f64; 4]; 4] {
    DMat4::from(pose.affine()).transpose().to_cols_array_2d()
}

/// Returns a camera without distortion in the parameters of NCore.
fn pinhole(camera: &Camera) -> Value {
    let [[fx, _, cx], [_, fy, cy], _] = camera.rows();
    let none = |coefficients: usize| vec![0.0; coefficients];
    json!({
        "resolution": [camera.width, camera.height],
        "shutter_type": "GLOBAL",
        "principal_point": [cx, cy],
        "focal_length": [fx, fy],
        "radial_coeffs": none(6),
        "tangential_coeffs": none(2),
        "thin_prism_coeffs": none(4),
    })
}

/// Returns the median of sizes per axis; of an even number, the larger one in the middle.
fn median(sizes: impl Iterator<Item = DVec3> + Clone) -> [f64; 3] {
    std::array::from_fn(|axis| {
        let mut values: Vec<f64> = sizes.clone().map(|size| size[axis]).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or_default()
    })
}
