//! Messages of an instant.

use foxglove::messages::log::Level;
use foxglove::messages::{
    CameraCalibration, Color, CompressedImage, CubePrimitive, Duration, FrameTransform, FrameTransforms,
    KeyValuePair, LinePrimitive, Log, PackedElementField, Point3, PointCloud, Pose, Quaternion, SceneEntity,
    SceneEntityDeletion, SceneUpdate, Timestamp, Vector3, line_primitive, packed_element_field,
    scene_entity_deletion,
};
use glam::{DQuat, DVec3};
use point_skeleton::conditions::ImageSize;
use point_skeleton::dataset::layout_rgb;
use point_skeleton::geometry::{Camera, Cuboid};
use point_skeleton::lidar::LidarNumber;
use point_skeleton::scene::{ActorState, SceneState};

const MAP: &str = "map";
const EGO: &str = "ego";
/// Color of boxes that layout images do not have.
const OTHER_RGB: [u8; 3] = [160, 160, 160];
/// Opacity of boxes.
const BOX_ALPHA: f64 = 0.5;
/// Thickness of lines, meters.
const LINE_M: f64 = 0.2;

/// Returns an absolute time; `None` if messages cannot represent it.
pub(super) fn timestamp(t_us: i64) -> Option<Timestamp> {
    let seconds = u32::try_from(t_us.div_euclid(1_000_000)).ok()?;
    let rest_us = u32::try_from(t_us.rem_euclid(1_000_000)).ok()?;
    Timestamp::new_checked(seconds, rest_us * 1000)
}

/// Returns the name of a camera's frame: x right, y down, z forward. Topics of the camera begin with it.
pub(super) fn camera_frame(name: &str) -> String {
    format!("camera/{name}")
}

/// Returns the calibration of maps with a size: a pinhole camera. Pixel `(i, j)` covers `[i, i+1) × [j,
/// j+1)`.
pub(super) fn calibration(camera: &Camera, size: ImageSize, time: Timestamp) -> CameraCalibration {
    let [x, y, z] = camera.resized(size.height, size.width).rows();
    let extended = |[a, b, c]: [f64; 3]| [a, b, c, 0.0];
    CameraCalibration {
        timestamp: Some(time),
        frame_id: camera_frame(&camera.name),
        width: size.width,
        height: size.height,
        distortion_model: "plumb_bob".to_owned(),
        d: vec![0.0; 5],
        k: [x, y, z].concat(),
        r: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: [x, y, z].map(extended).concat(),
    }
}

/// Returns the message of an encoded image for a topic of a camera.
pub(super) fn image(topic: &str, format: &str, bytes: Vec<u8>, time: Timestamp) -> CompressedImage {
    let frame: Vec<&str> = topic.split('/').skip(1).take(2).collect();
    CompressedImage {
        timestamp: Some(time),
        frame_id: frame.join("/"),
        data: bytes.into(),
        format: format.to_owned(),
    }
}

/// Returns the poses of the ego and of its cameras. Each camera has the pose of its maps: that at the time of
/// its own image, relative to the ego at the time of the sample.
pub(super) fn transforms(state: &SceneState, origin: DVec3, time: Timestamp) -> FrameTransforms {
    let transform = |parent: &str, child: String, rotation: DQuat, translation: DVec3| FrameTransform {
        timestamp: Some(time),
        parent_frame_id: parent.to_owned(),
        child_frame_id: child,
        translation: Some(vector(translation)),
        rotation: Some(quaternion(rotation)),
    };
    let ego = state.global_from_ego;
    let ego_from_global = ego.inverse().affine();
    let cameras = state.cameras.iter().map(|camera| {
        let ego_from_camera = ego_from_global * camera.view.camera_from_world.inverse();
        let (_, rotation, translation) = ego_from_camera.to_scale_rotation_translation();
        transform(EGO, camera_frame(&camera.view.camera.name), rotation.normalize(), translation)
    });
    let ego = transform(MAP, EGO.to_owned(), ego.rotation, ego.translation - origin);
    FrameTransforms { transforms: std::iter::once(ego).chain(cameras).collect() }
}

/// Returns the boxes of actors, which replace the previous instant's. Each update is complete, so viewers may
/// start at any instant.
pub(super) fn actors(actors: &[ActorState], origin: DVec3, time: Timestamp) -> SceneUpdate {
    let all = scene_entity_deletion::Type::All;
    let deletion = SceneEntityDeletion { timestamp: Some(time), r#type: all.into(), ..Default::default() };
    let entity = |actor: &ActorState| SceneEntity {
        metadata: vec![KeyValuePair { key: "category".to_owned(), value: actor.category.clone() }],
        cubes: vec![cube(&actor.cuboid, origin, layout_rgb(&actor.category).unwrap_or(OTHER_RGB))],
        ..entity(MAP, &actor.track, time)
    };
    SceneUpdate { deletions: vec![deletion], entities: actors.iter().map(entity).collect() }
}

/// Returns the box of the ego, in its frame.
pub(super) fn ego(cuboid: &Cuboid, rgb: [u8; 3], time: Timestamp) -> SceneUpdate {
    let cubes = vec![cube(cuboid, DVec3::ZERO, rgb)];
    let entity = SceneEntity { frame_locked: true, cubes, ..entity(EGO, EGO, time) };
    SceneUpdate { deletions: Vec::new(), entities: vec![entity] }
}

/// Returns a line through global points, which replaces an earlier one of the same name.
pub(super) fn line(
    name: &str,
    points: &[DVec3],
    origin: DVec3,
    rgb: [u8; 3],
    time: Timestamp,
) -> SceneUpdate {
    let point = |point: &DVec3| {
        let DVec3 { x, y, z } = *point - origin;
        Point3 { x, y, z }
    };
    let line = LinePrimitive {
        r#type: line_primitive::Type::LineStrip.into(),
        pose: Some(Pose {
            position: Some(vector(DVec3::ZERO)),
            orientation: Some(quaternion(DQuat::IDENTITY)),
        }),
        thickness: LINE_M,
        points: points.iter().map(point).collect(),
        color: Some(color(rgb, 1.0)),
        ..Default::default()
    };
    let entity = SceneEntity { lines: vec![line], ..entity(MAP, name, time) };
    SceneUpdate { deletions: Vec::new(), entities: vec![entity] }
}

/// Returns points in the ego frame: rows of columns, one after the other.
pub(super) fn points(columns: &[(&str, LidarNumber)], rows: Vec<u8>, time: Timestamp) -> PointCloud {
    use packed_element_field::NumericType;
    let mut stride = 0;
    let field = |(name, number): &(&str, LidarNumber)| {
        let offset = stride;
        stride += number.bytes() as u32;
        let number = match number {
            LidarNumber::U8 => NumericType::Uint8,
            LidarNumber::U16 => NumericType::Uint16,
            LidarNumber::U32 => NumericType::Uint32,
            LidarNumber::F32 => NumericType::Float32,
        };
        PackedElementField { name: (*name).to_owned(), offset, r#type: number.into() }
    };
    let fields = columns.iter().map(field).collect();
    let pose = Pose { position: Some(vector(DVec3::ZERO)), orientation: Some(quaternion(DQuat::IDENTITY)) };
    PointCloud {
        timestamp: Some(time),
        frame_id: EGO.to_owned(),
        pose: Some(pose),
        point_stride: stride,
        fields,
        data: rows.into(),
    }
}

/// Returns an entity without content. It lasts until it is replaced or deleted.
fn entity(frame: &str, id: &str, time: Timestamp) -> SceneEntity {
    SceneEntity {
        timestamp: Some(time),
        frame_id: frame.to_owned(),
        id: id.to_owned(),
        lifetime: Some(Duration::new(0, 0)),
        ..Default::default()
    }
}

fn cube(Cuboid { pose, size }: &Cuboid, origin: DVec3, rgb: [u8; 3]) -> CubePrimitive {
    CubePrimitive {
        pose: Some(Pose {
            position: Some(vector(pose.translation - origin)),
            orientation: Some(quaternion(pose.rotation)),
        }),
        size: Some(vector(*size)),
        color: Some(color(rgb, BOX_ALPHA)),
    }
}

fn color(rgb: [u8; 3], a: f64) -> Color {
    let [r, g, b] = rgb.map(|part| f64::from(part) / 255.0);
    Color { r, g, b, a }
}

/// Returns the message of `/log`.
pub(super) fn text(level: Level, name: &str, message: String, time: Timestamp) -> Log {
    Log { timestamp: Some(time), level: level.into(), message, name: name.to_owned(), ..Default::default() }
}

fn vector(DVec3 { x, y, z }: DVec3) -> Vector3 {
    Vector3 { x, y, z }
}

fn quaternion(DQuat { x, y, z, w }: DQuat) -> Quaternion {
    Quaternion { x, y, z, w }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_exact_and_bounded() {
        let time = timestamp(1_533_151_603_547_590).unwrap();
        assert_eq!((time.sec(), time.nsec()), (1_533_151_603, 547_590_000));
        assert_eq!(time.total_nanos(), 1_533_151_603_547_590_000);
        let latest = i64::from(u32::MAX) * 1_000_000 + 999_999;
        assert!(timestamp(0).is_some() && timestamp(latest).is_some());
        assert!(timestamp(-1).is_none() && timestamp(latest + 1).is_none());
    }

    #[test]
    fn calibrations_match_the_map_size() {
        let rows = [[800.0, 0.0, 400.0], [0.0, 900.0, 225.0], [0.0, 0.0, 1.0]];
        let camera = Camera::new("c", 800, 450, rows).unwrap();
        let time = timestamp(0).unwrap();
        let found = calibration(&camera, ImageSize { height: 90, width: 80 }, time);
        assert_eq!(found.k, [80.0, 0.0, 40.0, 0.0, 180.0, 45.0, 0.0, 0.0, 1.0]);
        assert_eq!(found.p, [80.0, 0.0, 40.0, 0.0, 0.0, 180.0, 45.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        assert_eq!((found.width, found.height, found.frame_id.as_str()), (80, 90, "camera/c"));
        for topic in ["/camera/c/color", "/camera/c/generated/image"] {
            assert_eq!(image(topic, "png", Vec::new(), time).frame_id, found.frame_id);
        }
    }
}
