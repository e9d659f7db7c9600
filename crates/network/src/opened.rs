//! Generators by name: networks in the sampling loop of this program, and processes that make whole images.

use std::fmt;
use std::str::FromStr;

use point_skeleton::geometry::ImageSize;
use pskel_generate::{
    DenoiserRig, GenerationScene, ImageProcess, ImageRig, ImageSession, Recipe, SessionError,
};
use pskel_sim::peer::{PeerAddress, PeerError, PeerSpec};
use pskel_sim::rollout::ImageGenerator;
use serde_json::Value;

use super::generator::{GeneratorSettings, NetworkName, OpenNetworkError, OpenedNetwork};

/// Name of a generator: a [`NetworkName`], or `images:` with a command or an address.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum GeneratorName {
    /// A network, by a sampler of this program.
    Network(NetworkName),
    /// A process that makes whole images.
    Images(PeerAddress),
}

/// A generator that is ready for a rollout.
pub enum OpenedGenerator {
    /// A network, by a sampler of this program.
    Network(Box<OpenedNetwork>),
    /// A process that makes whole images, and its name.
    Process(Box<ImageProcess>, GeneratorName),
}

impl GeneratorSettings {
    /// Opens the weights or starts the process, for the cameras of a log. `has_map`: whether the log has an
    /// HD map.
    ///
    /// # Errors
    /// Fails as [`GeneratorSettings::open`] and [`ImageProcess::start`].
    pub fn open_generator(
        &self,
        name: &GeneratorName,
        rig: DenoiserRig,
        log: &str,
        has_map: bool,
    ) -> Result<OpenedGenerator, OpenNetworkError> {
        let address = match name {
            GeneratorName::Network(network) => {
                return Ok(OpenedGenerator::Network(Box::new(self.open(network, &rig)?)));
            }
            GeneratorName::Images(address) => address.clone(),
        };
        let whole = || Recipe { size: Recipe::default().drawn, ..Recipe::default() };
        let spec = PeerSpec { address, timeout_s: self.timeout_s };
        let rig = ImageRig { log: log.to_owned(), rig, has_map, seed: self.noise_seed };
        let process = ImageProcess::start(&spec, self.recipe.clone().unwrap_or_else(whole), &rig)?;
        Ok(OpenedGenerator::Process(Box::new(process), name.clone()))
    }
}

impl OpenedGenerator {
    /// Returns the number of frames in the window; all but one are references.
    pub fn window(&self) -> usize {
        match self {
            Self::Network(network) => network.window(),
            Self::Process(process, _) => process.window(),
        }
    }

    /// Returns how many of the next planning steps it takes as forecasts, at most.
    pub fn forecasts(&self) -> usize {
        match self {
            Self::Network(network) => network.forecasts(),
            Self::Process(process, _) => process.forecasts(),
        }
    }

    /// Returns the size of its images.
    pub fn size(&self) -> ImageSize {
        match self {
            Self::Network(network) => network.size(),
            Self::Process(process, _) => process.size(),
        }
    }

    /// Returns generator and options for `rollout.json`.
    ///
    /// # Errors
    /// Fails if they cannot be serialized.
    pub fn record(&self) -> serde_json::Result<Value> {
        match self {
            Self::Network(network) => serde_json::to_value(network.report()),
            Self::Process(process, name) => {
                let mut record = serde_json::to_value(process)?;
                if let Some(fields) = record.as_object_mut() {
                    fields.insert("process".to_owned(), name.to_string().into());
                }
                Ok(record)
            }
        }
    }

    /// Returns a line for the web page.
    pub fn fact(&self) -> String {
        match self {
            Self::Network(network) => network.report().fact(),
            Self::Process(process, name) => format!("images of {} by {name}", process.size()),
        }
    }

    /// Starts a rollout.
    ///
    /// # Errors
    /// Fails if codec and network differ in latent shape.
    pub fn session<'a>(
        self,
        scene: GenerationScene<'a>,
    ) -> Result<Box<dyn ImageGenerator + Send + 'a>, SessionError> {
        Ok(match self {
            Self::Network(network) => Box::new(network.session(&scene)?),
            Self::Process(process, _) => Box::new(ImageSession::new(*process, scene)),
        })
    }
}

impl fmt::Display for GeneratorName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Network(name) => name.fmt(f),
            Self::Images(address) => write!(f, "images:{address}"),
        }
    }
}

impl FromStr for GeneratorName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.strip_prefix("images:") {
            Some(address) => address.parse().map(Self::Images).map_err(|error: PeerError| error.to_string()),
            None => text
                .parse()
                .map(Self::Network)
                .map_err(|error| format!("{error}, or images: in place of process:")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_networks_or_processes() {
        for text in
            ["network", "network:w.safetensors", "fill", "process:tcp:h:1", "images:unix:/p", "images:a b"]
        {
            assert_eq!(text.parse::<GeneratorName>().unwrap().to_string(), text);
        }
        for text in ["", "images", "images:", "image:x"] {
            assert!(text.parse::<GeneratorName>().is_err(), "{text}");
        }
    }
}
