use std::path::Path;

use clap::Args;
use point_skeleton::scene::SceneClouds;
use pskel_sim::rollout::ImageGenerator;
use serde_json::Value;

use crate::WrongUsage;
use crate::simulate::Inputs;

/// No options.
#[derive(Debug, Args)]
pub(crate) struct GenerationArgs {}

/// There is no generator.
pub(in crate::simulate) enum Opened {}

impl GenerationArgs {
    pub(in crate::simulate) fn check(&self) -> Result<(), WrongUsage> {
        Ok(())
    }

    pub(in crate::simulate) fn weights(&self) -> Option<&Path> {
        None
    }

    pub(in crate::simulate) fn open(&self, _cameras: usize) -> anyhow::Result<Option<Opened>> {
        Ok(None)
    }
}

impl Opened {
    pub(in crate::simulate) fn window(&self) -> usize {
        match *self {}
    }

    pub(in crate::simulate) fn record(&self) -> serde_json::Result<Value> {
        match *self {}
    }

    pub(in crate::simulate) fn fact(&self) -> String {
        match *self {}
    }

    pub(in crate::simulate) fn session<'a>(
        self,
        _inputs: &'a Inputs,
        _clouds: &'a SceneClouds<'a>,
        _follow_log: [bool; 2],
    ) -> anyhow::Result<Box<dyn ImageGenerator + 'a>> {
        match self {}
    }
}
