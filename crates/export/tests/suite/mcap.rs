//! The layout `mcap`, read back with the crate's reader and compared with the layout `frames`.

use std::collections::BTreeMap;
use std::path::Path;

use foxglove::Decode;
use foxglove::messages::{
    CameraCalibration, CompressedImage, FrameTransform, FrameTransforms, Log, Quaternion, SceneUpdate,
    Vector3,
};
use glam::{DAffine3, DMat4, DQuat, DVec3};
use mcap::{Message, MessageStream, Summary};
use point_skeleton::conditions::{ConditionOptions, ImageSize, MapKind, MapSet};
use point_skeleton::dataset::{Frame, LogLocator, LogOutline};
use point_skeleton::raster::RasterizerKind;
use pskel_export::{Export, ExportOptions, Layout, WorkList, export};
use serde_json::Value;

use crate::made_log::{CAMERAS, FORMAT, MadeLog, START};

const FRAMES: usize = 3;
const MAPS: [MapKind; 5] =
    [MapKind::Color, MapKind::Depth, MapKind::Class, MapKind::Instance, MapKind::Boxes];
/// Exports the log, two frames per shard.
fn run(folder: &Path, name: &str, layout: Layout, maps: MapSet) {
    let locator = LogLocator::new(&FORMAT, "made.up");
    let outline = LogOutline { name: "made.up".into(), frames: FRAMES };
    let list = WorkList::new([(locator, outline)], 2, None).unwrap();
    let out_size = Some(ImageSize { height: 20, width: 30 });
    let options = ExportOptions {
        layout,
        conditions: ConditionOptions { maps, out_size, ..ConditionOptions::default() },
        selection: Default::default(),
        substitutes: Default::default(),
        format: Default::default(),
        frames: None,
        shard_frames: 2,
        images: true,
        times: Default::default(),
        color_folder: String::new(),
        validation_logs: Default::default(),
        prompt: Default::default(),
        captions: Default::default(),
    };
    let report = export(Export {
        list: Some(&list),
        part: &list,
        out: &folder.join(name),
        skeletons: &folder.join("skeletons"),
        options: &options,
        open: &|_| Ok(point_skeleton::Log::new(Box::new(MadeLog::new("made.up", FRAMES)))),
        rasterizer: &RasterizerKind::Cpu.into(),
        jobs: 1,
        verify: false,
        progress: &(),
    })
    .unwrap();
    assert_eq!((report.failures.as_slice(), report.samples, report.complete), (&[][..], FRAMES, true));
}

/// Returns the messages of a topic, decoded, with their times.
fn decoded<M: Decode>(messages: &[Message<'_>], topic: &str) -> Vec<(u64, M)> {
    let of_topic = messages.iter().filter(|message| message.channel.topic == topic);
    of_topic.map(|message| (message.log_time, M::decode(&*message.data).ok().unwrap())).collect()
}

fn affine(transform: &FrameTransform) -> DAffine3 {
    let Quaternion { x, y, z, w } = transform.rotation.unwrap();
    DAffine3::from_rotation_translation(DQuat::from_xyzw(x, y, z, w), vector(transform.translation))
}

fn vector(of: Option<Vector3>) -> DVec3 {
    let Vector3 { x, y, z } = of.unwrap();
    DVec3::new(x, y, z)
}

/// Returns the 4×4 matrix in JSON.
fn matrix(rows: &Value) -> DMat4 {
    let mut all: Vec<[f64; 4]> = serde_json::from_value(rows.clone()).unwrap();
    all.resize(4, [0.0, 0.0, 0.0, 1.0]);
    DMat4::from_cols_array_2d(&[all[0], all[1], all[2], all[3]]).transpose()
}

#[test]
fn mcap_matches_the_frames_layout() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    run(folder, "frames", Layout::Frames, MapSet::of(&MAPS));
    run(folder, "mcap", Layout::Mcap, MapSet::of(&MAPS).with(MapKind::Tensor));
    run(folder, "again", Layout::Mcap, MapSet::of(&MAPS).with(MapKind::Tensor));
    let log = MadeLog::new("made.up", FRAMES).0;
    let mut images = 0;
    for (shard, frames) in [("made_up-000000", 0..2), ("made_up-000002", 2..3)] {
        let bytes = std::fs::read(folder.join(format!("mcap/{shard}.mcap"))).unwrap();
        assert!(bytes == std::fs::read(folder.join(format!("again/{shard}.mcap"))).unwrap());
        let messages: Vec<Message<'_>> = MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
        check_index(&bytes, &messages, frames.len());
        let logs: Vec<(u64, Log)> = decoded(&messages, "/log");
        assert_eq!((logs.len(), &logs[0].1.name, &logs[0].1.message), (1, &log.name, &log.description));
        let updates: Vec<(u64, SceneUpdate)> = decoded(&messages, "/actors");
        let poses: Vec<(u64, FrameTransforms)> = decoded(&messages, "/tf");
        assert_eq!((updates.len(), poses.len()), (frames.len(), frames.len()));
        for (place, index) in frames.enumerate() {
            let (frame, time) = (&log.frames[index], log.frames[index].t_us as u64 * 1000);
            assert_eq!([updates[place].0, poses[place].0], [time; 2]);
            check_actors(frame, &updates[place].1);
            let rendered = folder.join(format!("frames/made_up/{index:06}"));
            let meta = std::fs::read(rendered.join("meta.json")).unwrap();
            let meta: Value = serde_json::from_slice(&meta).unwrap();
            let transforms = &poses[place].1.transforms;
            assert_eq!(transforms.len(), 1 + CAMERAS.len());
            for (camera, name) in CAMERAS.iter().enumerate() {
                let found: Vec<(u64, CameraCalibration)> =
                    decoded(&messages, &format!("/camera/{name}/calibration"));
                check_camera(&meta["cameras"][camera], transforms, &found[place].1);
                for (kind, end) in MAPS.map(|kind| (kind.name(), "png")).iter().chain(&[("image", "jpg")]) {
                    let found: Vec<(u64, CompressedImage)> =
                        decoded(&messages, &format!("/camera/{name}/{kind}"));
                    let (at, image) = &found[place];
                    let file = std::fs::read(rendered.join(format!("{name}/{kind}.{end}"))).unwrap();
                    assert!(image.data == file, "{name}/{kind}");
                    assert_eq!((*at, &image.frame_id), (time, &format!("camera/{name}")));
                    let pixels = image::load_from_memory(&image.data).unwrap();
                    assert_eq!((pixels.height(), pixels.width()), (20, 30));
                    images += 1;
                }
            }
        }
    }
    assert_eq!(images, FRAMES * CAMERAS.len() * (MAPS.len() + 1));
}

/// Checks the numbers in the index of a file, its topics and schemas.
fn check_index(bytes: &[u8], messages: &[Message<'_>], frames: usize) {
    let summary = Summary::read(bytes).unwrap().unwrap();
    let stats = summary.stats.unwrap();
    // Maps, the image and the calibration of each camera; transforms, actors.
    let per_frame = CAMERAS.len() * (MAPS.len() + 2) + 2;
    assert_eq!((messages.len(), stats.message_count), (1 + frames * per_frame, messages.len() as u64));
    assert_eq!((summary.channels.len(), summary.metadata_indexes.len()), (per_frame + 1, 1));
    assert!(!summary.chunk_indexes.is_empty());
    let mut counts = BTreeMap::new();
    for message in messages {
        let schema = message.channel.schema.as_ref().unwrap();
        assert!(schema.name.starts_with("foxglove.") && schema.encoding == "protobuf", "{}", schema.name);
        assert_eq!(message.log_time, message.publish_time);
        let count = counts.entry(&message.channel.topic).or_insert(0);
        assert_eq!(message.sequence, *count);
        *count += 1;
    }
}

fn check_actors(frame: &Frame, update: &SceneUpdate) {
    assert_eq!((update.deletions.len(), update.entities.len()), (1, frame.boxes.len()));
    let names = [("car", "vehicle.car"), ("cone", "movable_object.trafficcone")];
    for ((entity, item), (id, category)) in update.entities.iter().zip(&frame.boxes).zip(names) {
        let (cube, pose) = (&entity.cubes[0], entity.cubes[0].pose.unwrap());
        assert_eq!((entity.id.as_str(), entity.metadata[0].value.as_str()), (id, category));
        assert_eq!((entity.frame_id.as_str(), vector(cube.size)), ("map", item.cuboid.size));
        let center = vector(pose.position) + START;
        assert!(center.distance(item.cuboid.pose.translation) < 1e-6);
    }
}

/// Checks that the frames and the calibration of a camera lead to its maps.
fn check_camera(meta: &Value, transforms: &[FrameTransform], calibration: &CameraCalibration) {
    let of = |child: &str| transforms.iter().find(|transform| transform.child_frame_id == child).unwrap();
    let (ego, camera) = (of("ego"), of(&calibration.frame_id));
    assert_eq!([ego.parent_frame_id.as_str(), camera.parent_frame_id.as_str()], ["map", "ego"]);
    let global_from_camera = DAffine3::from_translation(START) * affine(ego) * affine(camera);
    let expected = matrix(&meta["camera_from_global"]);
    let round_trip = expected * DMat4::from(global_from_camera);
    // Coordinates of 4e6 m in double precision.
    assert!(round_trip.abs_diff_eq(DMat4::IDENTITY, 1e-6), "{round_trip}");
    let intrinsics: [[f64; 3]; 3] = serde_json::from_value(meta["intrinsics"].clone()).unwrap();
    assert_eq!(calibration.k, intrinsics.concat());
    assert_eq!((calibration.width, calibration.height), (30, 20));
}
