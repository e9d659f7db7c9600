use ash::vk;

/// How to install a Vulkan driver that needs no GPU.
const INSTALL_DRIVER: &str = "install one with `apt-get install libvulkan1 mesa-vulkan-drivers` (Mesa's \
    lavapipe needs \
     no GPU; ci/setup.sh does it)";

/// Error of the device or its driver.
#[derive(Debug, thiserror::Error)]
pub enum GpuError {
    /// The Vulkan loader cannot be opened.
    #[error("expected a Vulkan loader (libvulkan.so.1), found none; {INSTALL_DRIVER}")]
    NoLoader {
        /// Error of the dynamic linker.
        source: ash::LoadingError,
    },
    /// There is no driver, or no device with the required features.
    #[error(
        "expected a Vulkan 1.1 device with a graphics and compute queue, found {found}; {INSTALL_DRIVER}"
    )]
    NoDevice {
        /// Devices or driver found instead.
        found: String,
    },
    /// No device matches the requested name or index.
    #[error(
        "expected a Vulkan device whose name contains {wanted:?} or that has this index (PSKEL_DEVICE), \
            found {found}"
    )]
    UnknownDevice {
        /// Name or index as given.
        wanted: String,
        /// Names of all devices, with their indices.
        found: String,
    },
    /// Validation was requested, and the layer is not installed.
    #[error(
        "expected the layer VK_LAYER_KHRONOS_validation (PSKEL_VALIDATION=1 asks for it), found none; \
            install it with \
         `apt-get install vulkan-validationlayers`"
    )]
    NoValidationLayer,
    /// The process was forked from one that had opened a device.
    #[error(
        "expected a process that opens its own devices, found {found}, a fork of {opened_by}, which had \
            opened one; \
         start processes by spawning instead of forking"
    )]
    Forked {
        /// Process that opened the first device.
        opened_by: u32,
        /// This process.
        found: u32,
    },
    /// The device does not support a limit, format or feature.
    #[error("expected {expected}, found {found} on device {device}")]
    Unsupported {
        /// Required capability.
        expected: String,
        /// Capability of the device.
        found: String,
        /// Device name.
        device: String,
    },
    /// The driver needs more threads than the system allows.
    #[error(transparent)]
    Threads(#[from] crate::threads::ThreadError),
    /// The limit on the address space leaves too little for a driver.
    #[error(transparent)]
    AddressSpace(#[from] crate::memory::MemoryError),
    /// A Vulkan function failed.
    #[error("{call} failed: {source}")]
    Call {
        /// Name of the function.
        call: &'static str,
        /// Result code.
        source: vk::Result,
    },
    /// Device memory could not be allocated.
    #[error("expected {bytes} bytes of device memory for {name}, found: {source}")]
    Memory {
        /// Requested size.
        bytes: u64,
        /// Name of the buffer or image.
        name: String,
        /// Error of the allocator.
        source: gpu_allocator::AllocationError,
    },
    /// An access exceeds a buffer or an image, push constants have the wrong size, or a resource is not bound
    /// or not host-visible (`found` is 0 then).
    #[error("expected {expected} bytes in {name}, found {found}")]
    Range {
        /// Size of the access, bytes.
        expected: u64,
        /// Size of the resource, bytes.
        found: u64,
        /// Name of the resource.
        name: String,
    },
    /// Host and device would use a buffer's memory at the same time.
    #[error("expected {name} to be free, found it in use by a submit or mapped")]
    Busy {
        /// Name of the buffer.
        name: String,
    },
    /// The validation layer reported messages.
    #[error("expected no message from the Vulkan validation layer, found {}:\n{}", .0.len(), .0.join("\n"))]
    Validation(Vec<String>),
}

/// Returns a function for `map_err` that names the failed call.
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
        let text = GpuError::NoValidationLayer.to_string();
        assert!(text.contains("apt-get install vulkan-validationlayers"), "{text}");
    }
}
