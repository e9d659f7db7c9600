//! Condition maps of one step: rendering, reduction and writers.
//!
//! # How it works
//! [`render()`] splats the color and the geometry cloud of the condition contract
//! ([`SceneInstances`](crate::scene::SceneInstances)) into every camera, draws the layouts of boxes and HD
//! map, and reduces the maps to the model's size ([`reduce`]). [`distort`] applies the lens distortion of
//! recorded images. [`tensor`] encodes the maps as network input. In memory an empty depth is
//! `f32::INFINITY`; −300 occurs only in files.
//!
//! Writers: [`write::png`], [`write::exr`], [`write::npz`], [`write::safetensors`], the contact
//! [`view::sheet`], the bird's-eye view ([`birdseye`]) and the metadata ([`write::meta`]). See
//! `docs/src/reference/maps.md` for the map definitions.

pub mod bins;
pub mod birdseye;
mod captions;
pub mod distort;
mod error;
pub mod layout;
mod memory;
mod options;
pub mod reduce;
mod render;
mod set;
pub mod tensor;
pub mod view;
pub mod write;

pub use bins::{BinScale, DepthBins};
pub use captions::{Captions, FrameCaptions, Prompts};
pub use error::ConditionError;
pub use layout::{LayoutLayers, LayoutStyle, LineWidth};
pub use memory::check_memory;
pub use options::{ColorFilter, ConditionOptions};
pub use render::{StepInFlight, draw_layouts, render, render_views};
pub use set::{CameraConditions, ConditionSet, MapPixels};
pub use tensor::{DepthEmbedding, ModelTensor, TensorEncoder};
pub use write::format::MapFormat;

pub use crate::geometry::{ImageSize, ParseOptionError};
pub use crate::raster::{MapKind, MapSet, Occlusion};

/// Value of an empty depth in files, meters.
pub const EMPTY_DEPTH_M: f32 = -300.0;
