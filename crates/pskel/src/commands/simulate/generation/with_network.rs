use point_skeleton::conditions::FrameCaptions;
use point_skeleton::dataset::Recording;
use point_skeleton::scene::GroundTruthImages;
use pskel_generate::DenoiserRig;
use pskel_network::{GenerationScene, OpenedNetwork};
use pskel_sim::rollout::ImageGenerator;
use serde_json::Value;

use crate::commands::simulate::inputs::Inputs;

pub(crate) use crate::args::generator::GeneratorArgs;

/// The opened network, and the captions of the log.
pub(crate) struct Opened {
    network: OpenedNetwork,
    captions: Option<FrameCaptions>,
}

impl Opened {
    /// Opens the network for a log that is generated at `fps` frames per second.
    pub(crate) fn open(args: &GeneratorArgs, log: &Recording, fps: f64) -> anyhow::Result<Option<Self>> {
        if args.generator.is_none() {
            return Ok(None);
        }
        let captions = args.captions(log)?;
        let network = args.open(&DenoiserRig::of(log, fps))?;
        Ok(network.map(|network| Self { network, captions }))
    }

    /// Returns the number of frames in the window.
    pub(crate) fn window(&self) -> usize {
        self.network.window()
    }

    /// Returns network and options for `rollout.json`.
    pub(crate) fn record(&self) -> serde_json::Result<Value> {
        let mut record = serde_json::to_value(self.network.report())?;
        if let (Some(fields), Some(captions)) = (record.as_object_mut(), &self.captions) {
            fields.insert("captions".to_owned(), serde_json::to_value(captions)?);
        }
        Ok(record)
    }

    /// Returns a line for the web page.
    pub(crate) fn fact(&self) -> String {
        self.network.report().fact()
    }

    /// Creates the generator. `follow_log`: whether ego and other actors follow the log in the whole rollout.
    pub(crate) fn session<'a>(
        self,
        inputs: &'a Inputs,
        [ego_follows_log, actors_follow_log]: [bool; 2],
    ) -> anyhow::Result<Box<dyn ImageGenerator + 'a>> {
        let scene = GenerationScene {
            log: inputs.log.recording(),
            map: inputs.map.clone(),
            prompt: &inputs.prompt,
            captions: self.captions,
            truth: GroundTruthImages::new(inputs.log.reader()),
            ego_follows_log,
            actors_follow_log,
        };
        Ok(Box::new(self.network.session(&scene)?))
    }
}
