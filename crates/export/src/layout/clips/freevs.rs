//! `freevs`: clips for [FreeVS](https://github.com/esdolo/FreeVS), as its `VideoNuscenesDataset` and
//! `inference_svd.py` read them: `gt/LOG/NNNN_LOG_F_CAMERA.jpg` (recorded images),
//! `waymo_pseudoimg_multiframe/LOG/LOG_F_CAMERA.jpg` (points), and the list `freevs.pkl`.
//!
//! As in its own conversion, images are the lowest 384 rows at a width of 960 pixels: the upper part of
//! Waymo's images is above the LiDAR. F counts samples of 10 Hz, so it is even; NNNN counts all images of the
//! log from 1 on.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use glam::DVec3;
use image::RgbImage;
use point_skeleton::Maps;
use point_skeleton::conditions::MapKind;
use point_skeleton::dataset::{Recording, RigCamera};
use point_skeleton::error::FileError;
use point_skeleton::files::{FileKind, write_whole};
use rayon::prelude::*;
use serde_json::{Value, json};

use super::{images, no_clip, pickle, runs};
use crate::ExportError;
use crate::files::jpeg;
use crate::index::unless_busy;
use crate::layout::{ClipLists, LayoutWriter, Source};
use crate::rules::FREEVS;
use crate::samples::Sample;
use crate::shard::{Shard, ShardRecord};

const LIST: &str = "freevs.pkl";
const LIST_KIND: FileKind =
    FileKind { name: "a list of clips", begin: pickle::BEGIN, marks: &[b"pseudo_image"] };
/// Rows of the images, pixels.
const ROWS: usize = 384;
/// Samples of 10 Hz from one sample to the next.
const STEP: usize = 2;
/// End of the keys that `--front_only` selects.
const FRONT: &str = "FRONT";

pub(in super::super) struct Segment<'a> {
    source: &'a Source<'a>,
    cameras: Vec<String>,
}

/// View in the list: its camera's sample and image are numbered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct ViewNumber {
    sample: usize,
    image: usize,
}

fn image_path(log: &str, ViewNumber { sample, image }: ViewNumber, camera: &str) -> String {
    format!("gt/{log}/{image:04}_{log}_{}_{camera}.jpg", STEP * sample)
}

fn points_path(log: &str, ViewNumber { sample, .. }: ViewNumber, camera: &str) -> String {
    format!("waymo_pseudoimg_multiframe/{log}/{log}_{}_{camera}.jpg", STEP * sample)
}

/// Returns log, numbers and camera of a recorded image.
fn parse(path: &Path) -> Option<(&str, ViewNumber, &str)> {
    let (log, name) = path.to_str()?.strip_prefix("gt/")?.split_once('/')?;
    let (image, rest) = name.strip_suffix(".jpg")?.split_once('_')?;
    let (frame, camera) = rest.strip_prefix(log)?.strip_prefix('_')?.split_once('_')?;
    let sample = frame.parse::<usize>().ok()? / STEP;
    Some((log, ViewNumber { sample, image: image.parse().ok()? }, camera))
}

/// Returns the names of the cameras in the order of the log: their own. If none ends in FRONT, the camera
/// that looks straightest ahead is called so.
fn camera_names(log: &Recording) -> Vec<String> {
    let mut names: Vec<String> = log.cameras.iter().map(ToString::to_string).collect();
    let ahead = |rig: &RigCamera| (rig.ego_from_camera.rotation * DVec3::Z).x;
    // Of equal ones the first.
    let front = log.rig.iter().rev().max_by(|a, b| ahead(a).total_cmp(&ahead(b)));
    if let Some(front) = front.filter(|_| !names.iter().any(|name| name.ends_with(FRONT))) {
        names[front.channel] = FRONT.to_owned();
    }
    names
}

/// Returns the lowest rows of an image.
fn lowest_rows(pixels: &[[u8; 3]], width: usize) -> Vec<u8> {
    pixels[pixels.len().saturating_sub(ROWS * width)..].as_flattened().to_vec()
}

impl<'a> Segment<'a> {
    pub(in super::super) fn new(source: &'a Source<'a>) -> Self {
        Self { source, cameras: camera_names(source.recording()) }
    }
}

impl LayoutWriter for Segment<'_> {
    fn add(&mut self, shard: &mut Shard, sample: &Sample<'_>, maps: &Maps) -> Result<(), ExportError> {
        let images = images(shard, self.source, sample, maps)?;
        let (log, names) = (&self.source.listed.name, &self.source.recording().cameras);
        let views = images.par_iter().zip(maps.cameras()).filter_map(|(image, maps)| {
            let camera = names.iter().position(|name| *name == maps.name)?;
            Some((image.as_ref()?, maps, camera))
        });
        let encode = |(path, pixels, width): (String, &[[u8; 3]], usize)| -> Result<_, ExportError> {
            let rows = RgbImage::from_raw(width as u32, ROWS as u32, lowest_rows(pixels, width));
            let bytes = jpeg(Path::new(&path), &rows.unwrap_or_default())?;
            Ok((path, bytes))
        };
        let both = views.map(|(image, maps, camera)| {
            let number =
                ViewNumber { sample: sample.number, image: 1 + sample.number * names.len() + camera };
            let (name, width) = (&self.cameras[camera], maps.width as usize);
            let recorded = image.as_raw().as_chunks::<3>().0;
            let points = maps.rgb(MapKind::Color).unwrap_or_default();
            Ok([
                encode((image_path(log, number, name), recorded, width))?,
                encode((points_path(log, number, name), points, width))?,
            ])
        });
        let both: Vec<[(String, Vec<u8>); 2]> = both.collect::<Result<_, ExportError>>()?;
        for (path, bytes) in both.into_iter().flatten() {
            shard.put(path, &bytes)?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>, _: &mut Shard) -> Result<(), ExportError> {
        Ok(())
    }
}

/// Views of all logs.
#[derive(Default)]
pub(in super::super) struct Lists {
    /// In order of time, by log and camera.
    views: BTreeMap<(String, String), Vec<ViewNumber>>,
}

/// Consecutive views of a camera, the unit from which the loader takes its clips.
struct Sequence<'a> {
    log: &'a str,
    camera: &'a str,
    views: &'a [ViewNumber],
    /// Whether these are the camera's first views.
    is_first: bool,
}

impl Sequence<'_> {
    /// Returns the key in the list; sequences after a gap have the number of their first frame in it.
    fn key(&self) -> String {
        match self.views.first().filter(|_| !self.is_first) {
            Some(view) => format!("{}_{}_{}", self.log, STEP * view.sample, self.camera),
            None => format!("{}_{}", self.log, self.camera),
        }
    }

    fn write(&self, out: &mut impl Write) -> std::io::Result<()> {
        pickle::list(out, self.views, |out, view| {
            let points = points_path(self.log, *view, self.camera);
            let items = [
                ("image", &image_path(self.log, *view, self.camera)),
                ("pseudo_image", &points),
                // Points of other times, for augmentation. FreeVS's own script lists the same file, too.
                ("pseudo_image_minusframe", &points),
                ("pseudo_image_plusframe", &points),
            ];
            pickle::dict(out, items, |out, path| pickle::text(out, path))
        })
    }
}

impl Lists {
    fn sequences(&self) -> impl Iterator<Item = Sequence<'_>> {
        self.views.iter().flat_map(|((log, camera), views)| {
            let sequence = move |(index, views)| Sequence { log, camera, views, is_first: index == 0 };
            runs(views, |view| view.sample).enumerate().map(sequence)
        })
    }
}

impl ClipLists for Lists {
    fn add(&mut self, record: &ShardRecord) {
        let mut views: Vec<_> = record.files.iter().filter_map(|file| parse(&file.path)).collect();
        views.sort_by_key(|(_, number, _)| number.image); // files are in the order of their names
        for (log, number, camera) in views {
            self.views.entry((log.to_owned(), camera.to_owned())).or_default().push(number);
        }
    }

    fn write(&self, out: &Path) -> Result<Value, FileError> {
        let (long, short): (Vec<_>, Vec<_>) =
            self.sequences().partition(|sequence| sequence.views.len() >= FREEVS.length);
        let lengths = short.iter().map(|sequence| sequence.views.len());
        if long.is_empty() {
            return Err(no_clip(&FREEVS, lengths.max().unwrap_or_default(), out));
        }
        let path = out.join(LIST);
        LIST_KIND.check(&path)?;
        unless_busy(write_whole(&path, |file| {
            let items = long.iter().map(|sequence| (sequence.key(), sequence));
            let written = pickle::whole(file, |file| pickle::dict(file, items, |file, s| s.write(file)));
            written.map_err(FileError::io("write", &path))
        }))?;
        let unused: usize = lengths.sum();
        Ok(json!({
            "sequences": long.len(), "views": self.views.values().map(Vec::len).sum::<usize>(),
            "views_in_no_clip": unused,
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_parsed_as_written() {
        for (log, camera) in [("scene-0061", "CAM_FRONT"), ("1_2_3", "FRONT"), ("a_b", "c_2_d")] {
            for image in [7, 12_345] {
                let number = ViewNumber { sample: 21, image };
                assert_eq!(parse(Path::new(&image_path(log, number, camera))), Some((log, number, camera)));
            }
        }
        let number = ViewNumber { sample: 3, image: 19 };
        assert_eq!(image_path("s", number, "FRONT"), "gt/s/0019_s_6_FRONT.jpg");
        assert_eq!(points_path("s", number, "FRONT"), "waymo_pseudoimg_multiframe/s/s_6_FRONT.jpg");
        assert_eq!(parse(Path::new("waymo_pseudoimg_multiframe/s/s_6_FRONT.jpg")), None);
    }

    #[test]
    fn gaps_divide_sequences() {
        let view = |sample| ViewNumber { sample, image: sample + 1 };
        let views = |numbers: &[usize]| numbers.iter().map(|n| view(*n)).collect::<Vec<_>>();
        let numbers: Vec<usize> = (0..7).chain(10..15).chain(20..26).collect();
        let lists = Lists { views: [(("s".to_owned(), "FRONT".to_owned()), views(&numbers))].into() };
        let found: Vec<_> =
            lists.sequences().map(|sequence| (sequence.key(), sequence.views.len())).collect();
        assert_eq!(found, [("s_FRONT".into(), 7), ("s_20_FRONT".into(), 5), ("s_40_FRONT".into(), 6)]);
        let folder = tempfile::tempdir().unwrap();
        let clips = lists.write(folder.path()).unwrap();
        assert_eq!(clips, json!({ "sequences": 2, "views": 18, "views_in_no_clip": 5 }));
        let again = lists.write(folder.path());
        assert!(again.is_ok(), "a list of before is replaced");
        let short = Lists { views: [(("s".to_owned(), "FRONT".to_owned()), views(&[0, 1, 2, 3, 4]))].into() };
        let message = short.write(folder.path()).unwrap_err().to_string();
        assert!(message.contains("at least 6 consecutive samples"), "{message}");
        assert!(message.contains("found at most 5: "), "{message}");
    }

    #[test]
    fn the_lowest_rows_are_taken() {
        let pixels: Vec<[u8; 3]> = (0..ROWS + 2).map(|row| [(row % 251) as u8, 0, 0]).collect();
        let rows = lowest_rows(&pixels, 1);
        assert_eq!((rows.len(), &rows[..3], rows[rows.len() - 3]), (3 * ROWS, &[2, 0, 0][..], 134));
    }
}
