use std::time::Instant as Clock;

use image::RgbImage;
use image::imageops::crop_imm;
use point_skeleton::Renderer;
use point_skeleton::dataset::read_picture;
use point_skeleton::error::FileError;
use point_skeleton::geometry::{ImageSize, View};
use point_skeleton::scene::{GroundTruthError, GroundTruthImages, SceneState};
use pskel_sim::report::images::{ImageRows, StepImages};
use pskel_sim::rollout::{AnyError, GenerationTimes, ImageGenerator, lap};
use pskel_sim::{Committed, Forecast};
use rayon::prelude::*;

use super::matching::{ClipImages, FrameImage};

/// Reads images of another program in the place of a generator.
pub struct ImportSession<'a> {
    images: ClipImages,
    truth: GroundTruthImages<'a>,
    /// Whether ego and actors follow the log in the whole rollout.
    follow_log: [bool; 2],
    /// Open videos, in the order of the cameras.
    #[cfg(feature = "video")]
    videos: Vec<Option<pskel_sim::report::VideoFrames>>,
    times: GenerationTimes,
}

impl ClipImages {
    /// Returns the number of frames in the window: the references and the frame that is generated.
    pub fn window(&self) -> usize {
        self.references + 1
    }

    /// Returns the size of the images.
    pub fn size(&self) -> ImageSize {
        self.size
    }
}

impl<'a> ImportSession<'a> {
    /// Starts a rollout. `follow_log`: whether the ego and the actors follow the log in the whole rollout.
    pub fn new(images: ClipImages, truth: GroundTruthImages<'a>, follow_log: [bool; 2]) -> Self {
        Self {
            images,
            truth,
            follow_log,
            #[cfg(feature = "video")]
            videos: Vec::new(),
            times: GenerationTimes::default(),
        }
    }

    /// Returns the ground-truth images of a state, cropped to the rows of the images.
    fn truth(&self, state: &SceneState) -> Result<Vec<RgbImage>, GroundTruthError> {
        let ClipImages { size, rows, .. } = &self.images;
        let whole = rows.map_or(*size, |rows| rows.whole(*size));
        let drawn =
            |view: &View| View { camera: view.camera.resized(whole.height, whole.width), ..view.clone() };
        let images = self.truth.of(state, drawn, whole, self.follow_log[1])?;
        Ok(match rows {
            Some(rows) => images.iter().map(|image| crop(image, *rows, *size)).collect(),
            None => images,
        })
    }

    /// Reads the images of a frame.
    fn read(&mut self, images: &[FrameImage]) -> Result<Vec<RgbImage>, FileError> {
        if let [first, second, ..] = images
            && first == second
        {
            // One camera stands for all.
            let read = self.read(&images[..1])?;
            return Ok(read.into_iter().cycle().take(images.len()).collect());
        }
        let ImageSize { height, width } = self.images.size;
        let file = |image: &FrameImage| match image.video_frame {
            None => read_picture(&image.path, height, width).map(Some),
            Some(_) => Ok(None),
        };
        let files = images.par_iter().map(file).collect::<Result<Vec<_>, _>>()?;
        let of_camera = |(camera, (read, image)): (usize, (Option<RgbImage>, &FrameImage))| match read {
            Some(read) => Ok(read),
            None => self.video_frame(camera, image),
        };
        files.into_iter().zip(images).enumerate().map(of_camera).collect()
    }

    /// Reads a frame of a camera's video.
    #[cfg(feature = "video")]
    fn video_frame(&mut self, camera: usize, image: &FrameImage) -> Result<RgbImage, FileError> {
        let number = image.video_frame.unwrap_or_default();
        self.videos.resize_with(self.videos.len().max(camera + 1), || None);
        let opened = self.videos[camera].take().filter(|video| video.is_before(&image.path, number));
        let mut video = opened.map_or_else(|| pskel_sim::report::VideoFrames::open(&image.path), Ok)?;
        let found = video.frame(number)?;
        self.videos[camera] = Some(video);
        Ok(found)
    }

    /// There are no frames of videos without the feature.
    #[cfg(not(feature = "video"))]
    fn video_frame(&mut self, _camera: usize, image: &FrameImage) -> Result<RgbImage, FileError> {
        Err(FileError::content("a program with the feature video", "one without", &image.path))
    }
}

/// Returns the rows of a whole image, `size` in total.
fn crop(image: &RgbImage, rows: ImageRows, size: ImageSize) -> RgbImage {
    let top = rows.range(image.height()).start.min(image.height() - size.height);
    crop_imm(image, 0, top, size.width, size.height).to_image()
}

impl ImageGenerator for ImportSession<'_> {
    fn forecasts(&self) -> usize {
        0
    }

    fn generate(
        &mut self,
        frame: usize,
        now: Committed<&SceneState>,
        _expected: &[Forecast<SceneState>],
        _renderer: &mut Renderer<'_>,
    ) -> Result<Option<StepImages>, AnyError> {
        let rows = self.images.rows;
        let mut clock = Clock::now();
        let mut times = GenerationTimes::default();
        let is_reference = frame < self.images.references;
        let found = self.images.frames.get(frame).cloned().flatten();
        if !is_reference && found.is_none() {
            return Ok(None);
        }
        let truth = (is_reference || self.has_truth()).then(|| self.truth(now.get())).transpose()?;
        times.truth_s = lap(&mut clock);
        let images = match (&truth, found) {
            (Some(truth), _) if is_reference => truth.clone(),
            (_, Some(found)) => self.read(&found)?,
            _ => return Ok(None),
        };
        times.decode_s = lap(&mut clock);
        self.times = times;
        let truth = truth.filter(|_| self.has_truth());
        Ok(Some(StepImages { is_reference, images, truth, rows }))
    }

    /// The images are all there.
    fn add_reference(
        &mut self,
        _now: Committed<&SceneState>,
        _images: Vec<RgbImage>,
        _renderer: &mut Renderer<'_>,
    ) -> Result<(), AnyError> {
        Err("images of another program take no references".into())
    }

    fn times(&self) -> GenerationTimes {
        self.times
    }

    fn save(&self) -> Result<Option<Vec<u8>>, AnyError> {
        Ok(None)
    }

    fn resume(
        &mut self,
        _frames: usize,
        _last: &[Committed<SceneState>],
        _saved: Option<&[u8]>,
        _renderer: &mut Renderer<'_>,
    ) -> Result<(), AnyError> {
        Ok(())
    }

    fn window(&self) -> usize {
        self.images.window()
    }

    fn has_truth(&self) -> bool {
        let [ego, actors] = self.follow_log;
        self.truth.are_known(ego, actors)
    }
}
