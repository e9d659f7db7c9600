//! The layouts `streetcrafter` and `freevs`: pixels, lists, and continued exports.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use image::imageops::{FilterType, resize};
use image::{ColorType, DynamicImage, RgbImage};
use point_skeleton::conditions::{ConditionOptions, ImageSize, MapKind, MapSet};
use point_skeleton::dataset::{LogLocator, LogOutline, LogReader};
use point_skeleton::raster::RasterizerKind;
use point_skeleton::scene::{EgoOffset, SelectionOptions, Substitutes, state_of_frame};
use point_skeleton::skeleton::Skeleton;
use point_skeleton::{Log, RenderOptions, Renderer};
use pskel_export::{
    Export, ExportError, ExportOptions, ExportProgress, ExportReport, Layout, WorkList, export,
};
use serde_json::{Value, json};

use crate::made_log::{FORMAT, MadeLog};

const FRAMES: usize = 27;
const SIZE: ImageSize = ImageSize { height: 320, width: 576 };
const LOGS: [&str; 2] = ["log-001", "log-002"];
/// Folder of the first log without a validation split.
const SCENE: &str = "training_set_processed/001";

fn options(layout: Layout) -> ExportOptions {
    let size = (layout == Layout::Streetcrafter).then_some(SIZE);
    let splat = "100:3".parse().unwrap();
    ExportOptions {
        layout,
        conditions: ConditionOptions { size, splat, ..ConditionOptions::default() },
        selection: Default::default(),
        substitutes: Default::default(),
        format: Default::default(),
        frames: None,
        shard_frames: 10,
        images: false,
        times: Default::default(),
        color_folder: String::new(),
        validation_logs: Default::default(),
        prompt: Default::default(),
        captions: Default::default(),
    }
}

/// Exports logs of some frames.
fn run(
    folder: &Path,
    out: &str,
    options: &ExportOptions,
    logs: &[(&str, usize)],
    progress: &dyn ExportProgress,
) -> Result<ExportReport, ExportError> {
    let listed = |&(name, frames): &(&str, usize)| {
        (LogLocator::new(&FORMAT, format!("{name}/{frames}")), LogOutline { name: name.into(), frames })
    };
    let list = WorkList::new(logs.iter().map(listed), options.shard_frames, None).unwrap();
    export(Export {
        list: Some(&list),
        part: &list,
        out: &folder.join(out),
        skeletons: &folder.join("skeletons"),
        options,
        open: &|locator| {
            let (name, frames) = locator.path.to_str().unwrap().split_once('/').unwrap();
            Ok(Log::new(Box::new(MadeLog::new(name, frames.parse().unwrap()))))
        },
        rasterizer: &RasterizerKind::Cpu.into(),
        jobs: logs.len(),
        verify: false,
        progress,
    })
}

fn open(folder: &Path, name: &str) -> DynamicImage {
    image::open(folder.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

fn json(folder: &Path, name: &str) -> Value {
    serde_json::from_slice(&std::fs::read(folder.join(name)).unwrap()).unwrap()
}

/// Returns all numbers of a text file.
fn numbers(folder: &Path, name: &str) -> Vec<f64> {
    let text = std::fs::read_to_string(folder.join(name)).unwrap();
    text.split_whitespace().map(|number| number.parse().unwrap()).collect()
}

/// Stops after some frames.
struct StopAfter(usize, AtomicUsize);

impl ExportProgress for StopAfter {
    fn frame(&self, _: &str) {
        self.1.fetch_add(1, Ordering::Relaxed);
    }

    fn skip(&self, _: usize) {}

    fn is_stopped(&self) -> bool {
        self.1.load(Ordering::Relaxed) >= self.0
    }
}

/// Returns color and coverage of a frame: depth of the actors' own points, without templates, so that depth
/// has the points of color. With templates, as of other layouts, it has more.
fn rendered(skeleton: &Skeleton, name: &str, substitutes: &Substitutes) -> Vec<(RgbImage, Vec<u8>)> {
    let options = options(Layout::Streetcrafter);
    let maps = MapSet::of(&[MapKind::Color, MapKind::Depth]);
    let mut renderer = Renderer::new(
        skeleton,
        RenderOptions {
            conditions: ConditionOptions { maps, ..options.conditions },
            selection: SelectionOptions { min_actor_points: 0, ..SelectionOptions::default() },
            rasterizer: RasterizerKind::Cpu.into(),
            substitutes,
            log: Some(name),
            ..RenderOptions::default()
        },
    )
    .unwrap();
    let state = state_of_frame(MadeLog::new(name, FRAMES).recording(), 13, EgoOffset::default()).unwrap();
    let maps = renderer.render(&state).unwrap();
    let both = maps.cameras().iter().map(|camera| {
        let color = camera.color.as_ref().unwrap().as_flattened().to_vec();
        let mask = camera.depth_m.as_ref().unwrap().iter().map(|depth| if *depth < 1e9 { 255 } else { 0 });
        (RgbImage::from_raw(SIZE.width, SIZE.height, color).unwrap(), mask.collect())
    });
    both.collect()
}

#[test]
fn streetcrafter_images_are_those_of_the_log_and_of_the_renderer() {
    let folder = tempfile::tempdir().unwrap();
    let report =
        run(folder.path(), "out", &options(Layout::Streetcrafter), &[(LOGS[0], FRAMES)], &()).unwrap();
    assert_eq!((report.failures.as_slice(), report.samples, report.complete), (&[][..], FRAMES, true));
    let out = folder.path().join("out");
    let skeleton = Skeleton::open(&folder.path().join("skeletons").join(LOGS[0])).unwrap();
    let own = rendered(&skeleton, LOGS[0], &Substitutes::NONE);
    let with_templates = rendered(&skeleton, LOGS[0], Substitutes::built_in());
    let log = MadeLog::new(LOGS[0], FRAMES);
    let recorded = log.read_image(&log.0.frames[13].images[0]).unwrap();
    // Without a validation split, both lists have all clips.
    let clips = json(&out, "meta_info_train.json");
    assert_eq!((clips.as_array().unwrap().len(), &clips), (2, &json(&out, "meta_info_val.json")));
    let recorded = resize(&recorded, SIZE.width, SIZE.height, FilterType::Triangle);
    for (camera, (color, mask)) in own.iter().enumerate() {
        let name = format!("000013_{camera}");
        let guidance = open(&out, &format!("{SCENE}/lidar/color_render/{name}.png"));
        assert_eq!(guidance, DynamicImage::from(color.clone()), "{name}");
        let exported = open(&out, &format!("{SCENE}/lidar/color_render/{name}_mask.png"));
        assert_eq!(exported.color(), ColorType::L8);
        assert!(exported.into_luma8().into_raw() == *mask, "{name}");
        assert!(mask.contains(&0) && mask.contains(&255), "{name}");
        assert_eq!(open(&out, &format!("{SCENE}/images/{name}.png")), DynamicImage::from(recorded.clone()));
    }
    // The car has no points: a mask of the usual depth would have its template.
    assert!(with_templates[0].1 != own[0].1);
    let pose = |rows: &[f64]| glam::DMat4::from_cols_slice(rows).transpose();
    for (camera, image) in log.0.frames[13].images.iter().enumerate() {
        let ego = pose(&numbers(&out, &format!("{SCENE}/ego_pose/000013_{camera}.txt")));
        assert_eq!(ego, image.global_from_ego.affine().into());
        let extrinsics = pose(&numbers(&out, &format!("{SCENE}/extrinsics/{camera}.txt")));
        assert_eq!(extrinsics, image.ego_from_camera.affine().into());
        // 40x60 pixels become 320x576.
        let scaled = [40.0 * 9.6, 40.0 * 8.0, 30.0 * 9.6, 20.0 * 8.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        assert_eq!(numbers(&out, &format!("{SCENE}/intrinsics/{camera}.txt")), scaled);
    }
    let ego = pose(&numbers(&out, &format!("{SCENE}/ego_pose/000013.txt")));
    assert_eq!(ego, log.0.frames[13].global_from_ego.affine().into());
}

#[test]
fn lists_have_the_clips_of_all_logs() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let mut options = options(Layout::Streetcrafter);
    options.validation_logs = [LOGS[1].to_owned()].into();
    let logs = [(LOGS[0], 31), (LOGS[1], 25)];
    let report = run(folder.path(), "out", &options, &logs, &()).unwrap();
    assert_eq!((report.failures.as_slice(), report.complete), (&[][..], true));
    let clip = |scene: &str, camera: usize, first: usize| {
        let paths = |kind: &str, end: &str| -> Vec<String> {
            (first..first + 25).map(|n| format!("{scene}/{kind}/{n:06}_{camera}{end}.png")).collect()
        };
        let points = "lidar/color_render";
        json!({
            "frames": paths("images", ""), "guidances": paths(points, ""),
            "guidances_mask": paths(points, "_mask"),
        })
    };
    let training = [(0, 0), (0, 5), (1, 0), (1, 5)].map(|(camera, first)| clip(SCENE, camera, first));
    let validation = [0, 1].map(|camera| clip("validation_set_processed/002", camera, 0));
    assert_eq!(json(&out, "meta_info_train.json"), json!(training));
    assert_eq!(json(&out, "meta_info_val.json"), json!(validation));
    let paths = training.iter().chain(&validation).flat_map(|clip| clip.as_object().unwrap().values());
    for path in paths.flat_map(|list| list.as_array().unwrap()) {
        assert!(out.join(path.as_str().unwrap()).is_file(), "{path}");
    }
    let counts = json!({ "training": 4, "validation": 2, "views": 2 * (31 + 25), "views_in_no_clip": 2 });
    assert_eq!(json(&out, "index.json")["clips"], counts);
}

#[test]
fn names_and_lengths_of_logs_are_checked() {
    let folder = tempfile::tempdir().unwrap();
    let mut options = options(Layout::Streetcrafter);
    let refused = |options: &ExportOptions, logs: &[(&str, usize)]| {
        run(folder.path(), "out", options, logs, &()).unwrap_err().to_string()
    };
    let same = refused(&options, &[("a-1", 25), ("b-1", 25)]);
    assert!(same.ends_with("which number scenes, found a-1 and b-1"), "{same}");
    options.validation_logs = ["log-003".to_owned()].into();
    let unknown = refused(&options, &[(LOGS[0], 25)]);
    assert_eq!(unknown, "expected names of exported logs for the validation split, found log-003");
    assert!(!folder.path().join("out").exists());
    options.validation_logs.clear();
    let short = refused(&options, &[(LOGS[0], 3)]);
    assert!(
        short.contains("at least 25 consecutive samples of a camera for a clip, found at most 3: "),
        "{short}"
    );
    assert!(!folder.path().join("out/index.json").exists());
}

/// A rate that the key frames do not have needs `--hz`; the images of 10 Hz then serve samples of 5 Hz.
#[test]
fn freevs_takes_samples_at_a_rate() {
    let folder = tempfile::tempdir().unwrap();
    let mut options = options(Layout::Freevs);
    let report = run(folder.path(), "key", &options, &[(LOGS[0], FRAMES)], &()).unwrap();
    assert!(report.failures[0].error.contains("in log log-001, found key frames at 10.0 Hz"), "{report:?}");
    options.times = pskel_export::SampleTimes::Rate { hz: 5.0 };
    let report = run(folder.path(), "out", &options, &[(LOGS[0], FRAMES)], &()).unwrap();
    assert_eq!((report.failures.as_slice(), report.samples, report.complete), (&[][..], 14, true));
    let out = folder.path().join("out");
    for (number, camera) in [(1, "CAM_FRONT"), (2, "CAM_BACK")] {
        for sample in 0..14 {
            let image = open(
                &out,
                &format!("gt/log-001/{:04}_log-001_{}_{camera}.jpg", number + 2 * sample, 2 * sample),
            );
            assert_eq!((image.width(), image.height()), (960, 384));
        }
    }
    let counts = json!({ "sequences": 2, "views": 28, "views_in_no_clip": 0 });
    assert_eq!(json(&out, "index.json")["clips"], counts);
}

#[test]
fn a_stopped_export_is_continued_with_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    for (layout, name) in [(Layout::Streetcrafter, "street"), (Layout::Freevs, "freevs")] {
        let mut options = options(layout);
        options.shard_frames = 6;
        if layout == Layout::Freevs {
            options.times = pskel_export::SampleTimes::Rate { hz: 5.0 };
        }
        let logs = [(LOGS[0], 25)];
        run(folder.path(), name, &options, &logs, &()).unwrap();
        let stopped = format!("{name}-stopped");
        let at = StopAfter(13, AtomicUsize::new(0));
        let error = run(folder.path(), &stopped, &options, &logs, &at).unwrap_err();
        assert!(matches!(error, ExportError::Stopped), "{error}");
        let began = tree(&folder.path().join(&stopped));
        assert!(!began.contains_key("index.json") && began.keys().any(|name| name.starts_with("shards/")));
        let report = run(folder.path(), &stopped, &options, &logs, &()).unwrap();
        assert!(report.complete && report.present > 0 && report.written > 0, "{report:?}");
        assert!(tree(&folder.path().join(&stopped)) == tree(&folder.path().join(name)), "{name}");
    }
}

/// Returns all files below a folder with their bytes.
fn tree(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let (path, name) = entry.map(|e| (e.path(), e.file_name().into_string().unwrap())).unwrap();
        match path.is_dir() {
            true => files.extend(tree(&path).into_iter().map(|(f, bytes)| (format!("{name}/{f}"), bytes))),
            false => drop(files.insert(name, std::fs::read(&path).unwrap())),
        }
    }
    files
}
