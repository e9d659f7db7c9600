//! Compiled shaders and their reflection by `build.rs`.

use std::ffi::CStr;
use std::sync::Arc;

use ash::vk;

use crate::gpu::error::call;
use crate::gpu::{Device, GpuError};

/// A compiled shader.
#[derive(Clone, Copy, Debug)]
pub struct Shader {
    /// File name below `glsl/`.
    pub name: &'static str,
    /// Entry point.
    pub entry: &'static CStr,
    /// Pipeline stage.
    pub stage: Stage,
    /// Size of the push constants, bytes; 0 for none.
    pub push_size: u32,
    /// Descriptors in use.
    pub bindings: &'static [Binding],
    /// Vertex attributes.
    pub inputs: &'static [Input],
    /// Invocations per workgroup; zeros for other stages than compute.
    pub workgroup: [u32; 3],
    /// SPIR-V words.
    pub words: &'static [u32],
}

/// Pipeline stage of a shader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Vertex shader.
    Vertex,
    /// Fragment shader.
    Fragment,
    /// Compute shader.
    Compute,
}

/// A descriptor in use by a shader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Binding {
    /// Descriptor set.
    pub set: u32,
    /// Binding number.
    pub binding: u32,
    /// Descriptor type.
    pub kind: BindingKind,
}

/// Descriptor type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BindingKind {
    /// Uniform buffer.
    Uniform,
    /// Storage buffer.
    Storage,
    /// Image read without a sampler.
    SampledImage,
    /// Image for reads and writes.
    StorageImage,
}

/// A vertex attribute.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Input {
    /// Location.
    pub location: u32,
    /// Type.
    pub format: InputFormat,
}

/// Type of a vertex attribute.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum InputFormat {
    F32x1,
    F32x2,
    F32x3,
    F32x4,
    U32x1,
    U32x2,
    U32x3,
    U32x4,
}

/// One module per shader: `SHADER`, and for each named struct its `SIZE` and the offset of each member,
/// bytes.
pub mod shaders {
    use crate::gpu::pipeline::shader::{Binding, BindingKind, Input, InputFormat, Shader, Stage};
    include!(concat!(env!("OUT_DIR"), "/shaders.rs"));
}

/// Asserts at compile time that the members of a `#[repr(C)]` struct have the shader's offsets:
/// `assert_layout!(Push, shaders::x_vert::push, [a: A, b: B])`.
#[macro_export]
macro_rules! assert_layout {
    ($rust:ty, $($module:ident)::+, [$($member:ident: $offset:ident),+ $(,)?]) => {
        const _: () = {
            use $($module)::+ as layout;
            assert!(size_of::<$rust>() == layout::SIZE);
            $(assert!(std::mem::offset_of!($rust, $member) == layout::$offset);)+
        };
    };
}
pub use assert_layout;

impl Stage {
    pub(in super::super) fn flag(self) -> vk::ShaderStageFlags {
        match self {
            Self::Vertex => vk::ShaderStageFlags::VERTEX,
            Self::Fragment => vk::ShaderStageFlags::FRAGMENT,
            Self::Compute => vk::ShaderStageFlags::COMPUTE,
        }
    }
}

impl BindingKind {
    pub(in super::super) fn descriptor(self) -> vk::DescriptorType {
        match self {
            Self::Uniform => vk::DescriptorType::UNIFORM_BUFFER,
            Self::Storage => vk::DescriptorType::STORAGE_BUFFER,
            Self::SampledImage => vk::DescriptorType::SAMPLED_IMAGE,
            Self::StorageImage => vk::DescriptorType::STORAGE_IMAGE,
        }
    }
}

impl InputFormat {
    pub(in super::super) fn format(self) -> vk::Format {
        match self {
            Self::F32x1 => vk::Format::R32_SFLOAT,
            Self::F32x2 => vk::Format::R32G32_SFLOAT,
            Self::F32x3 => vk::Format::R32G32B32_SFLOAT,
            Self::F32x4 => vk::Format::R32G32B32A32_SFLOAT,
            Self::U32x1 => vk::Format::R32_UINT,
            Self::U32x2 => vk::Format::R32G32_UINT,
            Self::U32x3 => vk::Format::R32G32B32_UINT,
            Self::U32x4 => vk::Format::R32G32B32A32_UINT,
        }
    }
}

/// A shader module; needed only until its pipelines are created.
pub(in super::super) struct ShaderModule {
    device: Arc<Device>,
    raw: vk::ShaderModule,
    shader: &'static Shader,
}

impl ShaderModule {
    pub(in super::super) fn new(device: &Arc<Device>, shader: &'static Shader) -> Result<Self, GpuError> {
        let info = vk::ShaderModuleCreateInfo::default().code(shader.words);
        // SAFETY: the words are SPIR-V that was validated at build time.
        let raw = unsafe { device.calls().create_shader_module(&info, None) };
        let raw = raw.map_err(call("vkCreateShaderModule"))?;
        let module = Self { device: device.clone(), raw, shader };
        device.set_name(raw, shader.name)?;
        Ok(module)
    }

    pub(in super::super) fn stage(&self) -> vk::PipelineShaderStageCreateInfo<'_> {
        vk::PipelineShaderStageCreateInfo::default()
            .stage(self.shader.stage.flag())
            .module(self.raw)
            .name(self.shader.entry)
    }
}

impl Drop for ShaderModule {
    fn drop(&mut self) {
        // SAFETY: pipelines do not need their modules after creation.
        unsafe { self.device.calls().destroy_shader_module(self.raw, None) };
    }
}
