//! Vulkan 1.1, headless: devices, buffers, images, pipelines, recorded commands.
//!
//! # How it works
//! This is the only place with `unsafe`. What it hands out is safe to use:
//! - every object holds an `Arc` of its [`Device`] and destroys itself on `Drop`, also on error paths;
//! - a [`Recorder`] borrows what it records for as long as it lives, [`DescriptorSet`]s own what they bind, and
//!   [`Recorder::submit`] waits until the device is done; so nothing can be freed or read while it is in use;
//! - a [`Flight`] does not wait, but keeps what it runs on until it is waited for; host memory that a submit uses
//!   cannot be mapped meanwhile ([`Buffer::map`]);
//! - shaders are compiled by `build.rs`, and layouts of descriptors, push constants and vertex inputs come from
//!   what it found in them ([`shaders`]).
//!
//! Devices may be opened, used and closed on any number of threads. The validation layer does not stand that by itself, so
//! instances and devices are created and destroyed while no other call is inside of it (`gate`).
//!
//! With [`DeviceDesc::validation`] every submit fails on any message of the validation layer about its device.
//!
//! Memory-mapped files ([`MappedFile`]) are here as well: they need `unsafe`, and a mapped file is memory that a
//! device can import.
#![allow(unsafe_code)]

mod buffer;
mod commands;
mod descriptor;
mod device;
mod draw;
mod error;
mod flight;
mod gate;
mod image;
mod indices;
mod instance;
mod mapping;
mod pass;
mod pipeline;
mod select;
mod shader;
#[cfg(test)]
mod tests;
mod timer;
mod validation;

pub use buffer::{Buffer, BufferDesc, Mapped, Memory};
pub use commands::{Commands, Recorder, Scope};
pub use descriptor::{Bind, DescriptorSet};
pub use device::{Device, Made};
pub use draw::Pass;
pub use error::GpuError;
pub use flight::Flight;
pub use image::{Image, ImageDesc};
pub use indices::Indices;
pub use mapping::MappedFile;
pub use pass::{Area, Depth, DepthTest, RenderPass, RenderPassDesc, Target};
pub use pipeline::{
    ComputePipeline, GraphicsPipeline, GraphicsPipelineDesc, PipelineLayout, Topology, VertexBuffer,
};
pub use select::DeviceDesc;
pub use shader::{Binding, BindingKind, Input, InputFormat, Shader, Stage, shaders};
pub use validation::Messages;

pub(crate) use shader::assert_layout;
