//! State of the generator between two frames, and its file format.

use std::collections::HashMap;
use std::ops::RangeInclusive;

use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};
use serde::{Deserialize, Serialize};

use crate::{GenerateError, GenerateOptions, Latent, LatentShape, Strategy};

/// State that is carried from step to step. It depends on no forecast, except with [`Strategy::Rolling`].
#[derive(Clone, Debug, PartialEq)]
pub struct Cache {
    /// Number of the next frame.
    pub next: usize,
    /// Latents of the window: L frames, or the last L-1 finished frames before the first step and with
    /// strategies that do not roll.
    pub frames: Vec<Latent>,
    /// Number of leading frames of the window that are finished and no longer updated: references, or the
    /// frames that a new window began with.
    pub references: usize,
    /// Number of rolls in place after the end of all conditions; only with [`Strategy::Rolling`].
    pub in_place: usize,
}

/// Numbers saved beside the latents, in the file metadata.
#[derive(Serialize, Deserialize)]
struct Numbers {
    next: usize,
    references: usize,
    in_place: usize,
}

/// The bytes are not a saved cache.
#[derive(Debug, thiserror::Error)]
#[error("expected a saved cache of the generator, found {found}")]
pub struct CacheError {
    /// What was found instead.
    pub found: String,
}

const FRAMES: &str = "frames";
const NUMBERS: &str = "cache";
/// Maximum frame number of a rollout; small enough that later additions do not overflow.
const MAX_FRAMES: usize = 1_000_000_000;

impl Cache {
    /// Serializes the cache as safetensors: `frames` of `[L, V, C, h, w]`, f32.
    ///
    /// # Errors
    /// Returns an error if the frames differ in shape.
    pub fn to_bytes(&self) -> Result<Vec<u8>, CacheError> {
        let Self { next, references, in_place, .. } = *self;
        let shape = self.frames.first().map(Latent::shape);
        let [views, channels, height, width] = shape.map_or([0; 4], LatentShape::to_array);
        let values: Vec<f32> = self.frames.iter().flat_map(|frame| frame.values()).copied().collect();
        let numbers = serde_json::to_string(&Numbers { next, references, in_place }).map_err(wrong)?;
        let data: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        let sizes = vec![self.frames.len(), views, channels, height, width];
        let frames = TensorView::new(Dtype::F32, sizes, &data).map_err(wrong)?;
        let metadata = HashMap::from([(NUMBERS.to_owned(), numbers)]);
        serialize([(FRAMES, frames)], Some(metadata)).map_err(wrong)
    }

    /// Parses the bytes written by [`Cache::to_bytes`].
    ///
    /// # Errors
    /// Returns an error if the bytes are not a saved cache.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CacheError> {
        let (_, head) = SafeTensors::read_metadata(bytes).map_err(wrong)?;
        let numbers = head.metadata().as_ref().and_then(|all| all.get(NUMBERS));
        let numbers: Numbers = serde_json::from_str(numbers.map_or("", String::as_str)).map_err(wrong)?;
        let tensors = SafeTensors::deserialize(bytes).map_err(wrong)?;
        let frames = tensors.tensor(FRAMES).map_err(wrong)?;
        let &[_, views, channels, height, width] = frames.shape() else {
            return Err(wrong(format!("frames of {:?}", frames.shape())));
        };
        if frames.shape().contains(&0) {
            return Err(wrong(format!("frames of {:?}", frames.shape())));
        }
        if frames.dtype() != Dtype::F32 {
            return Err(wrong(format!("frames as {:?}", frames.dtype())));
        }
        let shape = LatentShape { views, channels, height, width };
        let values = frames.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        let values: Vec<f32> = values.collect();
        let frames = values.chunks(shape.len().max(1)).filter_map(|frame| Latent::new(shape, frame.to_vec()));
        let Numbers { next, references, in_place } = numbers;
        Ok(Self { next, frames: frames.collect(), references, in_place })
    }

    /// Checks that a generator with these options and latent shape can have produced the cache.
    ///
    /// # Errors
    /// Returns an error if a number or a frame does not fit.
    pub(crate) fn check(&self, options: &GenerateOptions, shape: LatentShape) -> Result<(), GenerateError> {
        let Self { next, ref frames, references, in_place } = *self;
        let wrong = |expected: String, found: String| Err(GenerateError::Options { expected, found });
        let first = options.references();
        if !(first..=MAX_FRAMES).contains(&next) {
            return wrong(format!("{} as the next frame", shown(&(first..=MAX_FRAMES))), next.to_string());
        }
        let (count, name) = if next == first {
            (first, "reference frames")
        } else {
            (retained(options), "frames in the cache")
        };
        if frames.len() != count {
            return wrong(format!("{count} {name}"), frames.len().to_string());
        }
        let needed = references_at(options, next);
        if !needed.contains(&references) {
            return wrong(format!("{} references in the cache", shown(&needed)), references.to_string());
        }
        let needed = in_place_at(options, next);
        if !needed.contains(&in_place) {
            return wrong(format!("{} rolls in place in the cache", shown(&needed)), in_place.to_string());
        }
        if let Some(other) = frames.iter().map(Latent::shape).find(|other| *other != shape) {
            return wrong(format!("latents of {shape}"), other.to_string());
        }
        match frames.iter().flat_map(|frame| frame.values()).find(|value| !value.is_finite()) {
            Some(value) => wrong("finite latents in the cache".to_owned(), value.to_string()),
            None => Ok(()),
        }
    }
}

/// Number of frames that are retained from step to step.
fn retained(options: &GenerateOptions) -> usize {
    match options.strategy {
        Strategy::ResetAndRoll | Strategy::Rolling => options.window,
        Strategy::Causal { .. } | Strategy::NonCausal { .. } => options.references(),
    }
}

/// Valid values of [`Cache::references`] before a frame.
fn references_at(options: &GenerateOptions, next: usize) -> RangeInclusive<usize> {
    let all = options.references();
    match options.strategy {
        Strategy::ResetAndRoll => {
            // The first step fills the window; each further step drops one reference.
            let left = all.saturating_sub(next.saturating_sub(options.window)).max(options.clean);
            left..=left
        }
        Strategy::Rolling if next > all => options.clean..=all,
        _ => all..=all,
    }
}

/// Valid values of [`Cache::in_place`] before a frame.
fn in_place_at(options: &GenerateOptions, next: usize) -> RangeInclusive<usize> {
    let begun = options.strategy == Strategy::Rolling && next > options.references();
    0..=if begun { options.window - 1 } else { 0 }
}

fn shown(range: &RangeInclusive<usize>) -> String {
    let (start, end) = (range.start(), range.end());
    if start == end { start.to_string() } else { format!("{start} to {end}") }
}

fn wrong(found: impl ToString) -> CacheError {
    CacheError { found: found.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The product of these sizes overflows, but the leading zero hides that.
    #[test]
    fn rejects_frames_without_values() {
        let numbers = serde_json::to_string(&Numbers { next: 3, references: 3, in_place: 0 }).unwrap();
        let metadata = HashMap::from([(NUMBERS.to_owned(), numbers)]);
        let frames = TensorView::new(Dtype::F32, vec![0, 1 << 40, 1 << 40, 1, 1], &[]).unwrap();
        let bytes = serialize([(FRAMES, frames)], Some(metadata)).unwrap();
        let error = Cache::from_bytes(&bytes).unwrap_err().to_string();
        assert!(error.contains("found frames of [0, 1099511627776, 1099511627776, 1, 1]"), "{error}");
    }
}
