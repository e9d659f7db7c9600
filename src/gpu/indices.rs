//! Index buffers.

use std::ops::Range;
use std::sync::Arc;

use ash::vk;

use super::{Buffer, BufferDesc, Commands, Device, GpuError, Memory, Scope};

/// An immutable index buffer on the device, so that a draw can validate that all indexed vertices exist.
pub struct Indices {
    buffer: Buffer,
    count: u32,
    /// Largest index plus one.
    end: u32,
}

impl Indices {
    /// Uploads indices.
    ///
    /// # Errors
    /// Fails if memory is exhausted or an index exceeds the device's limit.
    pub fn new(device: &Arc<Device>, commands: &mut Commands, indices: &[u32]) -> Result<Self, GpuError> {
        let most = device.limits().max_draw_indexed_index_value.min(u32::MAX - 1);
        let greatest = indices.iter().copied().max();
        let last = u32::try_from(indices.len());
        let (Ok(count), true) = (last, greatest.is_none_or(|index| index <= most)) else {
            let expected = format!("{} indices up to {}", indices.len(), greatest.unwrap_or(0));
            return Err(device.unsupported(expected, format!("at most {most}")));
        };
        let usage = vk::BufferUsageFlags::INDEX_BUFFER;
        let buffer = Buffer::uploaded(device, commands, "indices", usage, bytemuck::cast_slice(indices))?;
        Ok(Self { buffer, count, end: greatest.map_or(0, |index| index + 1) })
    }

    pub(super) fn raw(&self) -> vk::Buffer {
        self.buffer.raw
    }

    /// Returns the number of vertices that a draw may access.
    pub(super) fn end(&self) -> u32 {
        self.end
    }

    /// Fails if the range exceeds the indices.
    pub(super) fn check(&self, range: &Range<u32>) -> Result<(), GpuError> {
        if range.end <= self.count {
            return Ok(());
        }
        let bytes = |count: u32| u64::from(count) * size_of::<u32>() as u64;
        Err(GpuError::Range { expected: bytes(range.end), found: bytes(self.count), name: "indices".into() })
    }
}

impl Buffer {
    /// Creates a device buffer from bytes, a multiple of 4.
    ///
    /// # Errors
    /// Fails if memory is exhausted.
    pub fn uploaded(
        device: &Arc<Device>,
        commands: &mut Commands,
        name: &str,
        usage: vk::BufferUsageFlags,
        bytes: &[u8],
    ) -> Result<Self, GpuError> {
        let size = (bytes.len() as u64).max(4);
        let (source, copied) = (vk::BufferUsageFlags::TRANSFER_SRC, vk::BufferUsageFlags::TRANSFER_DST);
        let desc = BufferDesc { name: "upload", size, usage: source, memory: Memory::Upload };
        let mut upload = Self::new(device, &desc)?;
        upload.bytes_mut()?[..bytes.len()].copy_from_slice(bytes);
        let desc = BufferDesc { name, size, usage: usage | copied, memory: Memory::Device };
        let buffer = Self::new(device, &desc)?;
        let mut recorder = commands.begin()?;
        recorder.copy((&upload, 0), (&buffer, 0), size)?;
        recorder.barrier(Scope::CopyWrite, Scope::ShaderRead);
        recorder.submit()?;
        Ok(buffer)
    }
}
