//! Line drawing on Vulkan's fixed-function pipeline, tile by tile.

use std::sync::Arc;
use std::time::Instant;

use super::line::{LineInstance, LineStage, LineTarget};
use super::tiles::{Tile, TileLimits, grown, tiles};
use super::{Segment, StageTimes};
use crate::gpu::{Buffer, Commands, Device, GpuError};

/// What draws lines: images are kept from call to call.
pub(super) struct Lines {
    device: Arc<Device>,
    commands: Commands,
    stage: LineStage,
    target: Option<LineTarget>,
    /// Room for segments.
    segments: Option<Buffer>,
    limits: TileLimits,
}

impl Lines {
    pub(super) fn new(device: &Arc<Device>, limits: TileLimits) -> Result<Self, GpuError> {
        let (stage, commands) = (LineStage::new(device)?, Commands::new(device)?);
        Ok(Self { device: device.clone(), commands, stage, target: None, segments: None, limits })
    }

    /// As [`Rasterizer::lines`](super::Rasterizer::lines).
    pub(super) fn draw(
        &mut self,
        [height, width]: [u32; 2],
        segments: &[Segment],
        width_px: f32,
        stages: &mut StageTimes,
    ) -> Result<Vec<[u8; 3]>, GpuError> {
        let mut image = vec![[0; 3]; width as usize * height as usize];
        let half_width = width_px / 2.0;
        let lines: Vec<_> =
            segments.iter().filter_map(|s| LineInstance::new(s, half_width, [width, height])).collect();
        let tiles = tiles(width, height, self.limits);
        let Some(largest) = tiles.first().filter(|_| !lines.is_empty()) else { return Ok(image) };
        self.prepare(largest.size, &lines)?;
        for tile in &tiles {
            self.draw_tile(tile, lines.len() as u32, &mut image, width, stages)?;
        }
        Ok(image)
    }

    /// Makes an image and a buffer if those there are too small, and fills the buffer.
    fn prepare(&mut self, size: [u32; 2], lines: &[LineInstance]) -> Result<(), GpuError> {
        let current = self.target.as_ref().map_or([0; 2], LineTarget::size);
        if size[0] > current[0] || size[1] > current[1] {
            self.target = None; // free before allocating
            self.target = Some(self.stage.target(&self.device, grown(current, size, self.limits))?);
        }
        let bytes: &[u8] = bytemuck::cast_slice(lines);
        let buffer = match self.segments.take().filter(|b| b.size() >= bytes.len() as u64) {
            Some(buffer) => buffer,
            None => LineStage::buffer(&self.device, lines.len().next_power_of_two())?,
        };
        self.segments.insert(buffer).bytes_mut()?[..bytes.len()].copy_from_slice(bytes);
        Ok(())
    }

    fn draw_tile(
        &mut self,
        tile: &Tile,
        count: u32,
        image: &mut [[u8; 3]],
        width: u32,
        stages: &mut StageTimes,
    ) -> Result<(), GpuError> {
        let (Some(target), Some(segments)) = (&mut self.target, &self.segments) else { return Ok(()) };
        let mut recorder = self.commands.begin()?;
        self.stage.record(&mut recorder, target, tile, (segments, count))?;
        for (stage, time) in recorder.submit()? {
            stages.add(stage, time);
        }
        let start = Instant::now();
        let rgba = &target.readback.bytes_mut()?[..4 * tile.area()];
        let pixels: Vec<[u8; 3]> = rgba.chunks_exact(4).map(|p| [p[0], p[1], p[2]]).collect();
        tile.copy_into(&pixels, image, width);
        stages.add("lines to host", start.elapsed());
        Ok(())
    }
}
