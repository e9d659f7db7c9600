use ash::vk;

/// How to get a Vulkan driver that needs no GPU.
const INSTALL_DRIVER: &str = "install one with `apt-get install libvulkan1 mesa-vulkan-drivers` (Mesa's lavapipe needs \
     no GPU; ci/setup.sh does it), or draw without Vulkan: --rasterizer cpu";

/// What the device or driver did not do.
#[derive(Debug, thiserror::Error)]
pub enum GpuError {
    /// The Vulkan loader cannot be opened.
    #[error("expected a Vulkan loader (libvulkan.so.1), found none; {INSTALL_DRIVER}")]
    NoLoader {
        /// What the dynamic linker said.
        source: ash::LoadingError,
    },
    /// No driver, or no device with what is needed.
    #[error(
        "expected a Vulkan 1.1 device with a graphics and compute queue, found {found}; {INSTALL_DRIVER}"
    )]
    NoDevice {
        /// What there is instead.
        found: String,
    },
    /// The name or index asked for fits no device.
    #[error(
        "expected a Vulkan device whose name contains {wanted:?} or that has this index (PSKEL_DEVICE), found {found}"
    )]
    UnknownDevice {
        /// As given.
        wanted: String,
        /// Names of all devices, with their indices.
        found: String,
    },
    /// Validation was asked for, and the layer is not installed.
    #[error(
        "expected the layer VK_LAYER_KHRONOS_validation (PSKEL_VALIDATION=1 asks for it), found none; install it with \
         `apt-get install vulkan-validationlayers`"
    )]
    NoValidationLayer,
    /// A limit, format or feature of the device does not reach.
    #[error("expected {expected}, found {found} on device {device}")]
    Unsupported {
        /// What is needed.
        expected: String,
        /// What the device has.
        found: String,
        /// Its name.
        device: String,
    },
    /// A Vulkan function failed.
    #[error("{call} failed: {source}")]
    Call {
        /// Its name.
        call: &'static str,
        /// What it returned.
        source: vk::Result,
    },
    /// No memory for a buffer or an image.
    #[error("expected {bytes} bytes of device memory for {name}, found: {source}")]
    Memory {
        /// Size.
        bytes: u64,
        /// What for.
        name: String,
        /// What the allocator said.
        source: gpu_allocator::AllocationError,
    },
    /// A buffer is smaller than what is copied, read or drawn, or the host cannot reach it (0 bytes then).
    #[error("expected {expected} bytes in {name}, found {found}")]
    Range {
        /// What is to be reached, bytes.
        expected: u64,
        /// What there is, bytes.
        found: u64,
        /// Of what.
        name: String,
    },
    /// Host and device would use a buffer's memory at the same time.
    #[error("expected {name} to be free, found it in use by a submit or mapped")]
    Busy {
        /// Which buffer.
        name: String,
    },
    /// The validation layer complained.
    #[error("expected no message from the Vulkan validation layer, found {}:\n{}", .0.len(), .0.join("\n"))]
    Validation(Vec<String>),
}

/// For `map_err`: a failed call with its name.
pub(super) fn call(call: &'static str) -> impl FnOnce(vk::Result) -> GpuError {
    move |source| GpuError::Call { call, source }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_say_what_to_install() {
        let text = GpuError::NoDevice { found: "no driver".into() }.to_string();
        assert!(text.contains("apt-get install libvulkan1 mesa-vulkan-drivers"), "{text}");
        assert!(text.contains("--rasterizer cpu"), "{text}");
        let text = GpuError::NoValidationLayer.to_string();
        assert!(text.contains("apt-get install vulkan-validationlayers"), "{text}");
    }
}
