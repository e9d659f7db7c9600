//! A network in another process, which exchanges safetensors with this one: see
//! `docs/src/reference/denoiser.md`.

mod call;
mod codec;
pub(crate) mod connection;
pub(crate) mod hello;
pub(crate) mod message;
mod rig;
mod sent;

use std::sync::Arc;

use point_skeleton::geometry::ImageSize;
use pskel_sim::peer::{PeerSpec, ProtocolError};

use self::call::{read_guided, read_prediction, request};
use self::codec::ProcessCodec;
use self::connection::Shared;
use self::hello::{DenoiserInputs, DenoiserOutputs, hello, read_hello};
pub use self::rig::DenoiserRig;
use self::sent::SentFrames;
use super::denoiser::predict_twice;
use super::{
    Codec, Denoiser, DenoiserError, DroppedConditions, Frame, FrameConditions, GenerateOptions,
    GuidedPrediction, Latent, LatentShape, PixelCodec,
};

/// A network in another process, after the exchange of hellos. After a failure, all further calls fail; a
/// [`Generator`](super::Generator) resumes from its cache with a new process.
pub struct ProcessDenoiser {
    shared: Arc<Shared>,
    taken: DenoiserInputs,
    given: DenoiserOutputs,
    /// Number of calls so far.
    calls: u64,
    /// Conditions that the process keeps; `None` if it keeps none.
    sent: Option<SentFrames>,
}

impl ProcessDenoiser {
    /// Starts the process or connects to it, and exchanges hellos. It will receive the cameras of `rig` with
    /// conditions of `size`.
    ///
    /// # Errors
    /// Returns an error if the process cannot be started or reached, does not answer in time, or violates the
    /// protocol.
    pub fn start(
        spec: &PeerSpec,
        options: &GenerateOptions,
        rig: &DenoiserRig,
        size: ImageSize,
    ) -> Result<Self, DenoiserError> {
        let views = rig.cameras.len();
        let taken = DenoiserInputs { window: options.window, views, size, sampler: options.sampler };
        let shared = Arc::new(Shared::open(spec)?);
        let given = shared.ask(hello(&taken, rig)?, |answer| read_hello(answer, &taken))?;
        let sent = given.keeps_frames.then(SentFrames::default);
        Ok(Self { shared, taken, given, calls: 0, sent })
    }

    /// Returns the codec of its latents and the image size: the process itself if it announced that, else a
    /// [`PixelCodec`].
    ///
    /// # Errors
    /// Returns an error if the process does not decode and its latents cannot be pixels.
    pub fn codec(&self) -> Result<(Box<dyn Codec + Send>, ImageSize), DenoiserError> {
        let given = self.given;
        if let Some(size) = given.images {
            return Ok((Box::new(ProcessCodec { shared: self.shared.clone(), given, size }), size));
        }
        let codec = PixelCodec::new(given.shape)?;
        let [height, width] = codec.size().map(|side| side as u32);
        Ok((Box::new(codec), ImageSize { height, width }))
    }

    /// Sends a window and reads the answer.
    fn ask<T>(
        &mut self,
        window: &[Frame<'_, FrameConditions>],
        dropped: Option<DroppedConditions>,
        read: fn(&[u8], DenoiserOutputs, usize, u64) -> Result<T, ProtocolError>,
    ) -> Result<T, DenoiserError> {
        self.check(window)?;
        let (call, given) = (self.calls, self.given);
        self.calls += 1;
        let request = request(window, given.shape, call, dropped, self.sent.as_mut())?;
        self.shared.ask(request, |answer| read(answer, given, window.len(), call))
    }

    /// Checks that a window matches the hello.
    fn check(&self, window: &[Frame<'_, FrameConditions>]) -> Result<(), DenoiserError> {
        let DenoiserInputs { window: frames, views, size, .. } = self.taken;
        if window.len() != frames {
            return Err(DenoiserError::input(
                format!("a window of {frames} frames"),
                window.len().to_string(),
            ));
        }
        for (position, Frame { latent, condition, .. }) in window.iter().enumerate() {
            let shape = self.given.shape;
            if latent.shape() != shape {
                let expected = format!("latents of {shape} for frame {position} of the window");
                return Err(DenoiserError::input(expected, latent.shape().to_string()));
            }
            let (found, is_whole) = ((condition.views(), condition.size), condition.is_whole());
            if found != (views, size) || !is_whole {
                let expected =
                    format!("whole maps of {views} cameras of {size} for frame {position} of the window");
                let part = if is_whole { "" } else { ", not whole" };
                let found = format!("{} of {}{part}", found.0, found.1);
                return Err(DenoiserError::input(expected, found));
            }
        }
        Ok(())
    }
}

impl Denoiser for ProcessDenoiser {
    type Condition = FrameConditions;

    fn shape(&self) -> LatentShape {
        self.given.shape
    }

    fn predict(&mut self, window: &[Frame<'_, FrameConditions>]) -> Result<Vec<Latent>, DenoiserError> {
        self.ask(window, None, read_prediction)
    }

    fn predict_guided(
        &mut self,
        window: &[Frame<'_, FrameConditions>],
        dropped: DroppedConditions,
    ) -> Result<GuidedPrediction, DenoiserError> {
        if !self.given.is_guided {
            return predict_twice(self, window, dropped);
        }
        self.ask(window, Some(dropped), read_guided)
    }
}
