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
mod device;
mod error;
mod image;
mod indices;
mod mapping;
mod pipeline;
#[cfg(test)]
mod tests;

pub use buffer::{Buffer, BufferDesc, Mapped, Memory};
pub use commands::draw::Pass;
pub(crate) use commands::flight::PendingSubmit;
pub use commands::pass::{Area, Depth, DepthTest, RenderPass, RenderPassDesc, Target};
pub use commands::{Commands, Recorder, Scope};
pub use device::select::DeviceDesc;
pub use device::validation::Messages;
pub use device::{Device, ObjectCounts};
pub use error::GpuError;
pub use image::{Image, ImageDesc};
pub use indices::Indices;
pub use mapping::MappedFile;
pub use pipeline::descriptor::{Bind, DescriptorSet};
pub use pipeline::shader::{Binding, BindingKind, Input, InputFormat, Shader, Stage, shaders};
pub use pipeline::{
    ComputePipeline, GraphicsPipeline, GraphicsPipelineDesc, PipelineLayout, Topology, VertexBuffer,
};

pub use pipeline::shader::assert_layout;
