use std::fmt;
use std::str::FromStr;

use super::cpu::CpuRasterizer;
use super::{CloudSet, RasterError, Rasterizer, VulkanRasterizer};
use crate::gpu::{Device, DeviceDesc};

/// Which rasterizer to use; all give the same maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RasterizerKind {
    /// The fastest one that there is: Vulkan.
    #[default]
    Auto,
    /// Vulkan's fixed-function pipeline.
    Raster,
    /// Plain Rust, without a driver.
    Cpu,
}

/// A name that is no rasterizer's.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected a rasterizer (auto, raster or cpu), found {0:?}")]
pub struct UnknownRasterizer(pub String);

impl FromStr for RasterizerKind {
    type Err = UnknownRasterizer;

    fn from_str(text: &str) -> Result<Self, UnknownRasterizer> {
        let all = [Self::Auto, Self::Raster, Self::Cpu];
        all.into_iter().find(|k| k.to_string() == text).ok_or_else(|| UnknownRasterizer(text.to_owned()))
    }
}

impl fmt::Display for RasterizerKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Auto => "auto",
            Self::Raster => "raster",
            Self::Cpu => "cpu",
        })
    }
}

/// A rasterizer that holds these clouds. `device` is a part of the device's name or its index; without it the
/// environment variable `PSKEL_DEVICE` decides, then the best device. `PSKEL_VALIDATION=1` turns on validation.
///
/// # Errors
/// No device (never for [`RasterizerKind::Cpu`]), an unknown one, out of memory.
pub fn create<'a>(
    kind: RasterizerKind,
    device: Option<&str>,
    clouds: CloudSet<'a>,
) -> Result<Box<dyn Rasterizer + 'a>, RasterError> {
    if kind == RasterizerKind::Cpu {
        return Ok(Box::new(CpuRasterizer::new(clouds)));
    }
    let mut desc = DeviceDesc::from_env();
    desc.device = device.map(str::to_owned).or(desc.device);
    let device = Device::new(&desc)?;
    Ok(Box::new(VulkanRasterizer::new(device, &clouds)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_go_there_and_back() {
        for kind in [RasterizerKind::Auto, RasterizerKind::Raster, RasterizerKind::Cpu] {
            assert_eq!(kind.to_string().parse(), Ok(kind));
        }
        let text = "opengl".parse::<RasterizerKind>().unwrap_err().to_string();
        assert!(text.contains("auto, raster or cpu") && text.contains("opengl"));
    }
}
