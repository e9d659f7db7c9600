//! Descriptor sets: the resources bound to a shader.

use std::sync::Arc;

use ash::vk;

use crate::gpu::buffer::HostAccess;
use crate::gpu::error::call;
use crate::gpu::{BindingKind, Buffer, Device, GpuError, Image, PipelineLayout};

/// Resource behind one binding.
#[derive(Clone)]
pub enum Bind {
    /// A whole buffer.
    Buffer(Arc<Buffer>),
    /// An image in its read layout.
    Image(Arc<Image>),
}

/// A descriptor set that owns its resources.
pub struct DescriptorSet {
    device: Arc<Device>,
    pool: vk::DescriptorPool,
    pub(in super::super) raw: vk::DescriptorSet,
    binds: Vec<Bind>,
}

impl DescriptorSet {
    /// Creates set number `set` of a layout, with `binds` in the order of the bindings.
    ///
    /// # Errors
    /// Fails if memory is exhausted. Returns [`GpuError::Unsupported`] if the resources do not match the
    /// shader's bindings or exceed a limit.
    pub fn new(layout: &PipelineLayout, set: u32, binds: Vec<Bind>) -> Result<Self, GpuError> {
        let device = layout.device();
        let bindings: Vec<_> = layout.bindings().iter().filter(|b| b.set == set).copied().collect();
        if bindings.len() != binds.len() {
            let expected = format!("{} resources in descriptor set {set}", bindings.len());
            return Err(device.unsupported(expected, binds.len().to_string()));
        }
        let size =
            |b: &crate::gpu::Binding| vk::DescriptorPoolSize { ty: b.kind.descriptor(), descriptor_count: 1 };
        let sizes: Vec<_> = bindings.iter().map(size).collect();
        let info = vk::DescriptorPoolCreateInfo::default().max_sets(1).pool_sizes(&sizes);
        // SAFETY: `info` and what it points to live until after the call.
        let pool = unsafe { device.calls().create_descriptor_pool(&info, None) };
        let pool = pool.map_err(call("vkCreateDescriptorPool"))?;
        let raw = vk::DescriptorSet::null();
        let mut made = Self { device: device.clone(), pool, raw, binds: Vec::new() };
        let layouts = [layout.set(set)?];
        let info = vk::DescriptorSetAllocateInfo::default().descriptor_pool(pool).set_layouts(&layouts);
        // SAFETY: the pool has room for exactly this set.
        let sets = unsafe { device.calls().allocate_descriptor_sets(&info) };
        made.raw = sets.map_err(call("vkAllocateDescriptorSets"))?[0];
        for (binding, bind) in bindings.iter().zip(&binds) {
            made.write(binding.binding, binding.kind, bind)?;
        }
        made.binds = binds;
        device.count_descriptor_set();
        Ok(made)
    }

    /// Returns the access states of its host-visible buffers.
    pub(in super::super) fn users(&self) -> impl Iterator<Item = Arc<HostAccess>> {
        self.binds.iter().filter_map(|bind| match bind {
            Bind::Buffer(buffer) => buffer.users(),
            Bind::Image(_) => None,
        })
    }

    fn write(&self, binding: u32, kind: BindingKind, bind: &Bind) -> Result<(), GpuError> {
        let write = vk::WriteDescriptorSet::default()
            .dst_set(self.raw)
            .dst_binding(binding)
            .descriptor_type(kind.descriptor());
        let (buffer, image);
        let write = match (kind, bind) {
            (BindingKind::Uniform | BindingKind::Storage, Bind::Buffer(b)) => {
                self.check_size(kind, b)?;
                buffer = [vk::DescriptorBufferInfo { buffer: b.raw, offset: 0, range: vk::WHOLE_SIZE }];
                write.buffer_info(&buffer)
            }
            (BindingKind::SampledImage | BindingKind::StorageImage, Bind::Image(i)) => {
                image = [vk::DescriptorImageInfo::default().image_view(i.view).image_layout(i.read_layout)];
                write.image_info(&image)
            }
            _ => {
                let found = if matches!(bind, Bind::Buffer(_)) { "a buffer" } else { "an image" };
                return Err(self.device.unsupported(format!("{kind:?} at binding {binding}"), found));
            }
        };
        // SAFETY: the set is new and unused; buffers and images are alive and owned by the set from here on.
        unsafe { self.device.calls().update_descriptor_sets(&[write], &[]) };
        Ok(())
    }

    fn check_size(&self, kind: BindingKind, buffer: &Buffer) -> Result<(), GpuError> {
        let limits = self.device.limits();
        let max = match kind {
            BindingKind::Uniform => limits.max_uniform_buffer_range,
            _ => limits.max_storage_buffer_range,
        };
        if buffer.size() > u64::from(max) {
            return Err(self.device.unsupported(
                format!("{} bytes in one {kind:?} buffer", buffer.size()),
                format!("at most {max}"),
            ));
        }
        Ok(())
    }
}

impl Drop for DescriptorSet {
    fn drop(&mut self) {
        // SAFETY: no commands use the set (recorders borrow it, submits are waited for); destroying the pool
        // frees it.
        unsafe { self.device.calls().destroy_descriptor_pool(self.pool, None) };
    }
}
