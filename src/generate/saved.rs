use std::collections::HashMap;

use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};
use serde::{Deserialize, Serialize};

use super::{Cache, Latent, LatentShape};

/// What is saved beside the latents.
#[derive(Serialize, Deserialize)]
struct Numbers {
    next: usize,
    references: usize,
    in_place: usize,
}

/// Bytes that are no saved cache.
#[derive(Debug, thiserror::Error)]
#[error("expected a saved cache of the generator, found {found}")]
pub struct CacheError {
    /// What is wrong with them.
    pub found: String,
}

const FRAMES: &str = "frames";
const NUMBERS: &str = "cache";

impl Cache {
    /// As safetensors: `frames` of `[L, V, C, h, w]`, f32.
    ///
    /// # Errors
    /// Frames of several shapes.
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

    /// What was saved.
    ///
    /// # Errors
    /// Anything else.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CacheError> {
        let (_, head) = SafeTensors::read_metadata(bytes).map_err(wrong)?;
        let numbers = head.metadata().as_ref().and_then(|all| all.get(NUMBERS));
        let numbers: Numbers = serde_json::from_str(numbers.map_or("", String::as_str)).map_err(wrong)?;
        let tensors = SafeTensors::deserialize(bytes).map_err(wrong)?;
        let frames = tensors.tensor(FRAMES).map_err(wrong)?;
        let &[_, views, channels, height, width] = frames.shape() else {
            return Err(wrong(format!("frames of {:?}", frames.shape())));
        };
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
}

fn wrong(found: impl ToString) -> CacheError {
    CacheError { found: found.to_string() }
}
