use super::budget::{Budgeted, reserve_order};
use super::cpu::{CpuRasterizer, CpuRasterizerDesc};
use super::{
    CloudSet, ComputeRasterizer, ComputeRasterizerDesc, GraphicsRasterizer, GraphicsRasterizerDesc,
    RasterError, Rasterizer,
};
use crate::gpu::{Device, DeviceDesc, GpuError};
use crate::named;

/// Choice of rasterizer; all produce the same maps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RasterizerKind {
    /// The fastest one: `compute` or else `graphics` on a GPU, `cpu` without one. `cpu` is not chosen if a
    /// device is named, its memory is limited or validation is on.
    #[default]
    Auto,
    /// Vulkan compute shaders; needs 64-bit atomics.
    Compute,
    /// Vulkan's graphics pipeline.
    Graphics,
    /// Vector code and threads of the processor; needs no driver.
    Cpu,
}

named!(RasterizerKind, "rasterizer" {
    Auto => "auto", "The fastest one: cpu unless there is a GPU";
    Compute => "compute", "Vulkan with 64-bit atomics";
    Graphics => "graphics", "Vulkan's graphics pipeline";
    Cpu => "cpu", "Threads and vectors of the processor; needs no driver";
});

/// Parameters of a rasterizer to create.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RasterizerDesc {
    /// Rasterizer to use.
    pub kind: RasterizerKind,
    /// Part of the device's name, or its index; by default the environment variable `PSKEL_DEVICE`, then
    /// the best device.
    pub device: Option<String>,
    /// Memory budget for points on the device, bytes (`compute`: 20 per point, `graphics`: 16); points beyond
    /// it are streamed. `None` for no limit, and for [`DEFAULT_MEMORY_BYTES`](super::DEFAULT_MEMORY_BYTES) on
    /// a device that is the host's processor. The `cpu` rasterizer ignores it.
    pub memory_bytes: Option<u64>,
    /// Memory budget for points of the `cpu` rasterizer, bytes (17 per point); points beyond it are streamed.
    /// `None` for [`DEFAULT_MEMORY_BYTES`](super::DEFAULT_MEMORY_BYTES), or what a single frame needs if that
    /// is more.
    pub host_memory_bytes: Option<u64>,
    /// Whether the `cpu` rasterizer skips points that nearer ones hide. The maps do not depend on it.
    pub occlusion_culling: bool,
}

impl Default for RasterizerDesc {
    fn default() -> Self {
        Self {
            kind: RasterizerKind::Auto,
            device: None,
            memory_bytes: None,
            host_memory_bytes: None,
            occlusion_culling: true,
        }
    }
}

impl RasterizerDesc {
    /// Returns the parameters that are set although this kind of rasterizer has no use for them, as the
    /// command names them: `device`, `gpu-memory`, `memory`, `no-occlusion-culling`.
    pub fn unused(&self) -> Vec<&'static str> {
        use RasterizerKind::{Auto, Cpu};
        let unused = [
            ("device", self.device.is_some() && self.kind == Cpu),
            ("gpu-memory", self.memory_bytes.is_some() && self.kind == Cpu),
            ("memory", self.host_memory_bytes.is_some() && !matches!(self.kind, Cpu | Auto)),
            ("no-occlusion-culling", !self.occlusion_culling && !matches!(self.kind, Cpu | Auto)),
        ];
        unused.into_iter().filter(|(_, unused)| *unused).map(|(name, _)| name).collect()
    }
}

impl From<RasterizerKind> for RasterizerDesc {
    fn from(kind: RasterizerKind) -> Self {
        Self { kind, ..Self::default() }
    }
}

/// Creates a rasterizer of these clouds, whose points are loaded when they may be seen. `PSKEL_VALIDATION=1`
/// turns on validation.
///
/// # Errors
/// Fails if there is no device (never for [`RasterizerKind::Cpu`], and not for [`RasterizerKind::Auto`] if
/// nothing asks for a device), if the named device is unknown or lacks a required feature, or if more memory
/// is needed than available.
pub fn create<'a>(
    desc: &RasterizerDesc,
    clouds: CloudSet<'a>,
) -> Result<Box<dyn Rasterizer + 'a>, RasterError> {
    let mut of_device = DeviceDesc::from_env();
    of_device.device = desc.device.clone().or(of_device.device);
    let asked = of_device.device.is_some() || of_device.validation || desc.memory_bytes.is_some();
    let device = match desc.kind {
        RasterizerKind::Cpu => None,
        // A driver that runs on the processor is slower than the processor.
        RasterizerKind::Auto if !asked => match Device::new(&of_device) {
            Ok(device) => Some(device).filter(|device| !device.is_cpu()),
            // Only drivers that run on the processor lack threads. Under `ulimit -v` no driver may fit.
            Err(
                GpuError::NoLoader { .. }
                | GpuError::NoDevice { .. }
                | GpuError::Threads(_)
                | GpuError::AddressSpace(_),
            ) => None,
            Err(error) => return Err(error.into()),
        },
        _ => Some(Device::new(&of_device)?),
    };
    let _order = reserve_order(&clouds)?;
    let Some(device) = device else {
        let (occlusion_culling, memory_bytes) = (desc.occlusion_culling, desc.host_memory_bytes);
        let options = CpuRasterizerDesc { occlusion_culling, memory_bytes };
        return Ok(Box::new(Budgeted::new(Box::new(CpuRasterizer::with_desc(clouds, options)), false)));
    };
    let compute = match desc.kind {
        RasterizerKind::Auto => ComputeRasterizer::supported(&device),
        other => other == RasterizerKind::Compute,
    };
    if compute {
        let memory_bytes = desc.memory_bytes;
        let desc = ComputeRasterizerDesc { memory_bytes, ..ComputeRasterizerDesc::default() };
        let rasterizer = Box::new(ComputeRasterizer::with_desc(device, &clouds, desc)?);
        return Ok(Box::new(Budgeted::new(rasterizer, false)));
    }
    let desc =
        GraphicsRasterizerDesc { memory_bytes: desc.memory_bytes, ..GraphicsRasterizerDesc::default() };
    Ok(Box::new(Budgeted::new(Box::new(GraphicsRasterizer::with_desc(device, &clouds, desc)?), true)))
}
