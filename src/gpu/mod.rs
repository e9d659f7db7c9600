//! Headless Vulkan 1.1: devices, buffers, images, pipelines and command recording.
//!
//! # How it works
//! All `unsafe` code of the crate is in this module. Its public interface is safe:
//! - Every object holds an `Arc` of its [`Device`] and destroys itself on `Drop`, also on error paths.
//! - A [`Recorder`] borrows the resources that it records, [`DescriptorSet`]s own the resources that they
//!   bind, and [`Recorder::submit`] waits for the device. No resource is freed or read while it is in use.
//! - A `PendingSubmit` does not wait. It owns its resources until they are waited for, and host memory in use
//!   by a submit cannot be mapped ([`Buffer::map`]).
//! - `build.rs` compiles the shaders. Layouts of descriptors, push constants and vertex inputs come from its
//!   reflection of them ([`shaders`]).
//!
//! Any number of threads may open, use and close devices. The validation layer alone does not support that,
//! so instances and devices are created and destroyed while no other call is inside the layer (`gate`).
//!
//! With [`DeviceDesc::validation`] every submit fails on any message of the validation layer about its
//! device.
//!
//! Memory-mapped files ([`MappedFile`]) are part of this module because they need `unsafe`, and because a
//! device can import the memory of a mapped file.
#![allow(unsafe_code)]

mod buffer;
mod commands;
mod descriptor;
mod device;
mod draw;
mod drivers;
mod error;
mod flight;
mod fork;
mod gate;
mod identity;
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
pub use device::{Device, ObjectCounts};
pub use draw::Pass;
pub use error::GpuError;
pub(crate) use flight::PendingSubmit;
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

pub use shader::assert_layout;
