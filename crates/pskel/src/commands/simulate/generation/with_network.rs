use std::path::Path;

use clap::Args;
use point_skeleton::conditions::FrameCaptions;
use point_skeleton::dataset::Recording;
use point_skeleton::scene::GroundTruthImages;
use pskel_generate::DenoiserRig;
use pskel_network::{GenerationScene, NetworkName, OpenedNetwork};
use pskel_sim::rollout::ImageGenerator;
use serde_json::Value;

use crate::WrongUsage;
use crate::args::generator::GeneratorArgs;
use crate::commands::simulate::inputs::Inputs;

/// Network and options of the generator.
#[derive(Debug, Args)]
pub(crate) struct GenerationArgs {
    /// Also generate the cameras' images with a network: network (shipped with the program), network:FILE
    /// with weights of `pskel train`, fill (no network: holes filled), or process:COMMAND, process:unix:PATH
    /// or process:tcp:HOST:PORT (docs/src/reference/denoiser.md). Each planning step gets
    /// steps/STEP/generated, and truth if ground truth is known. Map options apply to the written maps; the
    /// network's conditions are rendered as in its training
    #[arg(long, value_name = "NETWORK")]
    pub(crate) generator: Option<NetworkName>,
    #[command(flatten, next_help_heading = "Options of --generator")]
    pub(crate) options: GeneratorArgs,
}

/// The opened network, and the captions of the log.
pub(crate) struct Opened {
    network: OpenedNetwork,
    captions: Option<FrameCaptions>,
}

impl GenerationArgs {
    /// Returns whether images are generated.
    pub(crate) fn generates(&self) -> bool {
        self.generator.is_some()
    }

    /// Rejects options that have no effect.
    pub(crate) fn check(&self) -> Result<(), WrongUsage> {
        self.options.check(self.generator.as_ref())
    }

    /// Returns the files that are read: weights, captions and recipe.
    pub(crate) fn inputs(&self) -> impl Iterator<Item = &Path> {
        let weights = match &self.generator {
            Some(NetworkName::Network(weights)) => weights.as_deref(),
            _ => None,
        };
        weights.into_iter().chain(self.options.inputs())
    }

    /// Opens the network for a log that is generated at `fps` frames per second.
    pub(crate) fn open(&self, log: &Recording, fps: f64) -> anyhow::Result<Option<Opened>> {
        let Some(name) = &self.generator else { return Ok(None) };
        let captions = self.options.captions(log)?;
        let network = self.options.open(name, &DenoiserRig::of(log, fps))?;
        Ok(Some(Opened { network, captions }))
    }
}

impl Opened {
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
