//! Buffers, with memory chosen by access.

use std::ops::{Deref, DerefMut};
use std::sync::Arc;
use std::sync::atomic::{AtomicI32, Ordering};

use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::Allocation;

use super::error::call;
use super::{Device, GpuError};

/// Which side accesses a buffer's memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Memory {
    /// Device only.
    Device,
    /// Host writes, device reads.
    Upload,
    /// Device writes, host reads (cached).
    Readback,
}

/// Parameters of a buffer to create.
#[derive(Clone, Debug)]
pub struct BufferDesc<'a> {
    /// Name in validation messages.
    pub name: &'a str,
    /// Size, bytes.
    pub size: u64,
    /// Allowed uses.
    pub usage: vk::BufferUsageFlags,
    /// Which side accesses its memory.
    pub memory: Memory,
}

/// A buffer and its memory.
pub struct Buffer {
    device: Arc<Device>,
    pub(super) raw: vk::Buffer,
    size: u64,
    name: String,
    memory: Memory,
    /// Bit mask of the memory types that its memory may come from.
    memory_types: u32,
    allocation: Option<Allocation>,
    users: Arc<HostAccess>,
}

/// Host/device access state of a buffer's memory: [`HostAccess::HOST`] while mapped, else the number of
/// pending submits.
#[derive(Debug, Default)]
pub(super) struct HostAccess(AtomicI32);

impl HostAccess {
    const HOST: i32 = -1;

    /// Registers one more pending submit; returns `false` if the host has the memory mapped.
    pub(super) fn enter(&self) -> bool {
        let more = |users: i32| (users != Self::HOST).then_some(users + 1);
        self.0.fetch_update(Ordering::AcqRel, Ordering::Acquire, more).is_ok()
    }

    pub(super) fn leave(&self) {
        self.0.fetch_sub(1, Ordering::AcqRel);
    }
}

impl Buffer {
    /// Creates a buffer with undefined contents.
    ///
    /// # Errors
    /// Fails if memory is exhausted or the size exceeds the device's limits.
    pub fn new(device: &Arc<Device>, desc: &BufferDesc<'_>) -> Result<Self, GpuError> {
        let info = vk::BufferCreateInfo::default().size(desc.size).usage(desc.usage);
        // SAFETY: the create info contains no pointers; the call or the validation layer reports an invalid
        // one.
        let raw = unsafe { device.calls().create_buffer(&info, None) }.map_err(call("vkCreateBuffer"))?;
        let (device, name, memory) = (device.clone(), desc.name.to_owned(), desc.memory);
        let mut buffer = Self {
            device,
            raw,
            size: desc.size,
            name,
            memory,
            memory_types: 0,
            allocation: None,
            users: Arc::default(),
        };
        let device = &buffer.device;
        device.set_name(raw, desc.name)?;
        // SAFETY: the buffer is alive.
        let needs = unsafe { device.calls().get_buffer_memory_requirements(raw) };
        buffer.memory_types = needs.memory_type_bits;
        let device = &buffer.device;
        let location = match desc.memory {
            Memory::Device => MemoryLocation::GpuOnly,
            Memory::Upload => MemoryLocation::CpuToGpu,
            Memory::Readback => MemoryLocation::GpuToCpu,
        };
        let allocation = buffer.allocation.insert(device.allocate(desc.name, needs, location, true)?);
        // SAFETY: only used for binding, and the allocation outlives the buffer (see `drop`).
        let memory = unsafe { allocation.memory() };
        // SAFETY: the range was allocated for these requirements and is bound once.
        let bound = unsafe { device.calls().bind_buffer_memory(raw, memory, allocation.offset()) };
        bound.map_err(call("vkBindBufferMemory"))?;
        Ok(buffer)
    }

    /// Returns the size in bytes.
    pub fn size(&self) -> u64 {
        self.size
    }

    pub(super) fn device(&self) -> &Arc<Device> {
        &self.device
    }

    /// Returns its memory and its offset there, bytes, if a resource with these requirements can alias it.
    pub(super) fn memory_for(&self, needs: &vk::MemoryRequirements) -> Option<(vk::DeviceMemory, u64)> {
        let allocation = self.allocation.as_ref()?;
        let (offset, size) = (allocation.offset(), allocation.size());
        let fits = needs.size <= size
            && offset.is_multiple_of(needs.alignment)
            && needs.memory_type_bits & self.memory_types == self.memory_types;
        // SAFETY: the caller binds it to an image that owns a reference to this buffer.
        let memory = unsafe { allocation.memory() };
        fits.then_some((memory, offset))
    }

    /// Fails if the buffer is smaller than `expected` bytes.
    pub(super) fn check(&self, expected: u64) -> Result<(), GpuError> {
        if expected <= self.size {
            return Ok(());
        }
        Err(GpuError::Range { expected, found: self.size, name: self.name.clone() })
    }

    /// Maps the host memory of a shared buffer.
    ///
    /// # Errors
    /// Returns [`GpuError::Range`] for device-only memory, and [`GpuError::Busy`] while a submit uses the
    /// buffer or it is already mapped.
    pub fn map(&self) -> Result<Mapped<'_>, GpuError> {
        let (expected, name) = (self.size, self.name.clone());
        // Some drivers map all memory, but only the other kinds are coherent.
        let allocation = self.allocation.as_ref().filter(|_| self.memory != Memory::Device);
        let pointer = allocation.and_then(Allocation::mapped_ptr);
        let Some(pointer) = pointer else { return Err(GpuError::Range { expected, found: 0, name }) };
        let taken = self.users.0.compare_exchange(0, HostAccess::HOST, Ordering::AcqRel, Ordering::Acquire);
        taken.map_err(|_| GpuError::Busy { name })?;
        // SAFETY: the allocation is mapped as long as the buffer lives and has at least `size` bytes; no
        // other access exists, since `users` marks the host as the only user.
        let bytes = unsafe { std::slice::from_raw_parts_mut(pointer.as_ptr().cast(), self.size as usize) };
        Ok(Mapped { bytes, users: &self.users })
    }

    /// Returns the access state for submits that use the buffer; `None` if the memory is device-only.
    pub(super) fn users(&self) -> Option<Arc<HostAccess>> {
        (self.memory != Memory::Device).then(|| self.users.clone())
    }

    /// Returns the host memory for the device to read later. `&mut` excludes commands that use the buffer.
    ///
    /// # Errors
    /// Returns [`GpuError::Range`] for device-only memory.
    pub fn bytes_mut(&mut self) -> Result<&mut [u8], GpuError> {
        let (size, name) = (self.size, &self.name);
        // Some drivers map all memory, but only the other kinds are coherent.
        let allocation = self.allocation.as_mut().filter(|_| self.memory != Memory::Device);
        let mapped = allocation.and_then(Allocation::mapped_slice_mut);
        let bytes = mapped.and_then(|bytes| bytes.get_mut(..size as usize));
        bytes.ok_or_else(|| GpuError::Range { expected: size, found: 0, name: name.clone() })
    }
}

/// A buffer's bytes, mapped for exclusive access by the host.
pub struct Mapped<'a> {
    bytes: &'a mut [u8],
    users: &'a HostAccess,
}

impl Deref for Mapped<'_> {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        self.bytes
    }
}

impl DerefMut for Mapped<'_> {
    fn deref_mut(&mut self) -> &mut [u8] {
        self.bytes
    }
}

impl Drop for Mapped<'_> {
    fn drop(&mut self) {
        self.users.0.store(0, Ordering::Release);
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        // SAFETY: no commands use it, since recorders borrow it and submits are waited for.
        unsafe { self.device.calls().destroy_buffer(self.raw, None) };
        if let Some(allocation) = self.allocation.take() {
            self.device.free(allocation);
        }
    }
}
