//! `streetcrafter`: clips for [StreetCrafter](https://github.com/zju3dv/street_crafter)'s video model, as its
//! `WaymoDataset` and `PandasetDataset` read them: `SPLIT_set_processed/SCENE/images/FRAME_C.png`,
//! `../lidar/color_render/FRAME_C.png` and `.._mask.png`, and the lists `meta_info_{train,val}.json`.
//!
//! Its tools number scenes, frames and cameras, and find these numbers in the paths. Cameras are numbered in
//! the order of the log, scenes by the digits in the name of the log: numbers in the order of the logs would
//! change when a log is added, and a task with one log does not know the others. The texts of poses and
//! intrinsics are those of its converters, for programs that continue from here.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

use image::RgbImage;
use point_skeleton::Maps;
use point_skeleton::conditions::write::meta::{FrameMeta, Matrix};
use point_skeleton::conditions::write::png;
use point_skeleton::conditions::{CameraConditions, MapKind};
use point_skeleton::error::FileError;
use point_skeleton::files::{FileKind, write_json};
use rayon::prelude::*;
use serde::{Serialize, Serializer};
use serde_json::{Value, json};

use super::{images, no_clip, runs};
use crate::index::unless_busy;
use crate::layout::{ClipLists, LayoutWriter, Source};
use crate::rules::STREETCRAFTER;
use crate::samples::Sample;
use crate::shard::{Shard, ShardRecord};
use crate::{ExportError, ExportOptions, WorkList};

/// Samples between the starts of two clips.
const STRIDE: usize = 5;
/// Cameras are numbered by one digit.
const MAX_CAMERAS: usize = 10;
const LIST_KIND: FileKind =
    FileKind { name: "a list of clips", begin: b"[\n  {\n    \"frames\": [", marks: &[b"_set_processed/"] };
/// Kinds of images in the paths, with what follows the camera: recorded ones, conditions, masks.
const FRAME: [&str; 2] = ["images", ""];
const GUIDANCE: [&str; 2] = ["lidar/color_render", ""];
const MASK: [&str; 2] = ["lidar/color_render", "_mask"];

pub(in super::super) struct Scene<'a> {
    source: &'a Source<'a>,
    folder: String,
    /// Metadata of the first sample.
    first: Option<FrameMeta>,
}

/// Returns the number of a scene: the digits in the name of the log, at least three.
fn scene_number(log: &str) -> String {
    let digits: String = log.chars().filter(char::is_ascii_digit).collect();
    format!("{digits:0>3}")
}

/// Returns the folder of a split.
fn split(is_validation: bool) -> &'static str {
    if is_validation { "validation_set_processed" } else { "training_set_processed" }
}

/// Returns the path of an image in the folder of a scene.
fn path(folder: &str, [kind, end]: [&str; 2], number: usize, camera: usize) -> String {
    format!("{folder}/{kind}/{number:06}_{camera}{end}.png")
}

/// Checks the names of an export's logs.
///
/// # Errors
/// Fails if two logs have one number, or if a log of the validation split does not exist.
pub(in super::super) fn check_logs(options: &ExportOptions, list: &WorkList) -> Result<(), ExportError> {
    let mut numbers = BTreeMap::new();
    for log in &list.logs {
        if let Some(other) = numbers.insert(scene_number(&log.name), &log.name) {
            return Err(ExportError::SameScene { name: other.clone(), other: log.name.clone() });
        }
    }
    let is_unknown = |name: &&String| list.logs.iter().all(|log| log.name != **name);
    match options.validation_logs.iter().find(is_unknown) {
        Some(name) => Err(ExportError::NoLog { name: name.clone() }),
        None => Ok(()),
    }
}

/// Checks that cameras can be numbered.
///
/// # Errors
/// Fails if there are too many.
pub(in super::super) fn check(source: &point_skeleton::dataset::Recording) -> Result<(), ExportError> {
    match source.cameras.len() {
        0..=MAX_CAMERAS => Ok(()),
        count => Err(ExportError::Lacks {
            expected: "at most 10 cameras with the layout streetcrafter",
            found: count.to_string(),
            log: source.name.clone(),
        }),
    }
}

impl<'a> Scene<'a> {
    pub(in super::super) fn new(source: &'a Source<'a>) -> Self {
        let is_validation = source.options.validation_logs.contains(&source.listed.name);
        let folder = format!("{}/{}", split(is_validation), scene_number(&source.listed.name));
        Self { source, folder, first: None }
    }

    /// Returns the number of a camera.
    fn number(&self, camera: &str) -> usize {
        let cameras = &self.source.recording().cameras;
        cameras.iter().position(|name| **name == *camera).unwrap_or_default()
    }

    /// Encodes the files of a view.
    fn view(
        &self,
        number: usize,
        image: &RgbImage,
        maps: &CameraConditions,
    ) -> Result<Vec<(String, Vec<u8>)>, ExportError> {
        let path = |kind| path(&self.folder, kind, number, self.number(&maps.name));
        let recorded = image.as_raw().as_chunks::<3>().0;
        let color = maps.rgb(MapKind::Color).unwrap_or_default();
        // Depth is the color cloud's here, and points may be black.
        let mask = maps.depth_m.iter().flatten().map(|depth_m| if depth_m.is_finite() { 255 } else { 0 });
        let mask: Vec<u8> = mask.collect();
        let [frame, guidance, mask_path] = [path(FRAME), path(GUIDANCE), path(MASK)];
        Ok(vec![
            (frame.clone(), png::encode_rgb(Path::new(&frame), recorded, maps.size())?),
            (guidance.clone(), png::encode_rgb(Path::new(&guidance), color, maps.size())?),
            (mask_path.clone(), png::encode_gray(Path::new(&mask_path), &mask, maps.size())?),
        ])
    }
}

impl LayoutWriter for Scene<'_> {
    fn add(&mut self, shard: &mut Shard, sample: &Sample<'_>, maps: &Maps) -> Result<(), ExportError> {
        let images = images(shard, self.source, sample, maps)?;
        let views = images.par_iter().zip(maps.cameras());
        let views = views.filter_map(|(image, maps)| Some(self.view(sample.number, image.as_ref()?, maps)));
        let views: Vec<Vec<(String, Vec<u8>)>> = views.collect::<Result<_, ExportError>>()?;
        for (path, bytes) in views.into_iter().flatten() {
            shard.put(path, &bytes)?;
        }
        let poses = format!("{}/ego_pose/{:06}", self.folder, sample.number);
        let pose = point_skeleton::cloud::cameras::rows(&sample.state.global_from_ego.affine());
        shard.put(format!("{poses}.txt"), matrix(&pose).as_bytes())?;
        let meta = self.source.meta(maps);
        for camera in &meta.cameras {
            let text = matrix(&camera.global_from_ego);
            shard.put(format!("{poses}_{}.txt", self.number(&camera.name)), text.as_bytes())?;
        }
        self.first.get_or_insert(meta);
        Ok(())
    }

    /// Writes the calibration of the scene with its first shard.
    fn finish(self: Box<Self>, shard: &mut Shard) -> Result<(), ExportError> {
        let is_first = shard.frames().start == self.source.options.frames.map_or(0, |[first, _]| first);
        for camera in self.first.iter().filter(|_| is_first).flat_map(|meta| &meta.cameras) {
            let number = self.number(&camera.name);
            let [[fx, _, cx], [_, fy, cy], _] = camera.intrinsics;
            let lens = [fx, fy, cx, cy, 0.0, 0.0, 0.0, 0.0, 0.0]; // then k1, k2, p1, p2, k3 of a pinhole
            let text: String = lens.iter().map(|value| format!("{value:.18e}\n")).collect();
            shard.put(format!("{}/intrinsics/{number}.txt", self.folder), text.as_bytes())?;
            let Some(pose) = &camera.ego_from_camera else { continue };
            shard.put(format!("{}/extrinsics/{number}.txt", self.folder), matrix(pose).as_bytes())?;
        }
        Ok(())
    }
}

/// Returns a matrix as NumPy's `savetxt` writes it: a line per row.
fn matrix(rows: &Matrix) -> String {
    let mut text = String::new();
    for [a, b, c, d] in rows {
        let _ = writeln!(text, "{a:.18e} {b:.18e} {c:.18e} {d:.18e}");
    }
    text
}

/// Views of all scenes.
#[derive(Default)]
pub(in super::super) struct Lists {
    /// Numbers of the samples in ascending order, by folder of the scene and camera.
    views: BTreeMap<(String, usize), Vec<usize>>,
}

/// A clip of one camera. It is serialized as the paths of its images.
struct Clip<'a> {
    folder: &'a str,
    camera: usize,
    /// First sample.
    first: usize,
}

#[derive(Serialize)]
struct ClipPaths {
    frames: Vec<String>,
    guidances: Vec<String>,
    guidances_mask: Vec<String>,
}

impl Serialize for Clip<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let numbers = self.first..self.first + STREETCRAFTER.length;
        let paths = |kind| numbers.clone().map(|n| path(self.folder, kind, n, self.camera)).collect();
        let [frames, guidances, guidances_mask] = [FRAME, GUIDANCE, MASK].map(paths);
        ClipPaths { frames, guidances, guidances_mask }.serialize(serializer)
    }
}

/// Returns folder, sample and camera of a recorded image.
fn parse(path: &Path) -> Option<(&str, usize, usize)> {
    let (folder, name) = path.to_str()?.split_once("/images/")?;
    let (number, camera) = name.strip_suffix(".png")?.split_once('_')?;
    Some((folder, number.parse().ok()?, camera.parse().ok()?))
}

/// Clips of a split.
#[derive(Default)]
struct Split<'a> {
    clips: Vec<Clip<'a>>,
    views: usize,
    /// Views in clips.
    used: usize,
    /// Consecutive samples of a camera, at most.
    longest: usize,
}

impl Lists {
    fn split(&self, is_validation: bool) -> Split<'_> {
        let mut found = Split::default();
        for ((folder, camera), numbers) in &self.views {
            if !folder.starts_with(split(is_validation)) {
                continue;
            }
            found.views += numbers.len();
            for run in runs(numbers, |number| *number) {
                found.longest = found.longest.max(run.len());
                let Some(last) = run.len().checked_sub(STREETCRAFTER.length) else { continue };
                found.used += last / STRIDE * STRIDE + STREETCRAFTER.length;
                let starts = (0..=last).step_by(STRIDE);
                found.clips.extend(starts.map(|at| Clip { folder, camera: *camera, first: run[at] }));
            }
        }
        found
    }
}

impl ClipLists for Lists {
    fn add(&mut self, record: &ShardRecord) {
        for (folder, number, camera) in record.files.iter().filter_map(|file| parse(&file.path)) {
            self.views.entry((folder.to_owned(), camera)).or_default().push(number);
        }
    }

    fn write(&self, out: &Path) -> Result<Value, FileError> {
        let [training, validation] = [false, true].map(|is_validation| self.split(is_validation));
        // The trainer opens both lists: a split without logs has the clips of the other one.
        let of_training = if training.views > 0 { &training } else { &validation };
        let of_validation = if validation.views > 0 { &validation } else { &training };
        let lists = [("meta_info_train.json", of_training), ("meta_info_val.json", of_validation)];
        if let Some((_, split)) = lists.iter().find(|(_, split)| split.clips.is_empty()) {
            return Err(no_clip(&STREETCRAFTER, split.longest, out));
        }
        for (name, split) in lists {
            let path = out.join(name);
            LIST_KIND.check(&path)?;
            unless_busy(write_json(&path, &split.clips))?;
        }
        let views = training.views + validation.views;
        Ok(json!({
            "training": of_training.clips.len(), "validation": of_validation.clips.len(), "views": views,
            "views_in_no_clip": views - training.used - validation.used,
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_are_numbered_by_the_digits_of_names() {
        let found = ["scene-0061", "002", "town-7-26f-10hz-day", "a", "7"].map(scene_number);
        assert_eq!(found, ["0061", "002", "72610", "000", "007"]);
    }

    /// 25 samples from every fifth one on, as long as they are consecutive.
    #[test]
    fn clips_are_windows_of_runs() {
        let folder = format!("{}/001", split(false));
        let numbers = (0..36).chain(40..64).chain(70..95).collect();
        let lists = Lists { views: [((folder, 2), numbers)].into() };
        let Split { clips, views, used, longest } = lists.split(false);
        assert_eq!(clips.iter().map(|clip| clip.first).collect::<Vec<_>>(), [0, 5, 10, 70]);
        assert_eq!([views, used, longest], [36 + 24 + 25, 35 + 25, 36]);
        let value = serde_json::to_value(&clips[1]).unwrap();
        assert_eq!(value["frames"][0], "training_set_processed/001/images/000005_2.png");
        assert_eq!(value["guidances"][24], "training_set_processed/001/lidar/color_render/000029_2.png");
        assert_eq!(
            value["guidances_mask"][1],
            "training_set_processed/001/lidar/color_render/000006_2_mask.png"
        );
        assert_eq!(
            ["frames", "guidances", "guidances_mask"].map(|k| value[k].as_array().unwrap().len()),
            [25; 3]
        );
        assert_eq!(lists.split(true).views, 0);
    }

    #[test]
    fn both_lists_are_written() {
        let folder = tempfile::tempdir().unwrap();
        let views =
            |is_validation, count| ((format!("{}/001", split(is_validation)), 0), (0..count).collect());
        let read = |name: &str| -> Value {
            serde_json::from_slice(&std::fs::read(folder.path().join(name)).unwrap()).unwrap()
        };
        for (logs, counts) in [
            (vec![views(false, 30)], [2, 2]),
            (vec![views(true, 25)], [1, 1]),
            (vec![views(false, 35), views(true, 25)], [3, 1]),
        ] {
            let clips = Lists { views: logs.into_iter().collect() }.write(folder.path()).unwrap();
            assert_eq!([&clips["training"], &clips["validation"]], counts.map(Value::from).each_ref());
            let found =
                ["meta_info_train.json", "meta_info_val.json"].map(|f| read(f).as_array().unwrap().len());
            assert_eq!(found, counts);
        }
        for logs in [vec![], vec![views(false, 24)], vec![views(false, 30), views(true, 24)]] {
            let lists = Lists { views: logs.into_iter().collect() };
            let found = lists.views.values().map(Vec::len).min().unwrap_or(0);
            let message = lists.write(folder.path()).unwrap_err().to_string();
            assert!(message.contains(&format!("for a clip, found at most {found}: ")), "{message}");
        }
        std::fs::write(folder.path().join("meta_info_val.json"), "[]").unwrap();
        let lists = Lists { views: [views(false, 30)].into() };
        assert!(lists.write(folder.path()).unwrap_err().to_string().contains("expected a list of clips"));
    }
}
