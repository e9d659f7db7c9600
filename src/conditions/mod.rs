//! Condition maps of one step: made, reduced, written.
//!
//! # How it works
//! [`render()`] splats the two clouds of the condition contract (color and geometry, [`SceneInstances`](crate::scene::SceneInstances)) into every
//! camera, draws the layouts of boxes and HD map, and reduces the maps to the size of the model ([`reduce`]).
//! [`distort`] makes them look like recorded images. Within the program an empty depth is `f32::INFINITY`; −300 stands
//! only in files. What networks are fed is made of these maps ([`tensor`]). Writers: [`png`], [`exr`], [`npz`],
//! [`safetensors`], the contact [`sheet`], a picture from above ([`birdseye`]) and the metadata ([`meta`]). What every map
//! means stands in `docs/CONDITIONS.md`.

mod arrays;
pub mod bins;
pub mod birdseye;
pub(crate) mod canvas;
pub mod distort;
mod error;
pub mod exr;
pub mod layout;
pub mod meta;
pub mod npz;
mod options;
mod pil;
pub mod png;
pub mod reduce;
mod render;
pub mod safetensors;
pub mod sheet;
pub mod tensor;
#[cfg(test)]
mod test_set;

pub use bins::{BinScale, DepthBins};
pub use error::ConditionError;
pub use options::{ColorFilter, ConditionOptions, MapKind, MapSet};
pub use render::{Begun, CameraConditions, ConditionSet, render, render_views};
pub use tensor::{DepthEmbedding, ModelTensor, TensorEncoder};

pub use crate::geometry::{ImageSize, ParseOptionError};
pub use crate::raster::Occlusion;

/// What stands for an empty depth in files, metres.
pub const EMPTY_DEPTH_M: f32 = -300.0;
