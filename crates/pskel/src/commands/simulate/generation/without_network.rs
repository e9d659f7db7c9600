use std::path::Path;

use clap::Args;
use point_skeleton::Log;
use point_skeleton::conditions::write::meta::PromptParts;
use pskel_sim::rollout::ImageGenerator;
use serde_json::Value;

use crate::WrongUsage;

/// No options.
#[derive(Clone, Debug, Args)]
pub(crate) struct GeneratorArgs {}

/// There are no images of another program.
pub(crate) type GivenImages = ();

/// There is no generator.
pub(crate) enum Opened {}

impl GeneratorArgs {
    pub(crate) fn generates(&self) -> bool {
        false
    }

    #[cfg(feature = "drive")]
    pub(crate) fn name(&self) -> Option<String> {
        None
    }

    #[cfg(feature = "drive")]
    pub(crate) fn arguments(&self) -> Vec<String> {
        Vec::new()
    }

    pub(crate) fn check(&self) -> Result<(), WrongUsage> {
        Ok(())
    }

    pub(crate) fn inputs(&self) -> impl Iterator<Item = &Path> {
        std::iter::empty()
    }
}

impl Opened {
    pub(crate) fn open(
        _: &GeneratorArgs,
        _: &GivenImages,
        _log: &Log,
        _fps: f64,
    ) -> anyhow::Result<Option<Self>> {
        Ok(None)
    }

    pub(crate) fn window(&self) -> usize {
        match *self {}
    }

    #[cfg(feature = "drive")]
    pub(crate) fn forecasts(&self) -> usize {
        match *self {}
    }

    pub(crate) fn record(&self) -> serde_json::Result<Value> {
        match *self {}
    }

    pub(crate) fn fact(&self) -> String {
        match *self {}
    }

    pub(crate) fn session<'a>(
        self,
        _log: &'a Log,
        _has_map: bool,
        _prompt: &PromptParts,
        _follow_log: [bool; 2],
    ) -> anyhow::Result<Box<dyn ImageGenerator + 'a>> {
        match self {}
    }
}
