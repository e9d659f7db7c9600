//! Buffers, with memory by intent.

use std::ops::{Deref, DerefMut};
use std::sync::Arc;
use std::sync::atomic::{AtomicI32, Ordering};

use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::Allocation;

use super::error::call;
use super::{Device, GpuError};

/// Who reaches a buffer's memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Memory {
    /// The device alone.
    Device,
    /// The host writes, the device reads.
    Upload,
    /// The device writes, the host reads (cached).
    Readback,
}

/// A buffer to be made.
#[derive(Clone, Debug)]
pub struct BufferDesc<'a> {
    /// What validation messages call it.
    pub name: &'a str,
    /// Bytes.
    pub size: u64,
    /// What it is used for.
    pub usage: vk::BufferUsageFlags,
    /// Who reaches it.
    pub memory: Memory,
}

/// A buffer and its memory.
pub struct Buffer {
    device: Arc<Device>,
    pub(super) raw: vk::Buffer,
    size: u64,
    name: String,
    memory: Memory,
    /// Bits of the memory types it may have been given.
    memory_types: u32,
    allocation: Option<Allocation>,
    users: Arc<Users>,
}

/// Who is at a buffer's host memory now: the host ([`Users::HOST`]), or so many submits.
#[derive(Debug, Default)]
pub(super) struct Users(AtomicI32);

impl Users {
    const HOST: i32 = -1;

    /// One more submit uses the memory, unless the host has it.
    pub(super) fn enter(&self) -> bool {
        let more = |users: i32| (users != Self::HOST).then_some(users + 1);
        self.0.fetch_update(Ordering::AcqRel, Ordering::Acquire, more).is_ok()
    }

    pub(super) fn leave(&self) {
        self.0.fetch_sub(1, Ordering::AcqRel);
    }
}

impl Buffer {
    /// Makes a buffer; its content is undefined.
    ///
    /// # Errors
    /// Out of memory, or a size over the device's limits.
    pub fn new(device: &Arc<Device>, desc: &BufferDesc<'_>) -> Result<Self, GpuError> {
        let info = vk::BufferCreateInfo::default().size(desc.size).usage(desc.usage);
        // SAFETY: a plain description; a bad one is reported by the call or by the validation layer.
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

    /// Bytes.
    pub fn size(&self) -> u64 {
        self.size
    }

    pub(super) fn device(&self) -> &Arc<Device> {
        &self.device
    }

    /// Its memory and where it begins there, if something with these needs can lie over it.
    pub(super) fn memory_for(&self, needs: &vk::MemoryRequirements) -> Option<(vk::DeviceMemory, u64)> {
        let allocation = self.allocation.as_ref()?;
        let (offset, size) = (allocation.offset(), allocation.size());
        let fits = needs.size <= size
            && offset.is_multiple_of(needs.alignment)
            && needs.memory_type_bits & self.memory_types == self.memory_types;
        // SAFETY: the caller binds it to an image that keeps this buffer.
        let memory = unsafe { allocation.memory() };
        fits.then_some((memory, offset))
    }

    /// Whether the buffer has this many bytes.
    pub(super) fn check(&self, expected: u64) -> Result<(), GpuError> {
        if expected <= self.size {
            return Ok(());
        }
        Err(GpuError::Range { expected, found: self.size, name: self.name.clone() })
    }

    /// The host memory of a buffer that others hold as well.
    ///
    /// # Errors
    /// [`GpuError::Range`] for memory of the device alone, [`GpuError::Busy`] while a submit uses the buffer or it is
    /// mapped already.
    pub fn map(&self) -> Result<Mapped<'_>, GpuError> {
        let (expected, name) = (self.size, self.name.clone());
        // Some drivers map all memory, but only that of the other kinds is coherent.
        let allocation = self.allocation.as_ref().filter(|_| self.memory != Memory::Device);
        let pointer = allocation.and_then(Allocation::mapped_ptr);
        let Some(pointer) = pointer else { return Err(GpuError::Range { expected, found: 0, name }) };
        let taken = self.users.0.compare_exchange(0, Users::HOST, Ordering::AcqRel, Ordering::Acquire);
        taken.map_err(|_| GpuError::Busy { name })?;
        // SAFETY: the allocation is mapped as long as the buffer lives and has at least `size` bytes; nobody else
        // uses them, since `users` says that the host does.
        let bytes = unsafe { std::slice::from_raw_parts_mut(pointer.as_ptr().cast(), self.size as usize) };
        Ok(Mapped { bytes, users: &self.users })
    }

    /// For submits that use the buffer; `None` if the host never sees its memory.
    pub(super) fn users(&self) -> Option<Arc<Users>> {
        (self.memory != Memory::Device).then(|| self.users.clone())
    }

    /// Host memory for the device to read later. `&mut` keeps commands that use the buffer away.
    ///
    /// # Errors
    /// [`GpuError::Range`] for memory of the device alone.
    pub fn bytes_mut(&mut self) -> Result<&mut [u8], GpuError> {
        let (size, name) = (self.size, &self.name);
        // Some drivers map all memory, but only that of the other kinds is coherent.
        let allocation = self.allocation.as_mut().filter(|_| self.memory != Memory::Device);
        let mapped = allocation.and_then(Allocation::mapped_slice_mut);
        let bytes = mapped.and_then(|bytes| bytes.get_mut(..size as usize));
        bytes.ok_or_else(|| GpuError::Range { expected: size, found: 0, name: name.clone() })
    }
}

/// A buffer's bytes in the hands of the host.
pub struct Mapped<'a> {
    bytes: &'a mut [u8],
    users: &'a Users,
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
