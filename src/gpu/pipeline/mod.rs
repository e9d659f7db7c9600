//! Pipelines. They do not depend on the size of images: viewport and scissor are dynamic.

pub(super) mod descriptor;
pub(super) mod shader;

use std::collections::BTreeMap;
use std::sync::Arc;

use ash::vk;

use self::shader::ShaderModule;
use super::error::call;
use super::{Binding, DepthTest, Device, GpuError, RenderPass, Shader};

/// Descriptor set layouts and push constants of a pipeline's shaders, as reflected by `build.rs`.
pub struct PipelineLayout {
    device: Arc<Device>,
    pub(super) raw: vk::PipelineLayout,
    sets: Vec<vk::DescriptorSetLayout>,
    bindings: Vec<Binding>,
    pub(super) push_stages: vk::ShaderStageFlags,
    pub(super) push_size: u32,
}

impl PipelineLayout {
    /// Creates the layout of shaders that run together. All shaders with push constants share one block.
    ///
    /// # Errors
    /// Fails if memory is exhausted.
    pub fn new(device: &Arc<Device>, shaders: &[&'static Shader]) -> Result<Self, GpuError> {
        let pushing = || shaders.iter().filter(|s| s.push_size > 0);
        let mut layout = Self {
            device: device.clone(),
            raw: vk::PipelineLayout::null(),
            sets: Vec::new(),
            bindings: Vec::new(),
            push_stages: pushing().map(|s| s.stage.flag()).fold(vk::ShaderStageFlags::empty(), |a, b| a | b),
            push_size: pushing().map(|s| s.push_size).max().unwrap_or(0),
        };
        // Sorted by set, then by binding.
        let mut all = BTreeMap::new();
        for shader in shaders {
            for binding in shader.bindings {
                let stages = shader.stage.flag();
                let entry = all.entry((binding.set, binding.binding)).or_insert((*binding, stages));
                entry.1 |= stages;
            }
        }
        layout.bindings = all.values().map(|(binding, _)| *binding).collect();
        let set_count = all.keys().map(|(set, _)| set + 1).max().unwrap_or(0);
        for set in 0..set_count {
            let bindings: Vec<_> = all.values().filter(|(b, _)| b.set == set).map(layout_binding).collect();
            let info = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
            // SAFETY: `info` and what it points to live until after the call.
            let raw = unsafe { device.calls().create_descriptor_set_layout(&info, None) };
            layout.sets.push(raw.map_err(call("vkCreateDescriptorSetLayout"))?);
        }
        let push =
            vk::PushConstantRange { stage_flags: layout.push_stages, offset: 0, size: layout.push_size };
        let pushes = if layout.push_size > 0 { vec![push] } else { Vec::new() };
        let info =
            vk::PipelineLayoutCreateInfo::default().set_layouts(&layout.sets).push_constant_ranges(&pushes);
        // SAFETY: `info` and what it points to live until after the call.
        let raw = unsafe { device.calls().create_pipeline_layout(&info, None) };
        layout.raw = raw.map_err(call("vkCreatePipelineLayout"))?;
        Ok(layout)
    }

    pub(super) fn device(&self) -> &Arc<Device> {
        &self.device
    }

    pub(super) fn bindings(&self) -> &[Binding] {
        &self.bindings
    }

    pub(super) fn set(&self, set: u32) -> Result<vk::DescriptorSetLayout, GpuError> {
        let found =
            || self.device.unsupported(format!("a descriptor set {set}"), self.sets.len().to_string());
        self.sets.get(set as usize).copied().ok_or_else(found)
    }
}

fn layout_binding(
    (binding, stages): &(Binding, vk::ShaderStageFlags),
) -> vk::DescriptorSetLayoutBinding<'static> {
    vk::DescriptorSetLayoutBinding::default()
        .binding(binding.binding)
        .descriptor_type(binding.kind.descriptor())
        .descriptor_count(1)
        .stage_flags(*stages)
}

impl Drop for PipelineLayout {
    fn drop(&mut self) {
        // SAFETY: pipelines and recorders that use it hold or borrow it; null is ignored.
        unsafe { self.device.calls().destroy_pipeline_layout(self.raw, None) };
        for set in &self.sets {
            // SAFETY: descriptor sets may outlive the layout that they were created from.
            unsafe { self.device.calls().destroy_descriptor_set_layout(*set, None) };
        }
    }
}

/// Primitive topology.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Topology {
    /// A point per vertex.
    Points,
    /// A strip of triangles.
    TriangleStrip,
    /// A triangle per three vertices.
    Triangles,
}

/// Vertex layout in a buffer.
#[derive(Clone, Copy, Debug)]
pub struct VertexBuffer<'a> {
    /// Stride, bytes.
    pub stride: u32,
    /// Whether the data advances per instance instead of per vertex.
    pub per_instance: bool,
    /// Offset of each input by its location, bytes.
    pub offsets: &'a [u32],
}

/// Parameters of a graphics pipeline: opaque, no face culling; tests depth if the pass has a depth
/// attachment.
pub struct GraphicsPipelineDesc<'a> {
    /// Name in validation messages.
    pub name: &'a str,
    /// Layout of both shaders.
    pub layout: &'a Arc<PipelineLayout>,
    /// Vertex shader.
    pub vertex: &'static Shader,
    /// Fragment shader.
    pub fragment: &'static Shader,
    /// Render pass that it draws in.
    pub pass: &'a Arc<RenderPass>,
    /// Primitive topology.
    pub topology: Topology,
    /// Vertex layout; `None` for a vertex shader without inputs.
    pub vertices: Option<VertexBuffer<'a>>,
}

/// A graphics pipeline.
pub struct GraphicsPipeline {
    pub(super) layout: Arc<PipelineLayout>,
    pub(super) raw: vk::Pipeline,
    /// Stride of the vertex buffer, bytes; `None` if there is none.
    pub(super) stride: Option<u32>,
    pub(super) per_instance: bool,
}

impl GraphicsPipeline {
    /// Compiles a pipeline.
    ///
    /// # Errors
    /// Fails if memory is exhausted or a vertex input has no offset.
    pub fn new(desc: &GraphicsPipelineDesc<'_>) -> Result<Self, GpuError> {
        let device = &desc.layout.device;
        let modules = [ShaderModule::new(device, desc.vertex)?, ShaderModule::new(device, desc.fragment)?];
        let stages = [modules[0].stage(), modules[1].stage()];
        let attributes = attributes(device, desc)?;
        let per_instance = desc.vertices.is_some_and(|v| v.per_instance);
        let input_rate =
            if per_instance { vk::VertexInputRate::INSTANCE } else { vk::VertexInputRate::VERTEX };
        let stride = desc.vertices.map(|v| v.stride);
        let binding = |stride| vk::VertexInputBindingDescription { binding: 0, stride, input_rate };
        let bindings: Vec<_> = stride.map(binding).into_iter().collect();
        let input = vk::PipelineVertexInputStateCreateInfo::default()
            .vertex_binding_descriptions(&bindings)
            .vertex_attribute_descriptions(&attributes);
        let assembly = vk::PipelineInputAssemblyStateCreateInfo::default().topology(match desc.topology {
            Topology::Points => vk::PrimitiveTopology::POINT_LIST,
            Topology::TriangleStrip => vk::PrimitiveTopology::TRIANGLE_STRIP,
            Topology::Triangles => vk::PrimitiveTopology::TRIANGLE_LIST,
        });
        let viewport = vk::PipelineViewportStateCreateInfo::default().viewport_count(1).scissor_count(1);
        let raster = vk::PipelineRasterizationStateCreateInfo::default().line_width(1.0);
        let samples = vk::PipelineMultisampleStateCreateInfo::default()
            .rasterization_samples(vk::SampleCountFlags::TYPE_1);
        let depth = depth_state(desc.pass.depth);
        let mask = vk::ColorComponentFlags::RGBA;
        let opaque = vk::PipelineColorBlendAttachmentState::default().color_write_mask(mask);
        let blends = vec![opaque; desc.pass.colors];
        let blend = vk::PipelineColorBlendStateCreateInfo::default().attachments(&blends);
        let dynamics = [vk::DynamicState::VIEWPORT, vk::DynamicState::SCISSOR];
        let dynamic = vk::PipelineDynamicStateCreateInfo::default().dynamic_states(&dynamics);
        let info = vk::GraphicsPipelineCreateInfo::default()
            .stages(&stages)
            .vertex_input_state(&input)
            .input_assembly_state(&assembly)
            .viewport_state(&viewport)
            .rasterization_state(&raster)
            .multisample_state(&samples)
            .depth_stencil_state(&depth)
            .color_blend_state(&blend)
            .dynamic_state(&dynamic)
            .layout(desc.layout.raw)
            .render_pass(desc.pass.raw);
        // SAFETY: `info` and what it points to live until after the call.
        let made =
            unsafe { device.calls().create_graphics_pipelines(vk::PipelineCache::null(), &[info], None) };
        let raw = made.map_err(|(_, e)| e).map_err(call("vkCreateGraphicsPipelines"))?[0];
        let pipeline = Self { layout: desc.layout.clone(), raw, stride, per_instance };
        device.set_name(raw, desc.name)?;
        device.count_pipeline();
        Ok(pipeline)
    }

    /// Returns its layout.
    pub fn layout(&self) -> &Arc<PipelineLayout> {
        &self.layout
    }
}

fn depth_state(test: Option<DepthTest>) -> vk::PipelineDepthStencilStateCreateInfo<'static> {
    let compare = match test {
        None | Some(DepthTest::Less) => vk::CompareOp::LESS,
        Some(DepthTest::Greater) => vk::CompareOp::GREATER,
        Some(DepthTest::Equal) => vk::CompareOp::EQUAL,
    };
    vk::PipelineDepthStencilStateCreateInfo::default()
        .depth_test_enable(test.is_some())
        .depth_write_enable(matches!(test, Some(DepthTest::Less | DepthTest::Greater)))
        .depth_compare_op(compare)
}

fn attributes(
    device: &Device,
    desc: &GraphicsPipelineDesc<'_>,
) -> Result<Vec<vk::VertexInputAttributeDescription>, GpuError> {
    let attribute = |input: &super::Input| {
        let missing = || device.unsupported(format!("an offset of input {}", input.location), "none");
        let offsets = desc.vertices.map_or(&[][..], |v| v.offsets);
        let offset = *offsets.get(input.location as usize).ok_or_else(missing)?;
        let (location, format) = (input.location, input.format.format());
        Ok(vk::VertexInputAttributeDescription { location, binding: 0, format, offset })
    };
    desc.vertex.inputs.iter().map(attribute).collect()
}

impl Drop for GraphicsPipeline {
    fn drop(&mut self) {
        // SAFETY: no commands use it (recorders borrow it, submits are waited for).
        unsafe { self.layout.device.calls().destroy_pipeline(self.raw, None) };
    }
}

/// A compute pipeline.
pub struct ComputePipeline {
    pub(super) layout: Arc<PipelineLayout>,
    pub(super) raw: vk::Pipeline,
    /// Invocations per workgroup.
    pub workgroup: [u32; 3],
}

impl ComputePipeline {
    /// Compiles a pipeline.
    ///
    /// # Errors
    /// Fails if memory is exhausted.
    pub fn new(device: &Arc<Device>, shader: &'static Shader) -> Result<Self, GpuError> {
        let layout = Arc::new(PipelineLayout::new(device, &[shader])?);
        let module = ShaderModule::new(device, shader)?;
        let info = vk::ComputePipelineCreateInfo::default().stage(module.stage()).layout(layout.raw);
        // SAFETY: `info` and what it points to live until after the call.
        let made =
            unsafe { device.calls().create_compute_pipelines(vk::PipelineCache::null(), &[info], None) };
        let raw = made.map_err(|(_, e)| e).map_err(call("vkCreateComputePipelines"))?[0];
        let pipeline = Self { layout, raw, workgroup: shader.workgroup };
        device.set_name(raw, shader.name)?;
        device.count_pipeline();
        Ok(pipeline)
    }

    /// Returns its layout.
    pub fn layout(&self) -> &Arc<PipelineLayout> {
        &self.layout
    }
}

impl Drop for ComputePipeline {
    fn drop(&mut self) {
        // SAFETY: no commands use it (recorders borrow it, submits are waited for).
        unsafe { self.layout.device.calls().destroy_pipeline(self.raw, None) };
    }
}
