//! The generated images of a rollout as files that [`ImageFolder`](crate::ImageFolder) reads.

use std::path::{Path, PathBuf};

use point_skeleton::error::FileError;
use point_skeleton::files::input::{IMAGE_BYTES, read_file};
use point_skeleton::files::{FileName, json, write_whole};
#[cfg(feature = "video")]
use point_skeleton::geometry::ImageSize;
use pskel_sim::report::images::{self, GENERATED};
use pskel_sim::report::{ROLLOUT, STATES, STEPS, StateFile, StepRow};
#[cfg(feature = "video")]
use pskel_sim::report::{Video, VideoError};
use serde::Deserialize;

/// Generated images of a rollout.
#[derive(Debug)]
pub struct RolloutImages {
    cameras: Vec<FileName>,
    /// Folders of the frames; `None` for a frame without images.
    frames: Vec<Option<Frame>>,
    /// Of messages.
    #[cfg(feature = "video")]
    folder: PathBuf,
    #[cfg(feature = "video")]
    hz: f64,
}

#[derive(Debug)]
struct Frame {
    step: PathBuf,
    is_reference: bool,
}

/// Content of `rollout.json` that is used here.
#[derive(Deserialize)]
struct RolloutRates {
    sim_hz: f64,
    plan_hz: f64,
}

impl RolloutImages {
    /// Finds the images of a rollout.
    ///
    /// # Errors
    /// Fails if the folder is not a rollout with images of these cameras.
    pub fn open(folder: &Path, cameras: Vec<FileName>) -> Result<Self, FileError> {
        let rates: RolloutRates = json::read(&folder.join(ROLLOUT), "rates of a rollout")?;
        let per_frame = (rates.sim_hz / rates.plan_hz).round().max(1.0) as usize;
        let frame = |row: &StepRow| {
            let step = folder.join(STEPS).join(row.name());
            let is_reference = images::is_reference(&step)?;
            Ok(is_reference.map(|is_reference| Frame { step, is_reference }))
        };
        let rows = StateFile::read(&folder.join(STATES))?;
        let frames = rows.iter().step_by(per_frame).map(frame).collect::<Result<Vec<_>, FileError>>()?;
        Ok(Self {
            cameras,
            frames,
            #[cfg(feature = "video")]
            folder: folder.to_owned(),
            #[cfg(feature = "video")]
            hz: rates.plan_hz,
        })
    }

    /// Writes the images after the references, as `CAM/NUMBER.png` below `out` with the number of the frame.
    /// Returns their count.
    ///
    /// # Errors
    /// Fails if an image cannot be read or written.
    pub fn write_frames(&self, out: &Path) -> Result<usize, FileError> {
        let mut count = 0;
        for camera in &self.cameras {
            let folder = out.join(camera);
            std::fs::create_dir_all(&folder).map_err(FileError::io("create", &folder))?;
            for (number, frame) in self.frames.iter().enumerate() {
                let Some(frame) = frame.as_ref().filter(|frame| !frame.is_reference) else { continue };
                let from = frame.step.join(GENERATED).join(format!("{camera}.png"));
                let (bytes, to) = (read_file(&from, IMAGE_BYTES)?, folder.join(format!("{number:04}.png")));
                write_whole(&to, |out| {
                    std::io::Write::write_all(out, &bytes).map_err(FileError::io("write", &to))
                })?;
                count += 1;
            }
        }
        Ok(count)
    }

    /// Writes the images of all frames, with the references, as `CAM.mp4` below `out`. Returns their count.
    ///
    /// # Errors
    /// Fails if a frame has no images, if they cannot be encoded, or if a file cannot be read or written.
    #[cfg(feature = "video")]
    pub fn write_videos(&self, out: &Path) -> Result<usize, VideoError> {
        std::fs::create_dir_all(out).map_err(FileError::io("create", out))?;
        let mut count = 0;
        for camera in &self.cameras {
            let mut video = None;
            for (number, frame) in self.frames.iter().enumerate() {
                let frame = frame.as_ref().ok_or_else(|| {
                    let expected = "images of every frame, for a video";
                    FileError::content(expected, format!("none of frame {number}"), &self.folder)
                })?;
                let image = images::read_generated(&frame.step, camera)?;
                let size = ImageSize { height: image.height(), width: image.width() };
                let video = match &mut video {
                    Some(video) => video,
                    none => none.insert(Video::new(&out.join(format!("{camera}.mp4")), size, self.hz)?),
                };
                video.push(size, image.as_raw().as_chunks().0)?;
                count += 1;
            }
            video.map_or(Ok(()), Video::write)?;
        }
        Ok(count)
    }
}
