//! A generator of images in another process, with a sampler of its own: see `docs/src/reference/images.md`.
//!
//! # How it works
//! [`ImageProcess`] starts the process and learns from its `hello` what it wants. An [`ImageSession`] renders
//! these maps at each planning step and for its forecasts, sends them with poses, actors, prompts and earlier
//! images as a `request`, and takes the images of the answer.

mod hello;
mod request;
mod rig;
pub(super) mod session;

use point_skeleton::conditions::MapKind;
use point_skeleton::geometry::ImageSize;
use point_skeleton::memory::{MemoryError, Need, reserve};
use point_skeleton::scene::GroundTruthError;
use pskel_sim::peer::{Framing, Link, PeerError, PeerSpec, ProtocolError};
use safetensors::SafeTensorError;
use serde::Serialize;

use self::hello::{Wanted, hello, read_hello};
pub use self::rig::ImageRig;
use crate::Recipe;
use crate::process::connection::MAX_ANSWER_BYTES;

/// Image generator in another process, after the exchange of hellos. After a failure, all further calls fail.
/// Serializes as what determines its images.
#[derive(Serialize)]
pub struct ImageProcess {
    #[serde(skip)]
    link: Link,
    recipe: Recipe,
    #[serde(flatten)]
    wanted: Wanted,
    noise_seed: u64,
    #[serde(skip)]
    views: usize,
}

/// Error of an image generator in another process.
#[derive(Debug, thiserror::Error)]
pub enum ImageProcessError {
    /// The process does not answer, or its answer is invalid.
    #[error(transparent)]
    Peer(#[from] PeerError),
    /// More memory is needed than available.
    #[error(transparent)]
    Memory(#[from] MemoryError),
    /// A request cannot be serialized.
    #[error("cannot write a request of the image generator: {0}")]
    Request(#[from] SafeTensorError),
    /// The maps cannot be rendered.
    #[error(transparent)]
    Rendering(#[from] point_skeleton::Error),
    /// The recorded images cannot be read.
    #[error(transparent)]
    Truth(#[from] GroundTruthError),
    /// References are to be given, and some are missing.
    #[error("expected given references before the first generated frame, found none")]
    NoReferences,
    /// Too many references are given.
    #[error("expected {expected} references, found another one")]
    References {
        /// Number of references.
        expected: usize,
    },
    /// Given references have another size.
    #[error("expected references as {views} images of {size}, found others")]
    ReferenceSize {
        /// Number of cameras.
        views: usize,
        /// Size of the images.
        size: ImageSize,
    },
    /// The rollout cannot be resumed because something is missing.
    #[error("cannot resume: expected {expected}, found {found}")]
    Resume {
        /// Needed input.
        expected: String,
        /// Given input.
        found: String,
    },
}

impl ImageProcess {
    /// Starts the process or connects to it, and exchanges hellos.
    ///
    /// # Errors
    /// Fails if the process cannot be started or reached, does not answer in time, or violates the protocol,
    /// and if its requests do not fit into memory.
    pub fn start(spec: &PeerSpec, recipe: Recipe, rig: &ImageRig) -> Result<Self, ImageProcessError> {
        let framing = Framing::Lengths { max_bytes: MAX_ANSWER_BYTES };
        let mut link = Link::open("image generator", spec, framing)?;
        let answer = link.ask(hello(rig, recipe.size)?)?;
        let wanted = read_hello(&answer, rig).map_err(|wrong| link.refuse(wrong))?;
        let process = Self { link, recipe, wanted, noise_seed: rig.seed, views: rig.rig.cameras.len() };
        process.check_memory()?;
        Ok(process)
    }

    /// Returns the recipe of its maps.
    pub fn recipe(&self) -> &Recipe {
        &self.recipe
    }

    /// Returns the size of its images.
    pub fn size(&self) -> ImageSize {
        self.wanted.size
    }

    /// Returns the number of frames in its window: the references and the frame that is generated.
    pub fn window(&self) -> usize {
        self.wanted.references + 1
    }

    /// Returns how many forecasts it takes at most.
    pub fn forecasts(&self) -> usize {
        self.wanted.forecasts
    }

    /// Returns the number of cameras.
    pub(crate) fn views(&self) -> usize {
        self.views
    }

    /// Sends a request and reads the answer.
    fn ask<T>(
        &mut self,
        request: Vec<u8>,
        read: impl FnOnce(&[u8]) -> Result<T, ProtocolError>,
    ) -> Result<T, PeerError> {
        let answer = self.link.ask(request)?;
        read(&answer).map_err(|wrong| self.link.refuse(wrong))
    }

    /// Checks that requests and images fit into the memory that is available.
    fn check_memory(&self) -> Result<(), MemoryError> {
        let Self { recipe, wanted, views, .. } = self;
        let frames = 1 + wanted.forecasts;
        let pixels = |size: ImageSize| (views * size.pixels()) as u64;
        let maps = wanted.maps.iter().map(|map| pixel_bytes(*map)).sum::<u64>() * pixels(recipe.size);
        let images = 3 * pixels(wanted.size);
        // A request is held twice while it is serialized; images are kept, and sent.
        let bytes = 2 * (frames as u64 * maps + (1 + wanted.history) as u64 * images);
        let what = || {
            let Wanted { history, size, .. } = wanted;
            format!("requests of {frames} frames of {} and {history} earlier images of {size}", recipe.size)
        };
        let advice = "a recipe of smaller maps, fewer forecasts or a shorter history needs less";
        reserve(bytes, || Need { what: what(), bytes, advice }).map(drop)
    }
}

/// Returns the bytes of a map per pixel in messages.
fn pixel_bytes(map: MapKind) -> u64 {
    match map {
        MapKind::Depth => 4,
        MapKind::Class => 1,
        MapKind::Instance => 2,
        _ => 3,
    }
}
