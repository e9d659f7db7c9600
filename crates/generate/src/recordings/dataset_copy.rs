//! Copies of a nuScenes data set with other images: files that are not replaced are links to the original.

use std::collections::BTreeMap;
use std::io::{Cursor, Write};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use image::ImageFormat;
use image::codecs::jpeg::JpegEncoder;
use image::imageops::{self, FilterType};
use point_skeleton::dataset::{ImageRecord, Recording};
use point_skeleton::error::FileError;
use point_skeleton::files::{FileName, Inputs, LISTED_FILES, WholeFolder, is_below, is_inside, write_whole};
use pskel_sim::report::{self, ROLLOUT, STATES, STEPS, StateFile};

/// JPEG quality: high, so that visible artifacts are the generator's.
const QUALITY: u8 = 95;

/// Counts of replaced and unchanged images of the log's frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImageCounts {
    /// Number of replaced images.
    pub replaced: usize,
    /// Number of reference images, and of frames that were not generated.
    pub retained: usize,
}

/// A log of the data set, and the folder of the rollout with its generated images.
#[derive(Clone, Copy, Debug)]
pub struct CopiedLog<'a> {
    /// The log.
    pub log: &'a Recording,
    /// Folder of the rollout.
    pub rollout: &'a Path,
}

/// Generated image that replaces a file of the data set.
struct Replacement<'a> {
    /// Folder of the step.
    step: PathBuf,
    camera: &'a FileName,
    record: &'a ImageRecord,
}

/// Copy of a data set to be written. Its folder is opened before anything is generated, and locked until it
/// is written.
#[derive(Debug)]
pub struct DatasetCopy<'a> {
    root: &'a Path,
    target: WholeFolder,
}

/// Kind of the output folder.
const KIND: &str = "dataset";

impl<'a> DatasetCopy<'a> {
    /// Opens a folder for a copy of the data set at `root`. `rollout` is a folder that the same run writes,
    /// if there is one.
    ///
    /// # Errors
    /// Fails if the folder has other files or cannot be written, if it is in the data set or contains it, if
    /// one of folder and rollout is in the other, or if the data set is not a folder.
    pub fn open(root: &'a Path, folder: &Path, rollout: Option<&Path>) -> Result<Self, FileError> {
        if !root.is_dir() {
            return Err(FileError::content("the folder of a data set to copy", "none", root));
        }
        rollout.map_or(Ok(()), |rollout| check_apart(folder, rollout))?;
        let inputs = Inputs::new([root]);
        // The copy would contain its own work folder.
        inputs.check_outside(folder)?;
        Ok(Self { root, target: WholeFolder::open(folder, KIND, &inputs)? })
    }

    /// Checks that the images of a log can be replaced.
    ///
    /// # Errors
    /// Fails if an image is not below the data set, or if its camera is unknown.
    pub fn check(&self, log: &Recording) -> Result<(), FileError> {
        for record in log.frames.iter().flat_map(|frame| &frame.images) {
            relative(self.root, &record.path)?;
            camera_of(log, record, self.root)?;
        }
        Ok(())
    }

    /// Writes the copy with the images from rollouts of some logs, enlarged to the original size.
    ///
    /// # Errors
    /// Fails if a rollout has no generated images at its log's frames, or if a file cannot be read or
    /// written.
    pub fn write(self, logs: &[CopiedLog<'_>]) -> Result<ImageCounts, FileError> {
        let Self { root, target } = self;
        let mut by_path = BTreeMap::new();
        for copied in logs {
            for new in copied.replacements()? {
                by_path.insert(relative(root, &new.record.path)?, new);
            }
        }
        let frames = logs.iter().flat_map(|copied| &copied.log.frames);
        let images = frames.map(|frame| frame.images.len()).sum::<usize>();
        target.write(|whole| mirror(root, whole, Path::new(""), &by_path))?;
        Ok(ImageCounts { replaced: by_path.len(), retained: images - by_path.len() })
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
    /// Returns the generated images at frames of the log.
    fn replacements(&self) -> Result<Vec<Replacement<'a>>, FileError> {
        let Self { log, rollout } = *self;
        let mut replaced = Vec::new();
        for row in StateFile::read(&rollout.join(STATES))? {
            let Some(frame) = log.frames.iter().find(|frame| frame.t_us == row.t_us) else { continue };
            let step = rollout.join(STEPS).join(row.name());
            if report::images::is_reference(&step)? != Some(false) {
                continue;
            }
            for record in &frame.images {
                let camera = camera_of(log, record, &step)?;
                replaced.push(Replacement { step: step.clone(), camera, record });
            }
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
            let target = std::path::absolute(from.join(&name)).map_err(FileError::io("read", &from))?;
            symlink(target, to.join(&name)).map_err(FileError::io("link", &to.join(&name)))?;
        }
    }
    Ok(())
}

impl Replacement<'_> {
    fn write(&self, path: &Path) -> Result<(), FileError> {
        let camera = &self.record.camera;
        let generated = report::images::read_generated(&self.step, self.camera)?;
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
