use point_skeleton::Log;
use point_skeleton::conditions::FrameCaptions;
use point_skeleton::conditions::write::meta::PromptParts;
use point_skeleton::scene::GroundTruthImages;
use pskel_generate::{ClipImages, GenerationScene, ImportSession};
use pskel_network::OpenedGenerator;
use pskel_sim::rollout::ImageGenerator;
use serde_json::{Value, json};

pub(crate) use crate::args::generator::GeneratorArgs;

/// Images of another program in the place of generated ones.
pub(crate) type GivenImages = Option<ClipImages>;

/// The source of generated images.
pub(crate) enum Opened {
    /// The opened generator, and the captions of the log.
    Generator(OpenedGenerator, Option<FrameCaptions>),
    /// Images of another program.
    Images(ClipImages),
}

impl Opened {
    /// Opens the generator for a log that is generated at `fps` frames per second, unless images are given.
    pub(crate) fn open(
        args: &GeneratorArgs,
        images: &GivenImages,
        log: &Log,
        fps: f64,
    ) -> anyhow::Result<Option<Self>> {
        if let Some(images) = images {
            return Ok(Some(Self::Images(images.clone())));
        }
        if !args.generates() {
            return Ok(None);
        }
        let captions = args.captions(log.recording())?;
        Ok(args.open(log, fps)?.map(|opened| Self::Generator(opened, captions)))
    }

    /// Returns the number of frames in the window.
    pub(crate) fn window(&self) -> usize {
        match self {
            Self::Generator(opened, _) => opened.window(),
            Self::Images(images) => images.window(),
        }
    }

    /// Returns how many of the next planning steps it takes as forecasts, at most.
    #[cfg(feature = "drive")]
    pub(crate) fn forecasts(&self) -> usize {
        match self {
            Self::Generator(opened, _) => opened.forecasts(),
            Self::Images(_) => 0,
        }
    }

    /// Returns generator and options for `rollout.json`.
    pub(crate) fn record(&self) -> serde_json::Result<Value> {
        let (opened, captions) = match self {
            Self::Generator(opened, captions) => (opened, captions),
            Self::Images(images) => return Ok(json!({"size": images.size(), "window": images.window()})),
        };
        let mut record = opened.record()?;
        if let (Some(fields), Some(captions)) = (record.as_object_mut(), captions) {
            fields.insert("captions".to_owned(), serde_json::to_value(captions)?);
        }
        Ok(record)
    }

    /// Returns a line for the web page.
    pub(crate) fn fact(&self) -> String {
        match self {
            Self::Generator(opened, _) => opened.fact(),
            Self::Images(images) => format!("images of {} by another program", images.size()),
        }
    }

    /// Creates the generator. `follow_log`: whether ego and other actors follow the log in the whole rollout.
    pub(crate) fn session<'a>(
        self,
        log: &'a Log,
        has_map: bool,
        prompt: &PromptParts,
        follow_log: [bool; 2],
    ) -> anyhow::Result<Box<dyn ImageGenerator + 'a>> {
        let truth = GroundTruthImages::new(log.reader());
        let (opened, captions) = match self {
            Self::Generator(opened, captions) => (opened, captions),
            Self::Images(images) => {
                return Ok(Box::new(ImportSession::new(images, truth, follow_log)));
            }
        };
        let [ego_follows_log, actors_follow_log] = follow_log;
        let prompt = prompt.prompt().unwrap_or_default();
        let truth = Some(truth);
        let scene = GenerationScene { has_map, prompt, captions, truth, ego_follows_log, actors_follow_log };
        Ok(opened.session(scene)?)
    }
}
