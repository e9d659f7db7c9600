use clap::Args;
use point_skeleton::raster::{self, CloudSet, Rasterizer, RasterizerDesc, RasterizerKind};

use super::names::names;
use crate::WrongUsage;

/// Rasterizer options, shared by all commands that render.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Rasterizer")]
pub(crate) struct RasterizerArgs {
    /// Rasterizer; all output the same maps
    #[arg(long, default_value_t, value_name = "KIND", value_parser = names::<RasterizerKind>())]
    pub(crate) rasterizer: RasterizerKind,
    /// Vulkan device: index, UUID (GPU-..), PCI address (0000:65:00.0) or part of the name [default:
    /// $PSKEL_DEVICE, else the fastest]
    #[arg(long, value_name = "DEVICE")]
    pub(crate) device: Option<String>,
    /// Device memory for points, MiB: 20 bytes per point with compute, 16 with graphics. Points that a camera
    /// may see are loaded, and the least recently seen ones evicted. Keys and maps need additional memory
    /// [default: as much as needed, 2048 on drivers that run on the processor]
    #[arg(long, value_name = "MIB")]
    pub(crate) gpu_memory: Option<u32>,
    /// Memory for points, MiB, 17 bytes per point (cpu only). Points that a camera may see are loaded, and
    /// the least recently seen ones evicted [default: 2048, or what a frame needs if that is more]
    #[arg(long, value_name = "MIB")]
    pub(crate) memory: Option<u32>,
    /// Also draw hidden points, to measure the effect of occlusion culling (cpu only)
    #[arg(long)]
    pub(crate) no_occlusion_culling: bool,
}

impl RasterizerArgs {
    /// Creates the rasterizer and passes the clouds to it.
    pub(crate) fn create<'a>(&self, clouds: CloudSet<'a>) -> anyhow::Result<Box<dyn Rasterizer + 'a>> {
        Ok(raster::create(&self.desc()?, clouds)?)
    }

    /// Returns the parameters of the rasterizer.
    pub(crate) fn desc(&self) -> Result<RasterizerDesc, WrongUsage> {
        let desc = RasterizerDesc {
            kind: self.rasterizer,
            device: self.device.clone(),
            memory_bytes: self.gpu_memory.map(|mib| u64::from(mib) << 20),
            host_memory_bytes: self.memory.map(|mib| u64::from(mib) << 20),
            occlusion_culling: !self.no_occlusion_culling,
        };
        match desc.unused().first() {
            None => Ok(desc),
            Some(name) => {
                let kind = self.rasterizer;
                Err(WrongUsage(format!("expected no --{name} with --rasterizer {kind}, found one")))
            }
        }
    }
}
