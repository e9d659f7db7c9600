//! Indices of vertices.

use std::ops::Range;
use std::sync::Arc;

use ash::vk;

use super::{Buffer, BufferDesc, Commands, Device, GpuError, Memory, Scope};

/// Indices of vertices on the device. They never change, so that a draw can tell that all vertices are there.
pub struct Indices {
    buffer: Buffer,
    count: u32,
    /// The greatest index and one.
    end: u32,
}

impl Indices {
    /// Uploads indices.
    ///
    /// # Errors
    /// Out of memory; an index that the device cannot take.
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

    /// How many vertices a draw may reach.
    pub(super) fn end(&self) -> u32 {
        self.end
    }

    /// That there are so many.
    pub(super) fn check(&self, range: &Range<u32>) -> Result<(), GpuError> {
        if range.end <= self.count {
            return Ok(());
        }
        let bytes = |count: u32| u64::from(count) * size_of::<u32>() as u64;
        Err(GpuError::Range { expected: bytes(range.end), found: bytes(self.count), name: "indices".into() })
    }
}

impl Buffer {
    /// A buffer of the device that holds some bytes, a multiple of 4.
    ///
    /// # Errors
    /// Out of memory.
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
