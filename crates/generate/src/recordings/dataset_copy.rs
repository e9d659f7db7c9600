//! Copies of a nuScenes data set with other images, and with LiDAR sweeps if the rollouts have them. Files
//! that are not replaced are links to the original, or left out with the tables of all samples that were not
//! generated.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::io::{Cursor, Write};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use glam::{DAffine3, DMat4, Vec3};
use image::ImageFormat;
use image::codecs::jpeg::JpegEncoder;
use image::imageops::{self, FilterType};
use point_skeleton::dataset::nuscenes::{SubsetSample, TableSubset};
use point_skeleton::dataset::{DatasetError, Frame, ImageRecord, LogLocator, Recording, SweepRecord};
use point_skeleton::error::FileError;
use point_skeleton::files::input::{is_there, read_file};
use point_skeleton::files::{
    FileName, Inputs, LISTED_FILES, WholeFolder, is_below, is_inside, write_json, write_whole,
};
use point_skeleton::lidar::{LidarFormat, MAX_RAYS};
use pskel_sim::report::{self, ROLLOUT, STATES, STEPS, StateFile, StepRow};
use serde::Serialize;
use serde_json::json;

/// Bytes of a point in nuScenes' sweeps, and maximum size of a sweep.
const ROW_BYTES: usize = 20;
const SWEEP_BYTES: u64 = (ROW_BYTES * MAX_RAYS) as u64;
/// JPEG quality: high, so that visible artifacts are the generator's.
const QUALITY: u8 = 95;

/// File in a copy of generated samples that lists them.
pub const GENERATED_LIST: &str = "generated.json";
/// Name of their split in `splits.json`, where the development kit looks for splits by name.
const SPLIT: &str = "generated";
/// Folders of a data set without samples: HD maps, and the CAN bus that perception models read.
const SHARED: [&str; 2] = ["maps", "can_bus"];

/// Counts of replaced and unchanged images of the log's frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImageCounts {
    /// Number of replaced images.
    pub replaced: usize,
    /// Number of reference images, and of frames that were not generated.
    pub retained: usize,
    /// Number of generated images that were left out, since an earlier one is in the same file.
    pub doubled: usize,
    /// Number of replaced LiDAR sweeps.
    pub sweeps: usize,
}

/// Counts of a copy that has only generated samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SampleCounts {
    /// Number of samples.
    pub samples: usize,
    /// Number of scenes.
    pub scenes: usize,
    /// Number of generated frames that were left out, since an earlier one is in some of their files.
    pub doubled: usize,
}

/// A log of the data set, and the folder of the rollout with its generated images.
#[derive(Clone, Copy, Debug)]
pub struct CopiedLog<'a> {
    /// The log.
    pub log: &'a Recording,
    /// Folder of the rollout.
    pub rollout: &'a Path,
}

/// What replaces a file of the data set.
struct Replacement<'a> {
    /// Folder of the step.
    step: PathBuf,
    source: Source<'a>,
}

/// Source of a file.
enum Source<'a> {
    /// The generated image of a camera.
    Image(&'a FileName, &'a ImageRecord),
    /// The LiDAR sweep in the ego frame of the step, whose pose in the frame of the recorded one is given.
    Sweep(&'a SweepRecord, DAffine3),
}

/// Generated images of some logs. Of several for a file, the first one replaces it: that of the earlier clip,
/// and within a clip that of the earlier frame.
#[derive(Default)]
struct Replacements<'a> {
    by_path: BTreeMap<PathBuf, Replacement<'a>>,
    /// Tokens of the images of frames that replace all of their files.
    whole: BTreeSet<&'a str>,
    /// Number of images without a file of their own.
    doubled_images: usize,
    /// Number of frames with such images.
    doubled_frames: usize,
}

/// Content of [`GENERATED_LIST`].
#[derive(Serialize)]
struct GeneratedList<'a> {
    version: &'a str,
    samples: &'a [SubsetSample],
}

/// Copy of a data set to be written. Its folder is opened before anything is generated, and locked until it
/// is written.
#[derive(Debug)]
pub struct DatasetCopy<'a> {
    /// Names the data set and its version.
    source: &'a LogLocator,
    target: WholeFolder,
}

/// Kind of the output folder.
const KIND: &str = "dataset";

impl<'a> DatasetCopy<'a> {
    /// Opens a folder for a copy of the data set that `source` names, which may have many logs. `rollout` is
    /// a folder that the same run writes, if there is one.
    ///
    /// # Errors
    /// Fails if the folder has other files or cannot be written, if it is in the data set or contains it, if
    /// one of folder and rollout is in the other, or if the data set is not a folder.
    pub fn open(source: &'a LogLocator, folder: &Path, rollout: Option<&Path>) -> Result<Self, FileError> {
        let root = source.path.as_path();
        if !root.is_dir() {
            return Err(FileError::content("the folder of a data set to copy", "none", root));
        }
        rollout.map_or(Ok(()), |rollout| check_apart(folder, rollout))?;
        let inputs = Inputs::new([root]);
        // The copy would contain its own work folder.
        inputs.check_outside(folder)?;
        Ok(Self { source, target: WholeFolder::open(folder, KIND, &inputs)? })
    }

    /// Checks that the images of a log can be replaced.
    ///
    /// # Errors
    /// Fails if an image is not below the data set, or if its camera is unknown.
    pub fn check(&self, log: &Recording) -> Result<(), FileError> {
        for record in log.frames.iter().flat_map(|frame| &frame.images) {
            relative(&self.source.path, &record.path)?;
            camera_of(log, record, &self.source.path)?;
        }
        Ok(())
    }

    /// Writes the copy with the images from rollouts of some logs, enlarged to the original size, and with
    /// their LiDAR sweeps in nuScenes' format. A log may occur several times, with the rollouts of its clips.
    ///
    /// # Errors
    /// Fails if a rollout has no generated images at its log's frames, or if a file cannot be read or
    /// written.
    pub fn write(self, logs: &[CopiedLog<'_>]) -> Result<ImageCounts, FileError> {
        let Self { source, target } = self;
        let Replacements { by_path, doubled_images: doubled, .. } = Replacements::of(&source.path, logs)?;
        let frames = logs.iter().flat_map(|copied| &copied.log.frames);
        let images: BTreeSet<&Path> =
            frames.flat_map(|frame| &frame.images).map(|image| image.path.as_path()).collect();
        target.write(|whole| mirror(&source.path, whole, Path::new(""), &by_path))?;
        let replaced = by_path.values().filter(|new| new.token().is_some()).count();
        let (retained, sweeps) = (images.len() - replaced, by_path.len() - replaced);
        Ok(ImageCounts { replaced, retained, doubled, sweeps })
    }

    /// Writes only the samples that were generated: tables of them with new links and counts, their images,
    /// their LiDAR sweeps or links to the recorded ones, links to the maps, and [`GENERATED_LIST`]. A sample
    /// is left out and counted if an earlier one has the same file.
    ///
    /// # Errors
    /// Fails as [`DatasetCopy::write`], or if a table is missing or damaged.
    pub fn write_generated(self, logs: &[CopiedLog<'_>]) -> Result<SampleCounts, DatasetError> {
        let Self { source, target } = self;
        let root = source.path.as_path();
        let Replacements { by_path, whole, doubled_frames: doubled, .. } = Replacements::of(root, logs)?;
        let subset = TableSubset::read(source, &whole)?;
        let scenes: BTreeSet<&str> = subset.samples.iter().map(|sample| sample.scene.as_str()).collect();
        target.write(|folder| -> Result<(), FileError> {
            let is_whole = |new: &Replacement<'_>| new.token().is_some_and(|token| whole.contains(token));
            for (path, new) in by_path.iter().filter(|(_, new)| is_whole(new)) {
                new.write(&below(folder, path)?)?;
            }
            for sweep in &subset.sweeps {
                let from = root.join(sweep);
                let place = relative(root, &from)?;
                let to = below(folder, &place)?;
                by_path.get(&place).map_or_else(|| link(&from, &to), |new| new.write(&to))?;
            }
            for name in SHARED.into_iter().filter(|name| root.join(name).is_dir()) {
                link(&root.join(name), &folder.join(name))?;
            }
            let tables = folder.join(&subset.version);
            subset.write(&tables)?;
            write_json(&tables.join("splits.json"), &json!({ SPLIT: &scenes }))?;
            let list = GeneratedList { version: &subset.version, samples: &subset.samples };
            write_json(&folder.join(GENERATED_LIST), &list)
        })?;
        Ok(SampleCounts { samples: subset.samples.len(), scenes: scenes.len(), doubled })
    }
}

impl fmt::Display for ImageCounts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { replaced, retained, doubled, sweeps } = self;
        write!(f, "{replaced} images replaced, {retained} kept")?;
        if *sweeps > 0 {
            write!(f, ", {sweeps} LiDAR sweeps replaced")?;
        }
        match doubled {
            0 => Ok(()),
            _ => write!(f, ", {doubled} left out (an earlier one is in the same file)"),
        }
    }
}

impl fmt::Display for SampleCounts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { samples, scenes, doubled } = self;
        write!(f, "{samples} generated samples of {scenes} scenes, nothing else")?;
        match doubled {
            0 => Ok(()),
            _ => write!(f, ", {doubled} left out (an earlier one is in the same files)"),
        }
    }
}

impl<'a> Replacements<'a> {
    fn of(root: &Path, logs: &[CopiedLog<'a>]) -> Result<Self, FileError> {
        let mut all = Self::default();
        for copied in logs {
            for frame in copied.replacements()? {
                let before = all.doubled_images;
                let tokens: Vec<&str> = frame.iter().filter_map(Replacement::token).collect();
                for new in frame {
                    match all.by_path.entry(relative(root, new.path())?) {
                        Entry::Vacant(entry) => _ = entry.insert(new),
                        Entry::Occupied(_) => all.doubled_images += usize::from(new.token().is_some()),
                    }
                }
                match all.doubled_images == before {
                    true => all.whole.extend(tokens),
                    false => all.doubled_frames += 1,
                }
            }
        }
        Ok(all)
    }
}

/// Checks that neither a copy's folder nor a rollout's is inside the other. They need not exist.
fn check_apart(folder: &Path, rollout: &Path) -> Result<(), FileError> {
    let found = match (is_inside(folder, rollout), is_inside(rollout, folder)) {
        (false, false) => return Ok(()),
        (true, true) => "the same",
        (true, false) => "one in it",
        (false, true) => "one that contains it",
    };
    let expected = format!("a folder apart from the output {}", rollout.display());
    Err(FileError::content(expected, found, folder))
}

impl<'a> CopiedLog<'a> {
    /// Returns the generated images at frames of the log, by frame.
    fn replacements(&self) -> Result<Vec<Vec<Replacement<'a>>>, FileError> {
        let Self { log, rollout } = *self;
        let mut replaced = Vec::new();
        for row in StateFile::read(&rollout.join(STATES))? {
            let Some(frame) = log.frames.iter().find(|frame| frame.t_us == row.t_us) else { continue };
            let step = rollout.join(STEPS).join(row.name());
            if report::images::is_reference(&step)? != Some(false) {
                continue;
            }
            let images = frame.images.iter().map(|record| {
                let source = Source::Image(camera_of(log, record, &step)?, record);
                Ok(Replacement { step: step.clone(), source })
            });
            let mut files = images.collect::<Result<Vec<_>, FileError>>()?;
            if !files.is_empty() && is_there(&step.join(LidarFormat::Bin.file()))? {
                files.extend(sweeps(frame, &row, &step));
            }
            replaced.extend(Some(files).filter(|files| !files.is_empty()));
        }
        if replaced.is_empty() {
            return Err(FileError::content(
                "generated images at the log's frames",
                "none",
                &rollout.join(ROLLOUT),
            ));
        }
        Ok(replaced)
    }
}

/// Returns what replaces a frame's own LiDAR sweeps.
fn sweeps<'a>(frame: &'a Frame, row: &StepRow, step: &Path) -> Vec<Replacement<'a>> {
    let global_from_ego =
        DAffine3::from_mat4(DMat4::from_cols_array_2d(&row.ego.global_from_ego).transpose());
    let replacement = |record: &'a SweepRecord| {
        let global_from_lidar = record.global_from_ego * record.ego_from_lidar;
        let source = Source::Sweep(record, global_from_lidar.inverse().affine() * global_from_ego);
        Replacement { step: step.to_owned(), source }
    };
    frame.sweeps.iter().filter(|record| record.is_key).map(replacement).collect()
}

/// Returns the camera of an image.
fn camera_of<'a>(log: &'a Recording, record: &ImageRecord, shown: &Path) -> Result<&'a FileName, FileError> {
    let camera = log.rig.iter().find(|rig| rig.channel == record.channel);
    camera.map(|rig| &rig.camera.name).ok_or_else(|| {
        let camera = log.cameras.get(record.channel).map_or("a camera", |name| name.as_str());
        FileError::content(format!("an image of {camera}"), "none", shown)
    })
}

fn relative(root: &Path, path: &Path) -> Result<PathBuf, FileError> {
    let within = path.strip_prefix(root).ok().filter(|within| is_below(within));
    within.map(Path::to_path_buf).ok_or_else(|| {
        FileError::content(format!("an image below {}", root.display()), "another place", path)
    })
}

/// Creates a folder of links to the original, except for replaced files and their parent folders.
fn mirror(
    root: &Path,
    folder: &Path,
    below: &Path,
    replaced: &BTreeMap<PathBuf, Replacement<'_>>,
) -> Result<(), FileError> {
    let (from, to) = (root.join(below), folder.join(below));
    std::fs::create_dir_all(&to).map_err(FileError::io("create", &to))?;
    for entry in std::fs::read_dir(&from).map_err(FileError::io("read", &from))? {
        let name = entry.map_err(FileError::io("read", &from))?.file_name();
        if below == Path::new("") && name == LISTED_FILES {
            continue; // the copy has a list of its own
        }
        let place = below.join(&name);
        if let Some(replacement) = replaced.get(&place) {
            replacement.write(&to.join(&name))?;
        } else if replaced.range(place.clone()..).next().is_some_and(|(path, _)| path.starts_with(&place)) {
            mirror(root, folder, &place, replaced)?;
        } else {
            link(&from.join(&name), &to.join(&name))?;
        }
    }
    Ok(())
}

/// Creates a link to a file or folder of the data set.
fn link(from: &Path, to: &Path) -> Result<(), FileError> {
    let target = std::path::absolute(from).map_err(FileError::io("read", from))?;
    symlink(target, to).map_err(FileError::io("link", to))
}

/// Returns the place of a file in a folder, and creates the folders above it.
fn below(folder: &Path, file: &Path) -> Result<PathBuf, FileError> {
    let place = folder.join(file);
    let above = place.parent().unwrap_or(folder);
    std::fs::create_dir_all(above).map_err(FileError::io("create", above))?;
    Ok(place)
}

impl<'a> Replacement<'a> {
    /// Returns the file that is replaced.
    fn path(&self) -> &'a Path {
        match self.source {
            Source::Image(_, record) => &record.path,
            Source::Sweep(record, _) => &record.path,
        }
    }

    /// Returns the token of an image.
    fn token(&self) -> Option<&'a str> {
        match self.source {
            Source::Image(_, record) => Some(&record.token),
            Source::Sweep(..) => None,
        }
    }

    fn write(&self, path: &Path) -> Result<(), FileError> {
        match &self.source {
            Source::Image(camera, record) => self.write_image(camera, record, path),
            Source::Sweep(_, lidar_from_ego) => self.write_sweep(lidar_from_ego, path),
        }
    }

    /// Writes the points in the frame of the recorded LiDAR.
    fn write_sweep(&self, lidar_from_ego: &DAffine3, path: &Path) -> Result<(), FileError> {
        if path.extension().is_none_or(|ending| ending != "bin") {
            let expected = "LiDAR sweeps in nuScenes' format (.bin) to replace";
            return Err(FileError::content(expected, "another file", path));
        }
        let from = self.step.join(LidarFormat::Bin.file());
        let bytes = read_file(&from, SWEEP_BYTES)?;
        let rows = LidarFormat::Bin.rows(&bytes);
        let rows =
            rows.ok_or_else(|| FileError::content("the points of a sweep", "a damaged file", &from))?;
        let mut moved = rows.to_vec();
        for row in moved.chunks_exact_mut(ROW_BYTES) {
            let number = |at: usize| f32::from_le_bytes([row[at], row[at + 1], row[at + 2], row[at + 3]]);
            let position = Vec3::new(number(0), number(4), number(8)).as_dvec3();
            let position = lidar_from_ego.transform_point3(position).as_vec3().to_array();
            row[..12].copy_from_slice(position.map(f32::to_le_bytes).as_flattened());
        }
        write_whole(path, |out| out.write_all(&moved).map_err(FileError::io("write", path)))
    }

    fn write_image(&self, camera: &FileName, record: &ImageRecord, path: &Path) -> Result<(), FileError> {
        let generated = report::images::read_generated(&self.step, camera)?;
        let camera = &record.camera;
        let image = imageops::resize(&generated, camera.width, camera.height, FilterType::CatmullRom);
        let format = ImageFormat::from_path(path).unwrap_or(ImageFormat::Jpeg);
        write_whole(path, |out| {
            let written = match format {
                ImageFormat::Jpeg => image.write_with_encoder(JpegEncoder::new_with_quality(out, QUALITY)),
                other => {
                    let mut bytes = Cursor::new(Vec::new());
                    let encoded = image.write_to(&mut bytes, other);
                    encoded.and_then(|()| Ok(out.write_all(&bytes.into_inner())?))
                }
            };
            written.map_err(|error| FileError::io("write", path)(std::io::Error::other(error)))
        })
    }
}
