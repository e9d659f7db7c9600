//! Resources shared by all frames in flight: pipelines, points and visibility buffers.

use std::sync::Arc;

use ash::vk::{self, BufferUsageFlags as Usage, ImageUsageFlags};

use super::project::ProjectStage;
use super::resolve::ResolveStage;
use super::spread::SpreadStage;
use super::store::Store;
use crate::gpu::{Buffer, BufferDesc, Commands, Device, GpuError, Image, ImageDesc, Memory};

/// Width of the image over a visibility buffer in texels of two keys, and its row size in bytes.
const KEY_IMAGE_WIDTH: u32 = 4096;
pub(super) const KEY_IMAGE_ROW_BYTES: u64 = KEY_IMAGE_WIDTH as u64 * 16;
/// The height of such an image is a multiple of this.
const ROW_STEP: u32 = 4;
/// Granularity of a visibility buffer's size, bytes.
pub(super) const KEY_STEP_BYTES: u64 = KEY_IMAGE_ROW_BYTES * ROW_STEP as u64;

/// A visibility buffer: key `depth << 32 | number` of the nearest point per pixel.
pub(super) struct KeyLayer {
    pub(super) buffer: Arc<Buffer>,
    /// Image over the same keys for reading, two pixels per texel.
    pub(super) image: Arc<Image>,
    /// Whether the image has its own memory, so that keys must be copied.
    pub(super) copied: bool,
}

/// Available or required capacity for keys.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct KeyCapacity {
    pub(super) layers: usize,
    /// Size of each layer, bytes.
    pub(super) bytes: u64,
    /// Whether there are window buffers for spreading keys.
    pub(super) windows: bool,
}

impl KeyCapacity {
    /// Returns a capacity that covers both.
    pub(super) fn grown(self, other: Self) -> Self {
        Self {
            layers: self.layers.max(other.layers),
            bytes: self.bytes.max(other.bytes),
            windows: self.windows || other.windows,
        }
    }
}

/// Resources of all frames; never changed while a frame is in flight.
pub(super) struct Shared {
    pub(super) project: Arc<ProjectStage>,
    pub(super) spread: Arc<SpreadStage>,
    pub(super) full: Arc<ResolveStage>,
    pub(super) reduced: Arc<ResolveStage>,
    pub(super) store: Arc<Store>,
    pub(super) layers: Vec<KeyLayer>,
    /// Minimum keys of windows, ping-ponged between passes: each as large as a layer.
    pub(super) windows: Option<[Arc<Buffer>; 2]>,
    pub(super) room: KeyCapacity,
    /// Number of times the visibility buffers were recreated.
    pub(super) generation: u64,
    /// Number of chunks streamed at once.
    pub(super) streamed_rows: u32,
}

impl Shared {
    /// Returns the same resources with other visibility buffers.
    pub(super) fn with_keys(
        &self,
        device: &Arc<Device>,
        commands: &mut Commands,
        room: KeyCapacity,
        copied: bool,
    ) -> Result<Self, GpuError> {
        let rows = room.bytes.div_ceil(KEY_IMAGE_ROW_BYTES) as u32;
        let rows = rows.max(1).next_multiple_of(ROW_STEP);
        let bytes = KEY_IMAGE_ROW_BYTES * u64::from(rows);
        let layer = |_| KeyLayer::new(device, commands, rows, copied);
        let windows = || {
            let (name, usage, memory) = ("windows of keys", Usage::STORAGE_BUFFER, Memory::Device);
            Buffer::new(device, &BufferDesc { name, size: bytes, usage, memory }).map(Arc::new)
        };
        Ok(Self {
            project: self.project.clone(),
            spread: self.spread.clone(),
            full: self.full.clone(),
            reduced: self.reduced.clone(),
            store: self.store.clone(),
            layers: (0..room.layers).map(layer).collect::<Result<_, _>>()?,
            windows: if room.windows { Some([windows()?, windows()?]) } else { None },
            room: KeyCapacity { bytes, ..room },
            generation: self.generation + 1,
            streamed_rows: self.streamed_rows,
        })
    }
}

impl KeyLayer {
    fn new(device: &Arc<Device>, commands: &mut Commands, rows: u32, copied: bool) -> Result<Self, GpuError> {
        let size = KEY_IMAGE_ROW_BYTES * u64::from(rows);
        let usage = Usage::STORAGE_BUFFER | Usage::TRANSFER_DST | Usage::TRANSFER_SRC;
        let buffer =
            Arc::new(Buffer::new(device, &BufferDesc { name: "keys", size, usage, memory: Memory::Device })?);
        let desc = ImageDesc {
            name: "keys as an image",
            width: KEY_IMAGE_WIDTH,
            height: rows,
            layers: None,
            format: vk::Format::R32G32B32A32_UINT,
            usage: ImageUsageFlags::SAMPLED,
        };
        let over = if copied { None } else { Image::over_buffer(&buffer, &desc)? };
        let mut recorder = commands.begin()?;
        let copied = over.is_none();
        let image = match over {
            Some(image) => image,
            None => Image::new(
                device,
                &ImageDesc { usage: ImageUsageFlags::SAMPLED | ImageUsageFlags::TRANSFER_DST, ..desc },
            )?,
        };
        if copied {
            recorder.forget(&image);
        } else {
            recorder.adopt(&image);
        }
        recorder.submit()?;
        Ok(Self { buffer, image: Arc::new(image), copied })
    }
}
