use anyhow::bail;
use clap::{Args, ValueEnum};

use crate::raster::cpu::CpuRasterizer;
use crate::raster::{CloudSet, Rasterizer};

/// Which rasterizer draws, shared by all commands that draw.
#[derive(Clone, Debug, Args)]
pub(super) struct RasterizerArgs {
    /// What draws; all of them give the same maps
    #[arg(long, value_enum, default_value_t, value_name = "KIND")]
    pub(super) rasterizer: RasterizerKind,
    /// Vulkan device by index or by part of its name [default: the fastest]
    #[arg(long, value_name = "NAME|INDEX")]
    pub(super) device: Option<String>,
}

/// A kind of rasterizer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(super) enum RasterizerKind {
    /// The fastest that there is
    #[default]
    Auto,
    /// Points drawn by the graphics pipeline
    Raster,
    /// Plain Rust, needs no driver
    Cpu,
}

impl RasterizerArgs {
    /// Makes the rasterizer and gives it its clouds.
    pub(super) fn create<'a>(&self, clouds: CloudSet<'a>) -> anyhow::Result<Box<dyn Rasterizer + 'a>> {
        match self.rasterizer {
            RasterizerKind::Auto | RasterizerKind::Cpu if self.device.is_none() => {
                Ok(Box::new(CpuRasterizer::new(clouds)))
            }
            RasterizerKind::Cpu => bail!("expected no --device with --rasterizer cpu, found one"),
            RasterizerKind::Auto | RasterizerKind::Raster => {
                bail!("expected --rasterizer cpu without --device (this build has no Vulkan rasterizer)")
            }
        }
    }
}
