//! Writes a copy of a nuScenes data set with other images: files that are not replaced are links to the original.

use std::collections::BTreeMap;
use std::io::{Cursor, Write};
use std::os::unix::fs::symlink;
use std::path::{Component, Path, PathBuf};

use image::codecs::jpeg::JpegEncoder;
use image::imageops::{self, FilterType};
use image::{ImageFormat, RgbImage};
use point_skeleton::dataset::{ImageRecord, Recording};
use point_skeleton::error::FileError;
use point_skeleton::files::{WholeFolder, check_whole, write_whole};
use pskel_sim::report::{self, ROLLOUT, STATES, STEPS, StateFile};

/// JPEG quality: high, so that visible artifacts are the generator's.
const QUALITY: u8 = 95;

/// Counts of replaced and unchanged images of the log's frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImageCounts {
    /// Number of replaced images.
    pub replaced: usize,
    /// Number of images of references, and of frames that were not generated.
    pub kept: usize,
}

/// Image that replaces a file of the data set.
struct Replacement<'a> {
    image: RgbImage,
    record: &'a ImageRecord,
}

/// Kind of the output folder.
const KIND: &str = "dataset";

/// Checks that a copy of a data set may be written to a folder, before anything is generated.
///
/// # Errors
/// Fails if the folder has other files.
pub fn check_dataset_copy(folder: &Path) -> Result<(), FileError> {
    check_whole(folder, KIND)
}

/// Writes the images of a rollout of the log into a copy of the data set at `root`, enlarged to the original size.
///
/// # Errors
/// Fails if the rollout has no generated images at the log's frames, or if a file cannot be read or written.
pub fn copy_dataset(
    root: &Path,
    log: &Recording,
    rollout: &Path,
    folder: &Path,
) -> Result<ImageCounts, FileError> {
    let target = WholeFolder::open(folder, KIND, &[root, rollout])?;
    let replaced = replacements(log, rollout)?;
    let images = log.frames.iter().map(|frame| frame.images.len()).sum::<usize>();
    let by_path = replaced.into_iter().map(|new| Ok((relative(root, &new.record.path)?, new)));
    let by_path = by_path.collect::<Result<BTreeMap<PathBuf, Replacement<'_>>, FileError>>()?;
    target.write(|whole| mirror(root, whole, Path::new(""), &by_path))?;
    Ok(ImageCounts { replaced: by_path.len(), kept: images - by_path.len() })
}

/// Returns the generated images at frames of the log.
fn replacements<'a>(log: &'a Recording, rollout: &Path) -> Result<Vec<Replacement<'a>>, FileError> {
    let cameras: Vec<_> = log.rig.iter().map(|rig| rig.camera.name.clone()).collect();
    let mut replaced = Vec::new();
    for row in StateFile::read(&rollout.join(STATES))? {
        let Some(frame) = log.frames.iter().find(|frame| frame.t_us == row.t_us) else { continue };
        let step = rollout.join(STEPS).join(row.name());
        let made = report::images::read(&step, &cameras)?.filter(|made| !made.is_reference);
        let Some(made) = made else { continue };
        for record in &frame.images {
            let place = log.rig.iter().position(|rig| rig.channel == record.channel);
            let image = place.and_then(|place| made.images.get(place)).cloned();
            let image = image.ok_or_else(|| {
                let camera = log.cameras.get(record.channel).map_or("a camera", |name| name.as_str());
                FileError::content(format!("an image of {camera}"), "none", &step)
            })?;
            replaced.push(Replacement { image, record });
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

fn relative(root: &Path, path: &Path) -> Result<PathBuf, FileError> {
    let is_plain = |part: Component<'_>| matches!(part, Component::Normal(_));
    let within = path.strip_prefix(root).ok().filter(|within| within.components().all(is_plain));
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
        let image = imageops::resize(&self.image, camera.width, camera.height, FilterType::CatmullRom);
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
