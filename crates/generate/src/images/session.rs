use std::collections::VecDeque;
use std::time::Instant as Clock;

use image::RgbImage;
use point_skeleton::conditions::{ConditionOptions, ConditionSet, MapSet, Prompts};
use point_skeleton::scene::{GroundTruthImages, SceneState};
use point_skeleton::{MapOptions, Renderer};
use pskel_sim::report::images::StepImages;
use pskel_sim::rollout::{AnyError, GenerationTimes, ImageGenerator, lap};
use pskel_sim::{Committed, Forecast};
use safetensors::tensor::Dtype;

use super::request::{IMAGES, RequestFrame, images_tensor, read_images, request};
use super::{ImageProcess, ImageProcessError};
use crate::GenerationScene;
use crate::process::message::{Answer, serialized};

/// Text of a saved state: the number of frames before it.
const FRAMES: &str = "frames";

/// An image generator in another process that runs with a simulation.
pub struct ImageSession<'a> {
    process: ImageProcess,
    scene: GenerationScene<'a>,
    prompt: Prompts,
    maps: MapOptions,
    /// The last images, oldest first; at most as many as a request has.
    earlier: VecDeque<Vec<RgbImage>>,
    /// Number of frames so far.
    frames: usize,
    times: GenerationTimes,
}

impl<'a> ImageSession<'a> {
    /// Starts a rollout.
    pub fn new(process: ImageProcess, scene: GenerationScene<'a>) -> Self {
        let recipe = process.recipe();
        let maps = MapSet::of(&process.wanted.maps);
        let options = ConditionOptions { maps, ..recipe.options(scene.has_map) };
        let maps = MapOptions::new(options, recipe.selection());
        let (prompt, earlier) = (Prompts::Frame(scene.prompt.clone()), VecDeque::new());
        Self { process, scene, prompt, maps, earlier, frames: 0, times: GenerationTimes::default() }
    }

    fn make(
        &mut self,
        frame: usize,
        now: &SceneState,
        expected: &[Forecast<SceneState>],
        renderer: &mut Renderer<'_>,
    ) -> Result<StepImages, ImageProcessError> {
        let mut clock = Clock::now();
        let mut times = GenerationTimes::default();
        let is_reference = frame < self.process.wanted.references;
        let truth = (is_reference || self.has_truth()).then(|| self.truth(now)).transpose()?;
        times.truth_s = lap(&mut clock);
        let images = match &truth {
            Some(truth) if is_reference => truth.clone(),
            _ => {
                let mut frames = vec![self.draw(now, renderer)?];
                times.conditions_s = lap(&mut clock);
                for next in expected.iter().take(self.process.forecasts()) {
                    frames.push(self.draw(next.get(), renderer)?);
                }
                times.forecasts_s = lap(&mut clock);
                let (size, views) = (self.process.size(), now_views(&frames));
                let drawn = self.process.recipe().size;
                let message = request(&self.process.wanted, frame, &frames, drawn, &self.earlier)?;
                drop(frames);
                let images = self.process.ask(message, |answer| read_images(answer, frame, views, size))?;
                times.network_s = lap(&mut clock);
                images
            }
        };
        self.times = times;
        self.keep(images.clone());
        let truth = truth.filter(|_| self.has_truth());
        Ok(StepImages { is_reference, images, truth, rows: None })
    }

    /// Renders the maps of a state.
    fn draw(
        &self,
        state: &SceneState,
        renderer: &mut Renderer<'_>,
    ) -> Result<RequestFrame<'_>, ImageProcessError> {
        let set = match self.process.wanted.maps.is_empty() {
            true => ConditionSet::default(),
            false => renderer.render_with(state, &self.maps)?.set,
        };
        let captions = self.scene.captions.as_ref();
        let prompts = captions.map_or(&self.prompt, |captions| captions.at(state.t_us));
        Ok(RequestFrame { state: state.clone(), set, prompts })
    }

    /// Returns the ground-truth images of a state.
    fn truth(&self, state: &SceneState) -> Result<Vec<RgbImage>, ImageProcessError> {
        let GenerationScene { truth, actors_follow_log, .. } = &self.scene;
        let truth: &GroundTruthImages<'_> = truth.as_ref().ok_or(ImageProcessError::NoReferences)?;
        let drawn = |view: &_| self.maps.conditions.drawn_view(view);
        Ok(truth.of(state, drawn, self.process.size(), *actors_follow_log)?)
    }

    /// Keeps the images of a frame for the next requests.
    fn keep(&mut self, images: Vec<RgbImage>) {
        self.frames += 1;
        self.earlier.push_back(images);
        while self.earlier.len() > self.process.wanted.history {
            self.earlier.pop_front();
        }
    }

    /// Reads the earlier images of a saved state.
    fn restore(&mut self, frames: usize, saved: &[u8]) -> Result<(), ImageProcessError> {
        let wrong = |expected: &str, found: String| {
            let expected = format!("{expected} behind frame {frames}");
            ImageProcessError::Resume { expected, found }
        };
        let (size, views) = (self.process.size(), self.process.views());
        let count = self.process.wanted.history.min(frames);
        let saved = Answer::read(saved).map_err(|error| wrong("earlier images", error.to_string()))?;
        if saved.texts.get(FRAMES).is_none_or(|found| *found != frames.to_string()) {
            return Err(wrong("images", format!("those behind frame {}", saved.quoted(FRAMES))));
        }
        self.frames = frames;
        if count == 0 {
            return Ok(());
        }
        let sizes = [count, views, size.height as usize, size.width as usize, 3];
        let images = saved.tensor(IMAGES, (Dtype::U8, ""), &sizes);
        let images = images.map_err(|error| wrong("earlier images", error.to_string()))?;
        let image = |bytes: &[u8]| RgbImage::from_raw(size.width, size.height, bytes.to_vec());
        let all: Vec<RgbImage> = images.data().chunks(3 * size.pixels()).filter_map(image).collect();
        self.earlier = all.chunks(views).map(<[RgbImage]>::to_vec).collect();
        Ok(())
    }
}

fn now_views(frames: &[RequestFrame<'_>]) -> usize {
    frames.first().map_or(0, |frame| frame.state.cameras.len())
}

impl ImageGenerator for ImageSession<'_> {
    fn forecasts(&self) -> usize {
        if self.frames < self.process.wanted.references { 0 } else { self.process.forecasts() }
    }

    fn generate(
        &mut self,
        frame: usize,
        now: Committed<&SceneState>,
        expected: &[Forecast<SceneState>],
        renderer: &mut Renderer<'_>,
    ) -> Result<Option<StepImages>, AnyError> {
        Ok(Some(self.make(frame, now.get(), expected, renderer)?))
    }

    fn add_reference(
        &mut self,
        _now: Committed<&SceneState>,
        images: Vec<RgbImage>,
        _renderer: &mut Renderer<'_>,
    ) -> Result<(), AnyError> {
        let (size, views, references) =
            (self.process.size(), self.process.views(), self.process.wanted.references);
        if self.frames >= references {
            return Err(ImageProcessError::References { expected: references }.into());
        }
        let fits = |image: &RgbImage| image.dimensions() == (size.width, size.height);
        if images.len() != views || !images.iter().all(fits) {
            return Err(ImageProcessError::ReferenceSize { views, size }.into());
        }
        self.keep(images);
        Ok(())
    }

    fn times(&self) -> GenerationTimes {
        self.times
    }

    fn save(&self) -> Result<Option<Vec<u8>>, AnyError> {
        if self.frames <= self.process.wanted.references {
            return Ok(None);
        }
        let (views, size) = (self.process.views(), self.process.size());
        let images = (!self.earlier.is_empty()).then(|| images_tensor(&self.earlier, views, size));
        let saved = serialized([(FRAMES, self.frames.to_string())], images.map(|images| (IMAGES, images)))?;
        Ok(Some(saved))
    }

    fn resume(
        &mut self,
        frames: usize,
        last: &[Committed<SceneState>],
        saved: Option<&[u8]>,
        _renderer: &mut Renderer<'_>,
    ) -> Result<(), AnyError> {
        let wrong =
            |expected: String, found: &str| ImageProcessError::Resume { expected, found: found.into() };
        if frames > self.process.wanted.references {
            let saved = saved.ok_or_else(|| wrong("the earlier images".to_owned(), "none"))?;
            return Ok(self.restore(frames, saved)?);
        }
        if last.len() != frames {
            return Err(wrong(format!("the {frames} planning steps before"), &last.len().to_string()).into());
        }
        for state in last {
            let images = self.truth(state.get())?;
            self.keep(images);
        }
        Ok(())
    }

    fn window(&self) -> usize {
        self.process.window()
    }

    fn has_truth(&self) -> bool {
        let GenerationScene { truth, ego_follows_log, actors_follow_log, .. } = &self.scene;
        truth.is_some_and(|truth| truth.are_known(*ego_follows_log, *actors_follow_log))
    }
}
