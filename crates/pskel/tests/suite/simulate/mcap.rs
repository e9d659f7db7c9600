//! `pskel simulate --mcap`: the file is read back and compared with the rollout's folder.

use std::collections::BTreeMap;
use std::path::Path;

use foxglove::Decode;
use foxglove::messages::log::Level;
use foxglove::messages::{
    CameraCalibration, CompressedImage, FrameTransform, FrameTransforms, Quaternion, SceneUpdate, Vector3,
};
use glam::{DAffine3, DMat4, DQuat, DVec3};
use serde_json::{Value, json};

use super::mcap_file::McapFile;
use super::{SIMULATE, built, planner, rows};
use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{CAMERAS, START, TinyLog, assert_failed, tree};

fn vector(of: Option<Vector3>) -> DVec3 {
    let Vector3 { x, y, z } = of.unwrap();
    DVec3::new(x, y, z)
}

fn rotation(of: Option<Quaternion>) -> DQuat {
    let Quaternion { x, y, z, w } = of.unwrap();
    DQuat::from_xyzw(x, y, z, w)
}

/// Returns the rows of a 4×4 matrix in JSON.
fn matrix(rows: &Value) -> DMat4 {
    DMat4::from_cols_array_2d(&serde_json::from_value(rows.clone()).unwrap()).transpose()
}

/// Returns global meters from the coordinates of the frame `map`.
fn global(of: Option<Vector3>) -> DVec3 {
    vector(of) + START
}

/// Compares the file of a tiny log's rollout with the rollout's folder; returns the file. `maps` are PNG
/// maps.
fn check(log: &TinyLog, name: &str, folder: &str, maps: &[&str]) -> McapFile {
    let (read, rows) = (McapFile::of(log, name), rows(log, folder));
    let steps = rows.len();
    let plans = rows.iter().filter(|row| row["plan"].is_array()).count();
    let mut counts: BTreeMap<String, usize> =
        ["/tf", "/actors", "/ego"].map(|topic| (topic.to_owned(), steps)).into();
    counts.extend((plans > 0).then(|| ("/plan".to_owned(), plans)));
    counts.insert("/log".to_owned(), read.count("/log"));
    for camera in CAMERAS {
        let kinds = maps.iter().chain(&["calibration"]);
        counts.extend(kinds.map(|kind| (format!("/camera/{camera}/{kind}"), steps)));
    }
    let found: BTreeMap<String, usize> =
        read.topics.iter().map(|(topic, all)| (topic.clone(), all.len())).collect();
    assert_eq!(found, counts);
    assert_eq!(read.metadata["log"]["map_origin"], json!(START.to_array()).to_string());
    assert_eq!(read.json("metrics"), log.json(&format!("{folder}/metrics.json")));
    assert_eq!(read.json("rollout"), log.json(&format!("{folder}/rollout.json")));

    let poses: Vec<(u64, FrameTransforms)> = read.decoded("/tf");
    let (actors, egos) = (read.decoded::<SceneUpdate>("/actors"), read.decoded::<SceneUpdate>("/ego"));
    let mut lines = read.decoded::<SceneUpdate>("/plan").into_iter();
    for (step, row) in rows.iter().enumerate() {
        let time = 1000 * row["t_us"].as_u64().unwrap();
        assert_eq!([poses[step].0, actors[step].0, egos[step].0], [time; 3]);
        let meta = log.json(&format!("{folder}/steps/{step:06}/meta.json"));
        check_poses(row, &meta, &poses[step].1.transforms);
        check_actors(row, &actors[step].1);
        let ego = &egos[step].1.entities[0];
        // nuPlan's vehicle; the ego frame is at the rear axle, on the ground.
        let cube = &ego.cubes[0];
        assert_eq!((ego.frame_id.as_str(), vector(cube.size)), ("ego", DVec3::new(5.176, 2.297, 1.777)));
        assert_eq!(vector(cube.pose.unwrap().position), DVec3::new(1.461, 0.0, 1.777 / 2.0));
        if let Some(plan) = row["plan"].as_array() {
            let (at, line) = lines.next().unwrap();
            let points = &line.entities[0].lines[0].points;
            assert_eq!((at, points.len()), (time, plan.len()));
            for (point, waypoint) in points.iter().zip(plan) {
                let found = DVec3::new(point.x, point.y, point.z) + START;
                let [x, y] = ["x_m", "y_m"].map(|key| waypoint[key].as_f64().unwrap());
                assert!(found.distance(DVec3::new(x, y, 0.0)) < 1e-6, "{found}");
            }
        }
        for (camera, name) in CAMERAS.iter().enumerate() {
            let calibration =
                &read.decoded::<CameraCalibration>(&format!("/camera/{name}/calibration"))[step];
            let intrinsics: [[f64; 3]; 3] =
                serde_json::from_value(meta["cameras"][camera]["intrinsics"].clone()).unwrap();
            assert_eq!((calibration.0, &calibration.1.k), (time, &intrinsics.concat()));
            for map in maps {
                let (at, image) = &read.decoded::<CompressedImage>(&format!("/camera/{name}/{map}"))[step];
                let file = log.path(&format!("{folder}/steps/{step:06}/{name}/{map}.png"));
                assert!(image.data == std::fs::read(&file).unwrap(), "{}", file.display());
                assert_eq!((*at, image.format.as_str()), (time, "png"));
                assert_eq!(image.frame_id, format!("camera/{name}"));
            }
        }
    }
    read
}

fn check_poses(row: &Value, meta: &Value, transforms: &[FrameTransform]) {
    let affine = |transform: &FrameTransform| {
        DAffine3::from_rotation_translation(rotation(transform.rotation), vector(transform.translation))
    };
    let global_from_ego = DAffine3::from_translation(START) * affine(&transforms[0]);
    let expected = matrix(&row["ego"]["global_from_ego"]);
    assert!(expected.abs_diff_eq(DMat4::from(global_from_ego), 1e-6), "{expected}");
    assert_eq!([&transforms[0].parent_frame_id, &transforms[0].child_frame_id], ["map", "ego"]);
    assert_eq!(transforms.len(), 1 + CAMERAS.len());
    for (camera, transform) in transforms[1..].iter().enumerate() {
        let expected = matrix(&meta["cameras"][camera]["ego_from_camera"]);
        assert!(expected.abs_diff_eq(DMat4::from(affine(transform)), 1e-6), "{expected}");
        let child = format!("camera/{}", CAMERAS[camera]);
        assert_eq!([&transform.parent_frame_id, &transform.child_frame_id], ["ego", &child]);
    }
}

fn check_actors(row: &Value, update: &SceneUpdate) {
    let actors = row["actors"].as_array().unwrap();
    // Each update replaces all boxes, so a track that ends vanishes.
    assert_eq!(
        (update.deletions.len(), update.deletions[0].r#type, update.entities.len()),
        (1, 1, actors.len())
    );
    for (entity, actor) in update.entities.iter().zip(actors) {
        let (cube, pose) = (&entity.cubes[0], entity.cubes[0].pose.unwrap());
        assert_eq!(
            (json!(entity.id), json!(entity.metadata[0].value)),
            (actor["track"].clone(), actor["category"].clone())
        );
        assert_eq!(json!(vector(cube.size).to_array()), actor["size_m"]);
        let center: DVec3 = serde_json::from_value::<[f64; 3]>(actor["center_m"].clone()).unwrap().into();
        assert!(global(pose.position).distance(center) < 1e-6, "{center}");
        let heading = DQuat::from_rotation_z(actor["heading_rad"].as_f64().unwrap());
        assert!(rotation(pose.orientation).angle_between(heading) < 1e-6);
        // Cars are blue as in layouts, cones gray.
        let color = cube.color.unwrap();
        let expected = if actor["track"] == "car" { [0.0, 0.0, 1.0] } else { [160.0 / 255.0; 3] };
        assert_eq!([color.r, color.g, color.b], expected);
    }
}

#[test]
fn the_file_contains_the_whole_rollout() {
    let log = built();
    let simulate = format!("{SIMULATE} --steps 14 --ego lane_change");
    log.succeed(&simulate);
    let without = tree(&log.path("out"));
    log.succeed(&format!("{simulate} --mcap a.mcap"));
    assert!(tree(&log.path("out")) == without, "the folder is the same");
    let maps = ["boxes", "class", "color", "depth", "instance"];
    let read = check(&log, "a.mcap", "out", &maps);
    assert_eq!(read.count("/plan"), 2);
    // The log ends at step 12; its actors vanish then.
    let boxes: Vec<usize> =
        read.decoded::<SceneUpdate>("/actors").iter().map(|(_, update)| update.entities.len()).collect();
    assert_eq!(boxes, [vec![2; 13], vec![0; 2]].concat());
    let events = read.events();
    let texts: Vec<&str> = events.iter().map(|(.., text)| text.as_str()).collect();
    assert!(
        texts[0].starts_with("ego lane_change, actors replay, 12 steps and 2 plans a second"),
        "{texts:?}"
    );
    assert_eq!(texts[1..], ["the policies take over from the log", "all steps are simulated"]);
    let times = rows(&log, "out").iter().map(|row| 1000 * row["t_us"].as_u64().unwrap()).collect::<Vec<_>>();
    assert_eq!(events.iter().map(|event| event.0).collect::<Vec<_>>(), [times[0], times[7], times[14]]);
    assert!(events.iter().all(|event| event.1 == Level::Info));
    // Without a folder there are the same poses and boxes, and no images.
    log.succeed(&format!("{simulate} --dry --mcap dry.mcap"));
    let dry = McapFile::of(&log, "dry.mcap");
    let retained: BTreeMap<_, _> = read
        .topics
        .iter()
        .filter(|(topic, _)| !maps.iter().any(|map| topic.ends_with(&format!("/{map}"))))
        .map(|(topic, messages)| (topic.clone(), messages.clone()))
        .collect();
    assert!(dry.topics == retained && dry.metadata == read.metadata);
    // Maps that are no PNG files are not in the file.
    let output = log.run(&format!("{simulate} --format npz --maps color --mcap npz.mcap"));
    assert!(output.status.success());
    assert_failed(&output, 0, &["warning: the file of --mcap has no maps"]);
    check(&log, "npz.mcap", "out", &[]);
}

#[test]
fn equal_rollouts_give_equal_files() {
    let log = built();
    let simulate = |out: &str, rest: &str| {
        let policies = "--ego lane_change --tracking bicycle --actors reactive --maps color,instance";
        format!("{} {policies} {rest}", SIMULATE.replace("--out out", &format!("--out {out}")))
    };
    let bytes = |name: &str| std::fs::read(log.path(name)).unwrap();
    log.succeed(&simulate("whole", "--steps 9 --mcap whole.mcap"));
    check(&log, "whole.mcap", "whole", &["color", "instance"]);
    let whole = bytes("whole.mcap");
    let output = log.run_with(&simulate("one", "--steps 9 --mcap one.mcap"), "1");
    assert!(output.status.success() && bytes("one.mcap") == whole, "{output:?}");
    // In parts, with and without a file, and after a process that died in the middle of a line.
    log.succeed(&simulate("parts", "--steps 3 --mcap parts.mcap"));
    assert!(bytes("parts.mcap") != whole);
    log.succeed(&simulate("parts", "--steps 7 --resume"));
    let states = log.path("parts/states.jsonl");
    let mut text = std::fs::read_to_string(&states).unwrap();
    text.push_str(r#"{"step": 8, "#);
    std::fs::write(&states, text).unwrap();
    std::fs::write(log.path(".parts.mcap.pskel-part"), "a file of a killed process").unwrap();
    log.succeed(&simulate("parts", "--steps 9 --resume --mcap parts.mcap"));
    assert!(bytes("parts.mcap") == whole && !log.path(".parts.mcap.pskel-part").exists());
    // A finished rollout, and one that continues from an earlier step.
    log.succeed(&simulate("whole", "--steps 9 --resume --mcap later.mcap"));
    log.succeed(&simulate("whole", "--steps 9 --resume-from 4 --mcap from.mcap"));
    assert!(bytes("later.mcap") == whole && bytes("from.mcap") == whole);
    // A missing image is an error, and the earlier file is retained.
    std::fs::remove_file(log.path("whole/steps/000002/CAM_BACK/color.png")).unwrap();
    let output = log.run(&simulate("whole", "--steps 9 --resume --mcap later.mcap"));
    assert_failed(&output, 1, &["cannot read", "whole/steps/000002/CAM_BACK/color.png"]);
    assert!(bytes("later.mcap") == whole && !log.path(".later.mcap.pskel-part").exists());
}

#[test]
fn a_failed_rollout_writes_its_file() {
    let log = built();
    // The ego drives through the car ahead; then the planner exits.
    planner(
        &log,
        r#"read -r observation
half='{"t": 0.5, "x": 30, "y": 0, "heading": 0, "v": 60}'
one='{"t": 1, "x": 60, "y": 0, "heading": 0, "v": 60}'
echo "{\"frame\": \"ego\", \"trajectory\": [$half, $one]}"
read -r observation
exit 3"#,
    );
    let args =
        format!("{SIMULATE} --steps 20 --ego external --planner ./planner.sh --maps color --mcap a.mcap");
    assert_failed(&log.run(&args), 1, &["stopped after 13 steps, which are in out", "exit"]);
    let read = check(&log, "a.mcap", "out", &["color"]);
    let metrics = log.json("out/metrics.json");
    let collision = &metrics["collisions"][0];
    let events = read.events();
    let (time, level, source, text) = &events[2];
    assert_eq!(
        (json!(time / 1000), *level, source.as_str()),
        (collision["t_us"].clone(), Level::Error, "collision")
    );
    assert!(
        text.starts_with("collision with vehicle.car (ego ") && text.ends_with("the ego's fault"),
        "{text}"
    );
    assert_eq!(collision["at_fault"], true);
    let (_, level, source, text) = &events[3];
    assert_eq!((*level, source.as_str(), &json!(text)), (Level::Error, "rollout", &metrics["failure"]));
    assert_eq!(events.len(), 4);
}

#[test]
fn paths_are_checked_before_the_rollout() {
    let log = built();
    std::fs::create_dir(log.path("folder")).unwrap();
    std::fs::write(log.path("a.json"), r#"{"city": "Boston"}"#).unwrap();
    let folder = log.path("folder").display().to_string();
    for (rest, code, parts) in [
        ("--mcap none/a.mcap", 1, ["cannot read", ": none\n"]),
        ("--mcap a.json/a.mcap", 1, ["expected a file in a folder", ": a.json\n"]),
        ("--mcap folder", 1, ["expected a regular file or none, found a folder", ": folder\n"]),
        (&format!("--mcap {folder}"), 1, ["found a folder", &folder]),
        ("--mcap out/a.mcap", 1, ["expected a file outside of the output", "found one in it: out"]),
        ("--mcap a.json --annotations a.json", 1, ["apart from the input a.json", "found the same"]),
        ("--mcap sk/skeleton.json", 1, ["no part of another output", "skeleton"]),
        ("--mcap a.mcap --profile a.mcap", 2, ["two files for --profile and --mcap", "found a.mcap"]),
        ("--profile none/p.json", 1, ["cannot read", ": none\n"]),
    ] {
        log.fail(&format!("{SIMULATE} --steps 2 {rest}"), code, &parts);
    }
    assert!(!log.path("a.mcap").exists() && Path::new(&folder).read_dir().unwrap().next().is_none());
}

#[test]
fn generated_images_and_departures_from_the_road_are_in_the_file() {
    let log = TinyLog::new();
    let town = "town:seed=5,frames=5,size=57x100";
    log.succeed(&format!("build {town} --out sk"));
    // The path leads off the road.
    std::fs::write(log.path("left.json"), "[[0, 0], [3, 3], [6, 9], [6, 60]]").unwrap();
    let ego = "--ego file --trajectory left.json --maps color --generator fill";
    log.succeed(&format!("simulate {town} --skeleton sk --out out --steps 30 {ego} --mcap a.mcap"));
    let (read, rows) = (McapFile::of(&log, "a.mcap"), rows(&log, "out"));
    let times: Vec<u64> = rows.iter().map(|row| 1000 * row["t_us"].as_u64().unwrap()).collect();
    // Off the road: what the states of the steps count.
    let off = |step: usize| {
        log.json(&format!("out/steps/{step:06}/state.json"))["tally"]["off_road"]["instants"]
            .as_u64()
            .unwrap()
    };
    let counts: Vec<u64> = (0..rows.len()).map(off).collect();
    assert!(counts[30] > 0 && log.json("out/metrics.json")["off_road"]["instants"] == counts[30]);
    let is_off: Vec<bool> = (0..rows.len())
        .map(|step| counts[step] > step.checked_sub(1).map_or(0, |before| counts[before]))
        .collect();
    let mut was_off = false;
    let changes =
        times.iter().zip(&is_off).filter(|(_, is_off)| std::mem::replace(&mut was_off, **is_off) != **is_off);
    let changes: Vec<(u64, &str)> = changes
        .map(|(time, is_off)| {
            (
                *time,
                if *is_off {
                    "the ego leaves the drivable area"
                } else {
                    "the ego is back on the drivable area"
                },
            )
        })
        .collect();
    let events = read.events();
    let found: Vec<(u64, &str)> =
        events.iter().filter(|event| event.2 == "road").map(|event| (event.0, event.3.as_str())).collect();
    assert!(!found.is_empty());
    assert_eq!(found, changes);
    // Images of planning steps.
    let mut images = 0;
    let mut kinds = Vec::new();
    for (step, time) in times.iter().enumerate() {
        let folder = log.path(&format!("out/steps/{step:06}"));
        if !folder.join("generated.json").is_file() {
            continue;
        }
        kinds.push((*time, log.json(&format!("out/steps/{step:06}/generated.json"))["kind"].clone()));
        for name in ["generated", "truth"].into_iter().filter(|name| folder.join(name).is_dir()) {
            for entry in folder.join(name).read_dir().unwrap() {
                let path = entry.unwrap().path();
                let camera = path.file_stem().unwrap().to_str().unwrap();
                let of_time = |topic: &str| {
                    let topic = format!("/camera/{camera}/{name}/{topic}");
                    read.topics[&topic].iter().find(|message| message.0 == *time).unwrap().1.clone()
                };
                let image: CompressedImage = Decode::decode(of_time("image").as_slice()).ok().unwrap();
                assert!(image.data == std::fs::read(&path).unwrap(), "{}", path.display());
                assert_eq!(image.frame_id, format!("camera/{camera}"));
                let calibration: CameraCalibration =
                    Decode::decode(of_time("calibration").as_slice()).ok().unwrap();
                let size = image::image_dimensions(&path).unwrap();
                assert_eq!((calibration.width, calibration.height), size);
                images += 1;
            }
        }
    }
    let count = read.topics.iter().filter(|(topic, _)| topic.ends_with("/image")).map(|(_, all)| all.len());
    assert_eq!((count.sum::<usize>(), images > 100), (images, true), "{images} images");
    kinds.dedup_by(|next, before| next.1 == before.1);
    let found: Vec<(u64, bool)> = events
        .iter()
        .filter(|event| event.2 == "generator")
        .map(|event| (event.0, event.3.contains("references")))
        .collect();
    assert_eq!(found, kinds.iter().map(|(time, kind)| (*time, kind == "reference")).collect::<Vec<_>>());
}
