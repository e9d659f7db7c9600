//! Command recording and submission.

pub(super) mod draw;
pub(super) mod flight;
pub(super) mod pass;
pub(super) mod timer;

use std::ops::Range;
use std::sync::Arc;
use std::time::{Duration, Instant};

use ash::vk;

use self::timer::Timer;
use super::buffer::HostAccess;
use super::device::gate::Calls;
use super::error::call;
use super::image::aspect;
use super::{Buffer, ComputePipeline, DescriptorSet, Device, GpuError, Image, PipelineLayout};

/// One reusable command buffer with its fence and timestamps.
pub struct Commands {
    device: Arc<Device>,
    pool: vk::CommandPool,
    raw: vk::CommandBuffer,
    fence: vk::Fence,
    timer: Option<Timer>,
}

impl Commands {
    /// Creates a command buffer.
    ///
    /// # Errors
    /// Fails if memory is exhausted.
    pub fn new(device: &Arc<Device>) -> Result<Self, GpuError> {
        let info = vk::CommandPoolCreateInfo::default().queue_family_index(device.queue_family);
        // SAFETY: the family is the device's own.
        let pool = unsafe { device.calls().create_command_pool(&info, None) };
        let pool = pool.map_err(call("vkCreateCommandPool"))?;
        let (raw, fence) = (vk::CommandBuffer::null(), vk::Fence::null());
        let mut commands = Self { device: device.clone(), pool, raw, fence, timer: None };
        let info = vk::CommandBufferAllocateInfo::default().command_pool(pool).command_buffer_count(1);
        // SAFETY: the pool is alive and used by no other code.
        let raw = unsafe { device.calls().allocate_command_buffers(&info) };
        commands.raw = raw.map_err(call("vkAllocateCommandBuffers"))?[0];
        // SAFETY: the create info contains no pointers.
        let fence = unsafe { device.calls().create_fence(&vk::FenceCreateInfo::default(), None) };
        commands.fence = fence.map_err(call("vkCreateFence"))?;
        commands.timer = Timer::new(device)?;
        Ok(commands)
    }

    /// Resets the command buffer and starts recording. Recorded resources are borrowed until the commands
    /// complete.
    ///
    /// # Errors
    /// Fails if memory is exhausted.
    pub fn begin(&mut self) -> Result<Recorder<'_>, GpuError> {
        let flags = vk::CommandPoolResetFlags::empty();
        // SAFETY: no command buffer of the pool is pending, since every submit is waited for.
        unsafe { self.device.calls().reset_command_pool(self.pool, flags) }
            .map_err(call("vkResetCommandPool"))?;
        let flags = vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT;
        let info = vk::CommandBufferBeginInfo::default().flags(flags);
        // SAFETY: the command buffer was just reset.
        let begun = unsafe { self.device.calls().begin_command_buffer(self.raw, &info) };
        begun.map_err(call("vkBeginCommandBuffer"))?;
        if let Some(timer) = &self.timer {
            // SAFETY: recording; the pool has `Timer::MAX` queries.
            unsafe { self.device.calls().cmd_reset_query_pool(self.raw, timer.pool, 0, Timer::MAX) };
            let stage = vk::PipelineStageFlags::TOP_OF_PIPE;
            // SAFETY: recording; query 0 was just reset.
            unsafe { self.device.calls().cmd_write_timestamp(self.raw, stage, timer.pool, 0) };
        }
        Ok(Recorder { commands: self, stages: Vec::new(), users: Vec::new() })
    }

    /// Waits for a submit of these commands. Returns the duration of each stage.
    pub(super) fn wait(&mut self, submitted: Submitted) -> Result<Vec<(&'static str, Duration)>, GpuError> {
        self.device.wait(self.fence)?;
        submitted.users.iter().for_each(|users| users.leave());
        let stages = submitted.stages;
        let Some(timer) = &self.timer else { return Ok(vec![("gpu", submitted.start.elapsed())]) };
        Ok(stages.iter().copied().zip(timer.durations(stages.len())?).collect())
    }
}

impl Drop for Commands {
    fn drop(&mut self) {
        // SAFETY: nothing is pending, since every submit is waited for; null is ignored.
        unsafe { self.device.calls().destroy_fence(self.fence, None) };
        // SAFETY: as above; destroying the pool frees the command buffer.
        unsafe { self.device.calls().destroy_command_pool(self.pool, None) };
    }
}

/// Accesses on either side of a barrier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// Writes by copies, fills and updates.
    CopyWrite,
    /// Reads by copies.
    CopyRead,
    /// Reads of vertices and indices, and reads by shaders of any stage.
    ShaderRead,
    /// Reads and writes by compute shaders.
    Compute,
    /// Reads by the host after the submit.
    Host,
}

impl Scope {
    fn masks(self) -> (vk::PipelineStageFlags, vk::AccessFlags) {
        use vk::{AccessFlags as Access, PipelineStageFlags as At};
        match self {
            Self::CopyWrite => (At::TRANSFER, Access::TRANSFER_WRITE),
            Self::CopyRead => (At::TRANSFER, Access::TRANSFER_READ),
            Self::ShaderRead => (
                At::VERTEX_INPUT | At::VERTEX_SHADER | At::FRAGMENT_SHADER | At::COMPUTE_SHADER,
                Access::VERTEX_ATTRIBUTE_READ
                    | Access::INDEX_READ
                    | Access::UNIFORM_READ
                    | Access::SHADER_READ,
            ),
            Self::Compute => (At::COMPUTE_SHADER, Access::SHADER_READ | Access::SHADER_WRITE),
            Self::Host => (At::HOST, Access::HOST_READ),
        }
    }
}

/// A command buffer being recorded. Dropping it without [`Recorder::submit`] discards the commands.
pub struct Recorder<'a> {
    commands: &'a mut Commands,
    stages: Vec<&'static str>,
    /// Access states of the host-visible buffers in use.
    users: Vec<Arc<HostAccess>>,
}

/// A submit that has not been waited for.
pub(super) struct Submitted {
    stages: Vec<&'static str>,
    users: Vec<Arc<HostAccess>>,
    start: Instant,
}

impl<'a> Recorder<'a> {
    /// Ends a stage and measures its time since the previous stamp. At most 15 per submit; further ones are
    /// ignored.
    pub fn stamp(&mut self, stage: &'static str) {
        let query = self.stages.len() as u32 + 1;
        let Some(timer) = self.commands.timer.as_ref().filter(|_| query < Timer::MAX) else { return };
        let at = vk::PipelineStageFlags::BOTTOM_OF_PIPE;
        // SAFETY: recording outside a pass; the query was reset and is written once.
        unsafe { self.device().cmd_write_timestamp(self.raw(), at, timer.pool, query) };
        self.stages.push(stage);
    }

    /// Makes earlier accesses of `before` complete and visible to later accesses of `after`.
    pub fn barrier(&mut self, before: Scope, after: Scope) {
        let ((src_stage, src), (dst_stage, dst)) = (before.masks(), after.masks());
        let barriers = [vk::MemoryBarrier::default().src_access_mask(src).dst_access_mask(dst)];
        let flags = vk::DependencyFlags::empty();
        // SAFETY: recording outside a pass; the stages exist on a graphics and compute queue.
        unsafe {
            self.device().cmd_pipeline_barrier(self.raw(), src_stage, dst_stage, flags, &barriers, &[], &[]);
        }
    }

    /// Writes host data into a device buffer. Both the offset and the length are multiples of 4 bytes.
    ///
    /// # Errors
    /// Fails if the buffer is too small.
    pub fn update(&mut self, buffer: &'a Buffer, offset: u64, data: &[u8]) -> Result<(), GpuError> {
        const MAX: usize = 65_536;
        self.uses(buffer);
        buffer.check(offset + data.len() as u64)?;
        for (i, part) in data.chunks(MAX).enumerate() {
            let at = offset + (i * MAX) as u64;
            // SAFETY: recording outside a pass; the range is inside the buffer.
            unsafe { self.device().cmd_update_buffer(self.raw(), buffer.raw, at, part) };
        }
        Ok(())
    }

    /// Fills a range of a buffer with a repeated word. Offset and size are multiples of 4 bytes.
    ///
    /// # Errors
    /// Fails if the buffer is too small.
    pub fn fill(&mut self, buffer: &'a Buffer, offset: u64, size: u64, word: u32) -> Result<(), GpuError> {
        self.uses(buffer);
        buffer.check(offset + size)?;
        // SAFETY: recording outside a pass; the range is inside the buffer.
        unsafe { self.device().cmd_fill_buffer(self.raw(), buffer.raw, offset, size, word) };
        Ok(())
    }

    /// Prepares an image for [`Recorder::write_rows`] and discards its contents.
    pub(crate) fn forget(&mut self, image: &'a Image) {
        self.transition(image, vk::ImageLayout::UNDEFINED, vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL);
    }

    /// Copies whole rows from a buffer into one layer of an image that shaders read. Requires one earlier
    /// [`Recorder::forget`] of the image.
    ///
    /// # Errors
    /// Fails if the image or the buffer is too small.
    pub(crate) fn write_rows(
        &mut self,
        (from, offset): (&'a Buffer, u64),
        to: &'a Image,
        layer: u32,
        rows: Range<u32>,
    ) -> Result<(), GpuError> {
        self.uses(from);
        let row_bytes = u64::from(to.width()) * to.pixel_bytes();
        from.check(offset + row_bytes * u64::from(rows.end.saturating_sub(rows.start)))?;
        if rows.end > to.height() || layer >= to.layers() {
            let (expected, found) = (row_bytes * u64::from(rows.end), row_bytes * u64::from(to.height()));
            return Err(GpuError::Range { expected, found, name: "an image".into() });
        }
        let read = vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL;
        self.transition(to, read, vk::ImageLayout::TRANSFER_DST_OPTIMAL);
        let layers = vk::ImageSubresourceLayers::default()
            .aspect_mask(aspect(to.format))
            .base_array_layer(layer)
            .layer_count(1);
        let regions = [vk::BufferImageCopy::default()
            .buffer_offset(offset)
            .image_subresource(layers)
            .image_offset(vk::Offset3D { x: 0, y: rows.start as i32, z: 0 })
            .image_extent(vk::Extent3D { width: to.width(), height: rows.end - rows.start, depth: 1 })];
        let layout = vk::ImageLayout::TRANSFER_DST_OPTIMAL;
        // SAFETY: recording outside a pass; the region is inside the image and the buffer.
        unsafe { self.device().cmd_copy_buffer_to_image(self.raw(), from.raw, to.raw, layout, &regions) };
        self.transition(to, layout, read);
        Ok(())
    }

    /// Transitions an image over a buffer to its read layout; needed once, before the first write to the
    /// buffer.
    pub(crate) fn adopt(&mut self, image: &'a Image) {
        self.transition(image, vk::ImageLayout::UNDEFINED, image.read_layout);
    }

    /// Records a layout transition with a barrier between reads by compute shaders and copies.
    fn transition(&mut self, image: &'a Image, old: vk::ImageLayout, new: vk::ImageLayout) {
        use vk::{AccessFlags as Access, PipelineStageFlags as At};
        let to_copy = new == vk::ImageLayout::TRANSFER_DST_OPTIMAL;
        let (before, after) =
            ((At::COMPUTE_SHADER, Access::SHADER_READ), (At::TRANSFER, Access::TRANSFER_WRITE));
        let ((src_stage, src), (dst_stage, dst)) = if to_copy { (before, after) } else { (after, before) };
        let barriers = [vk::ImageMemoryBarrier::default()
            .src_access_mask(src)
            .dst_access_mask(dst)
            .old_layout(old)
            .new_layout(new)
            .src_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .dst_queue_family_index(vk::QUEUE_FAMILY_IGNORED)
            .image(image.raw)
            .subresource_range(super::image::whole(image.format))];
        let flags = vk::DependencyFlags::empty();
        // SAFETY: recording outside a pass; the image is alive and in the old layout, or its contents are
        // discarded.
        unsafe {
            self.device().cmd_pipeline_barrier(self.raw(), src_stage, dst_stage, flags, &[], &[], &barriers);
        }
    }

    /// Copies `size` bytes between buffers.
    ///
    /// # Errors
    /// Fails if one of the buffers is too small.
    pub fn copy(
        &mut self,
        (from, src_offset): (&'a Buffer, u64),
        (to, dst_offset): (&'a Buffer, u64),
        size: u64,
    ) -> Result<(), GpuError> {
        self.uses(from);
        self.uses(to);
        from.check(src_offset + size)?;
        to.check(dst_offset + size)?;
        let regions = [vk::BufferCopy { src_offset, dst_offset, size }];
        // SAFETY: recording outside a pass; the ranges are inside the buffers.
        unsafe { self.device().cmd_copy_buffer(self.raw(), from.raw, to.raw, &regions) };
        Ok(())
    }

    /// Copies the top left `width × height` pixels of an image to the start of a buffer, as tightly packed
    /// rows. The image's pass must leave it in the transfer source layout.
    ///
    /// # Errors
    /// Fails if the image or the buffer is too small.
    pub fn copy_image(
        &mut self,
        from: &'a Image,
        [width, height]: [u32; 2],
        to: &'a Buffer,
    ) -> Result<(), GpuError> {
        self.uses(to);
        let pixel = from.pixel_bytes();
        let (bytes, inside) = (pixel * u64::from(width) * u64::from(height), pixel * u64::from(from.width()));
        to.check(bytes)?;
        if width > from.width() || height > from.height() {
            let found = inside * u64::from(from.height());
            return Err(GpuError::Range { expected: bytes, found, name: "an image".into() });
        }
        let layers = vk::ImageSubresourceLayers::default().aspect_mask(aspect(from.format)).layer_count(1);
        let regions = [vk::BufferImageCopy::default().image_subresource(layers).image_extent(vk::Extent3D {
            width,
            height,
            depth: 1,
        })];
        let layout = vk::ImageLayout::TRANSFER_SRC_OPTIMAL;
        // SAFETY: recording outside a pass; the region is inside the image and the buffer.
        unsafe { self.device().cmd_copy_image_to_buffer(self.raw(), from.raw, layout, to.raw, &regions) };
        Ok(())
    }

    /// Runs a compute pipeline with enough workgroups for `size` invocations.
    ///
    /// # Errors
    /// Fails if the push constants do not have the shader's size.
    pub fn dispatch(
        &mut self,
        pipeline: &'a ComputePipeline,
        sets: &[&'a DescriptorSet],
        push: &[u8],
        size: [u32; 2],
    ) -> Result<(), GpuError> {
        let [x, y, _] = pipeline.workgroup.map(|side| side.max(1));
        self.dispatch_groups(pipeline, sets, push, [size[0].div_ceil(x), size[1].div_ceil(y), 1])
    }

    /// Runs a compute pipeline with the given number of workgroups.
    ///
    /// # Errors
    /// Fails if the push constants do not have the shader's size.
    pub(crate) fn dispatch_groups(
        &mut self,
        pipeline: &'a ComputePipeline,
        sets: &[&'a DescriptorSet],
        push: &[u8],
        groups: [u32; 3],
    ) -> Result<(), GpuError> {
        let point = vk::PipelineBindPoint::COMPUTE;
        // SAFETY: recording outside a pass; the pipeline is alive.
        unsafe { self.device().cmd_bind_pipeline(self.raw(), point, pipeline.raw) };
        self.bind_sets(point, &pipeline.layout, sets);
        self.push_constants(&pipeline.layout, push)?;
        // SAFETY: pipeline, sets and push constants are bound.
        unsafe { self.device().cmd_dispatch(self.raw(), groups[0], groups[1], groups[2]) };
        Ok(())
    }

    /// Submits the recorded commands and waits for them. Returns the duration of each stage; without
    /// timestamps one total, named `gpu`.
    ///
    /// # Errors
    /// Fails if the device is lost or out of memory, if the validation layer reports any message, or if the
    /// host has one of the buffers mapped.
    pub fn submit(self) -> Result<Vec<(&'static str, Duration)>, GpuError> {
        let (commands, submitted) = self.start()?;
        commands.wait(submitted)
    }

    /// Submits the recorded commands without waiting. The caller keeps all recorded resources alive until
    /// [`Commands::wait`] returns.
    pub(super) fn start(self) -> Result<(&'a mut Commands, Submitted), GpuError> {
        let start = Instant::now();
        let Self { commands, stages, users } = self;
        // SAFETY: recording outside a pass.
        unsafe { commands.device.calls().end_command_buffer(commands.raw) }
            .map_err(call("vkEndCommandBuffer"))?;
        let entered = users.iter().take_while(|users| users.enter()).count();
        let submitted = if entered == users.len() {
            commands.device.submit(commands.raw, commands.fence)
        } else {
            Err(GpuError::Busy { name: "a buffer of a submit".into() })
        };
        if let Err(error) = submitted {
            users[..entered].iter().for_each(|users| users.leave());
            return Err(error);
        }
        Ok((commands, Submitted { stages, users, start }))
    }

    pub(super) fn uses(&mut self, buffer: &Buffer) {
        self.users.extend(buffer.users());
    }

    pub(super) fn bind_sets(
        &mut self,
        point: vk::PipelineBindPoint,
        layout: &PipelineLayout,
        sets: &[&'a DescriptorSet],
    ) {
        if sets.is_empty() {
            return;
        }
        self.users.extend(sets.iter().flat_map(|set| set.users()));
        let sets: Vec<_> = sets.iter().map(|set| set.raw).collect();
        // SAFETY: recording; the sets were created for this layout, and the recorder borrows them.
        unsafe { self.device().cmd_bind_descriptor_sets(self.raw(), point, layout.raw, 0, &sets, &[]) };
    }

    pub(super) fn push_constants(&self, layout: &PipelineLayout, push: &[u8]) -> Result<(), GpuError> {
        if push.len() != layout.push_size as usize {
            let (expected, found) = (u64::from(layout.push_size), push.len() as u64);
            return Err(GpuError::Range { expected, found, name: "push constants".into() });
        }
        if !push.is_empty() {
            let stages = layout.push_stages;
            // SAFETY: recording; the range is the layout's own.
            unsafe { self.device().cmd_push_constants(self.raw(), layout.raw, stages, 0, push) };
        }
        Ok(())
    }

    pub(super) fn device(&self) -> Calls<'_, ash::Device> {
        self.commands.device.calls()
    }

    pub(super) fn raw(&self) -> vk::CommandBuffer {
        self.commands.raw
    }
}
