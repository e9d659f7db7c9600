use std::fmt;
use std::str::FromStr;

use super::cpu::CpuRasterizer;
use super::{CloudSet, ComputeRasterizer, ComputeRasterizerDesc, RasterError, Rasterizer, VulkanRasterizer};
use crate::gpu::{Device, DeviceDesc};

/// Which rasterizer to use; all give the same maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RasterizerKind {
    /// The fastest one that the device can do.
    #[default]
    Auto,
    /// Vulkan's compute shaders; needs 64-bit atomics.
    Compute,
    /// Vulkan's fixed-function pipeline.
    Raster,
    /// Plain Rust, without a driver.
    Cpu,
}

/// A name that is no rasterizer's.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected a rasterizer (auto, compute, raster or cpu), found {0:?}")]
pub struct UnknownRasterizer(pub String);

impl FromStr for RasterizerKind {
    type Err = UnknownRasterizer;

    fn from_str(text: &str) -> Result<Self, UnknownRasterizer> {
        let all = [Self::Auto, Self::Compute, Self::Raster, Self::Cpu];
        all.into_iter().find(|k| k.to_string() == text).ok_or_else(|| UnknownRasterizer(text.to_owned()))
    }
}

impl fmt::Display for RasterizerKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Auto => "auto",
            Self::Compute => "compute",
            Self::Raster => "raster",
            Self::Cpu => "cpu",
        })
    }
}

/// Which rasterizer to make.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RasterizerDesc {
    /// What draws.
    pub kind: RasterizerKind,
    /// Part of the device's name or its index; without it the environment variable `PSKEL_DEVICE` decides, then the
    /// best device.
    pub device: Option<String>,
    /// Bytes that points may take on the device, 20 a point; beyond them positions are streamed, which only compute shaders
    /// do. `None` for all that is needed. Plain Rust holds nothing on a device and ignores it.
    pub memory_bytes: Option<u64>,
}

impl From<RasterizerKind> for RasterizerDesc {
    fn from(kind: RasterizerKind) -> Self {
        Self { kind, ..Self::default() }
    }
}

/// A rasterizer that holds these clouds. `PSKEL_VALIDATION=1` turns on validation.
///
/// # Errors
/// No device (never for [`RasterizerKind::Cpu`]), an unknown one, one that lacks what the kind needs, out of memory.
pub fn create<'a>(
    desc: &RasterizerDesc,
    clouds: CloudSet<'a>,
) -> Result<Box<dyn Rasterizer + 'a>, RasterError> {
    if desc.kind == RasterizerKind::Cpu {
        return Ok(Box::new(CpuRasterizer::new(clouds)));
    }
    let mut of_device = DeviceDesc::from_env();
    of_device.device = desc.device.clone().or(of_device.device);
    let device = Device::new(&of_device)?;
    let compute = match desc.kind {
        RasterizerKind::Auto => ComputeRasterizer::supported(&device),
        other => other == RasterizerKind::Compute,
    };
    if compute {
        let memory_bytes = desc.memory_bytes;
        let desc = ComputeRasterizerDesc { memory_bytes, ..ComputeRasterizerDesc::default() };
        return Ok(Box::new(ComputeRasterizer::with_desc(device, &clouds, desc)?));
    }
    if desc.memory_bytes.is_some() {
        let expected =
            "64-bit atomics on buffers, since only the compute rasterizer streams points (--gpu-memory)";
        let found = if desc.kind == RasterizerKind::Raster { "--rasterizer raster" } else { "none" };
        return Err(device.unsupported(expected, found).into());
    }
    Ok(Box::new(VulkanRasterizer::new(device, &clouds)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_go_there_and_back() {
        use RasterizerKind as Kind;
        for kind in [Kind::Auto, Kind::Compute, Kind::Raster, Kind::Cpu] {
            assert_eq!(kind.to_string().parse(), Ok(kind));
        }
        let text = "opengl".parse::<RasterizerKind>().unwrap_err().to_string();
        assert!(text.contains("auto, compute, raster or cpu") && text.contains("opengl"));
    }
}
