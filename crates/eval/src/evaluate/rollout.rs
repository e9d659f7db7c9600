//! Reader of rollouts with generated images.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use image::RgbImage;
use point_skeleton::conditions::reduce::nearest;
use point_skeleton::dataset::{picture_size, read_picture};
use point_skeleton::error::FileError;
use point_skeleton::files::FileName;
use point_skeleton::files::input::is_there;
use point_skeleton::geometry::ImageSize;
use pskel_sim::report::images::{self, GENERATED, ImageRows, TRUTH};
use pskel_sim::report::{ROLLOUT, STATES, STEPS, StateFile, StepRow};
use rayon::prelude::*;

use super::picture::{self, Read};
use crate::{MOVING_MPS, moving_mask};

/// Index of a rollout's files.
pub(super) struct GeneratedRollout {
    pub(super) folder: PathBuf,
    /// Sorted by name.
    pub(super) cameras: Vec<FileName>,
    /// Sizes of generated images, by camera.
    pub(super) sizes: Vec<ImageSize>,
    /// Steps with generated images.
    pub(super) steps: Vec<Step>,
    /// Number of steps with references instead of generated images.
    pub(super) references: usize,
}

/// Step with generated images.
pub(super) struct Step {
    name: String,
    /// Number of the planning step, from 0.
    frame: usize,
    /// Time since the first step of the rollout, seconds.
    pub(super) t_s: f64,
    pub(super) folder: PathBuf,
    /// Rows of the cameras' images that the images show; `None` for all.
    rows: Option<ImageRows>,
    /// Instance numbers of moving actors.
    moving: Vec<u32>,
}

/// Images and maps of a step, at the size of the generated images, in the order of the cameras.
pub(super) struct Frame {
    pub(super) generated: Vec<RgbImage>,
    pub(super) truth: Option<Vec<RgbImage>>,
    pub(super) class: Option<Vec<Vec<u8>>>,
    pub(super) moving: Option<Vec<Vec<bool>>>,
}

impl GeneratedRollout {
    /// Finds the generated images, and reads only the sizes of the first ones.
    pub(super) fn open(folder: &Path) -> Result<Self, FileError> {
        if !is_there(&folder.join(ROLLOUT))? {
            return Err(FileError::content(
                "a rollout with generated images",
                format!("no {ROLLOUT}"),
                folder,
            ));
        }
        let rows = StateFile::read(&folder.join(STATES))?;
        let first_us = rows.first().map_or(0, |row| row.t_us);
        let (mut steps, mut references) = (Vec::new(), 0);
        for row in &rows {
            let step = Step::new(folder, row, references + steps.len(), first_us);
            match images::is_reference(&step.folder)? {
                None => {}
                Some(true) => references += 1,
                Some(false) => steps.push(Step { rows: images::rows(&step.folder)?, ..step }),
            }
        }
        let Some(first) = steps.first() else {
            let found = format!("none in {} steps ({references} with references)", rows.len());
            return Err(FileError::content("generated images", found, folder));
        };
        let cameras = cameras(&first.folder.join(GENERATED))?;
        let size = |camera: &FileName| {
            let (height, width) = picture_size(&first.image(GENERATED, camera))?;
            Ok(ImageSize { height, width })
        };
        let sizes = cameras.iter().map(size).collect::<Result<_, FileError>>()?;
        Ok(Self { folder: folder.to_owned(), cameras, sizes, steps, references })
    }

    /// Drops all steps but every N-th frame, N - 1, 2 N - 1, ..
    ///
    /// # Errors
    /// Fails if none is left.
    pub(super) fn hold_out(&mut self, every: usize) -> Result<(), FileError> {
        let found = self.steps.len();
        self.steps.retain(|step| (step.frame + 1).is_multiple_of(every));
        if self.steps.is_empty() {
            let expected = format!("a generated image of every frame {every} N - 1");
            return Err(FileError::content(expected, format!("none in {found} steps"), &self.folder));
        }
        Ok(())
    }

    /// Reads the images and maps of a step.
    pub(super) fn read(&self, step: &Step) -> Result<Frame, FileError> {
        let class = self.maps(step, "class", picture::class)?;
        let instance = self.maps(step, "instance", picture::instance)?;
        let moving = |maps: Vec<Vec<u32>>| maps.iter().map(|map| moving_mask(map, &step.moving)).collect();
        let generated = self.images(step, GENERATED)?;
        Ok(Frame { generated, truth: self.truth(step)?, class, moving: instance.map(moving) })
    }

    /// Reads vehicle masks `NNNNNN/CAM.png` of a step, of any size.
    pub(super) fn masks(&self, step: &Step, folder: &Path) -> Result<Vec<Vec<bool>>, FileError> {
        let path = |camera: &FileName| folder.join(&step.name).join(format!("{camera}.png"));
        self.reduced(path, None, picture::mask)
    }

    /// Returns the name of a step in messages.
    pub(super) fn name_of(&self, step: &Step) -> String {
        format!("{}, step {}", self.folder.display(), step.name)
    }

    /// Reads the ground-truth images of a step; `None` if there are none.
    fn truth(&self, step: &Step) -> Result<Option<Vec<RgbImage>>, FileError> {
        step.folder.join(TRUTH).is_dir().then(|| self.images(step, TRUTH)).transpose()
    }

    /// Reads the images of all cameras, which must have the sizes of the first step.
    fn images(&self, step: &Step, folder: &str) -> Result<Vec<RgbImage>, FileError> {
        let cameras = self.cameras.par_iter().zip(&self.sizes);
        cameras
            .map(|(camera, size)| read_picture(&step.image(folder, camera), size.height, size.width))
            .collect()
    }

    /// Reads the maps of all cameras, reduced to the size of the generated images; `None` if the first camera
    /// has none.
    fn maps<T: Copy + Send + Sync>(
        &self,
        step: &Step,
        map: &str,
        read: fn(&Path) -> Result<Read<T>, FileError>,
    ) -> Result<Option<Vec<Vec<T>>>, FileError> {
        let path = |camera: &FileName| step.folder.join(camera).join(format!("{map}.png"));
        if !self.cameras.first().is_some_and(|camera| path(camera).exists()) {
            return Ok(None);
        }
        self.reduced(path, step.rows, read).map(Some)
    }

    /// Reads a file per camera, cropped to some rows and reduced to the size of the generated images.
    fn reduced<T: Copy + Send + Sync>(
        &self,
        path: impl Fn(&FileName) -> PathBuf + Sync,
        rows: Option<ImageRows>,
        read: fn(&Path) -> Result<Read<T>, FileError>,
    ) -> Result<Vec<Vec<T>>, FileError> {
        let reduced = |(camera, to): (&FileName, &ImageSize)| {
            let (map, from) = read(&path(camera))?;
            let rows = rows.map_or(0..from.height, |rows| rows.range(from.height));
            let pixel = |row: u32| (row * from.width) as usize;
            let shown = ImageSize { height: rows.end - rows.start, ..from };
            Ok(nearest(&map[pixel(rows.start)..pixel(rows.end)], shown, *to))
        };
        self.cameras.par_iter().zip(&self.sizes).map(reduced).collect()
    }
}

impl Step {
    fn new(folder: &Path, row: &StepRow, frame: usize, first_us: i64) -> Self {
        let moving = row.actors.iter().filter(|actor| actor.speed_mps.abs() > MOVING_MPS);
        Self {
            name: row.name(),
            frame,
            t_s: (row.t_us - first_us) as f64 / 1e6,
            folder: folder.join(STEPS).join(row.name()),
            rows: None,
            moving: moving.map(|actor| actor.instance).collect(),
        }
    }

    fn image(&self, folder: &str, camera: &FileName) -> PathBuf {
        self.folder.join(folder).join(format!("{camera}.png"))
    }
}

/// Returns the camera names of the images in a folder, sorted.
fn cameras(folder: &Path) -> Result<Vec<FileName>, FileError> {
    let mut names = BTreeSet::new();
    for entry in std::fs::read_dir(folder).map_err(FileError::io("read", folder))? {
        let path = entry.map_err(FileError::io("read", folder))?.path();
        if path.extension().is_some_and(|ending| ending == "png")
            && let Some(name) = path.file_stem().and_then(|stem| stem.to_str())
        {
            names.insert(FileName::new(name).map_err(|error| error.in_file(&path))?);
        }
    }
    if names.is_empty() {
        return Err(FileError::content("generated images CAM.png", "none", folder));
    }
    Ok(names.into_iter().collect())
}
