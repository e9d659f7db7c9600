//! The Vulkan loader and instance.

use std::ffi::CStr;
use std::sync::Arc;

use ash::{ext, vk};

use super::drivers;
use super::gate::{self, Calls, Share};
use super::validation::{LAYER, Messages, messenger_info};
use crate::gpu::GpuError;
use crate::gpu::error::call;
use crate::memory::{MemoryError, Need, address_space};

/// Layer through which a settings tool forces other layers upon every program.
const OVERRIDE_LAYER: &CStr = c"VK_LAYER_LUNARG_override";

/// Address space that a driver needs at least (Mesa's lavapipe, measured).
const DRIVER_BYTES: u64 = 512 << 20;

/// Environment variables through which the loader inserts layers into every program.
const FORCED_LAYERS: [&str; 2] = ["VK_INSTANCE_LAYERS", "VK_LOADER_LAYERS_ENABLE"];

/// An instance without a window system, optionally with the validation layer.
pub(in super::super) struct Instance {
    raw: ash::Instance,
    pub(in super::super) validation: bool,
    /// Whether calls may pass through a layer.
    layered: bool,
    pub(in super::super) messages: Arc<Messages>,
    messenger: Option<(ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    /// Keeps the loader open.
    _entry: ash::Entry,
}

impl Instance {
    /// Opens the loader and creates an instance of Vulkan 1.1.
    pub(in super::super) fn new(validation: bool) -> Result<Self, GpuError> {
        check_address_space()?;
        let messages = Arc::new(Messages::default());
        let mut instance = Self::open(validation, messages)?;
        if validation {
            instance.messenger = Some(instance.new_messenger()?);
        }
        instance.messages.check()?;
        Ok(instance)
    }

    fn open(validation: bool, messages: Arc<Messages>) -> Result<Self, GpuError> {
        let _alone = gate::alone();
        // SAFETY: the library found under the loader's name is assumed to be a Vulkan loader.
        let entry = unsafe { ash::Entry::load() }.map_err(|source| GpuError::NoLoader { source })?;
        // SAFETY: a global query without arguments.
        let version = unsafe { entry.try_enumerate_instance_version() };
        if version.map_err(call("vkEnumerateInstanceVersion"))?.unwrap_or(vk::API_VERSION_1_0)
            < vk::API_VERSION_1_1
        {
            return Err(GpuError::NoDevice { found: "a Vulkan 1.0 loader".into() });
        }
        // SAFETY: a global query without arguments.
        let layers = unsafe { entry.enumerate_instance_layer_properties() };
        let layers = layers.map_err(call("vkEnumerateInstanceLayerProperties"))?;
        let has = |name| layers.iter().any(|layer| layer.layer_name_as_c_str() == Ok(name));
        if validation && !has(LAYER) {
            return Err(GpuError::NoValidationLayer);
        }
        let forced = |name| std::env::var_os(name).is_some_and(|value| !value.is_empty());
        let layered = validation || has(OVERRIDE_LAYER) || FORCED_LAYERS.into_iter().any(forced);
        let raw = create(&entry, validation, &messages)?;
        Ok(Self { raw, validation, layered, messages, messenger: None, _entry: entry })
    }

    fn new_messenger(&self) -> Result<(ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT), GpuError> {
        let info = messenger_info(&self.messages);
        let _alone = gate::alone();
        let utils = ext::debug_utils::Instance::new(&self._entry, &self.raw);
        // SAFETY: the extension is enabled; the messages behind `info` outlive the messenger (see `drop`).
        let messenger = unsafe { utils.create_debug_utils_messenger(&info, None) };
        Ok((utils, messenger.map_err(call("vkCreateDebugUtilsMessengerEXT"))?))
    }

    /// Returns the instance's functions for one call.
    pub(in super::super) fn calls(&self) -> Calls<'_, ash::Instance> {
        Calls::new(&self.raw, self.layered)
    }

    /// Returns a device's functions for one call.
    pub(in super::super) fn calls_of<'a, T>(&self, functions: &'a T) -> Calls<'a, T> {
        Calls::new(functions, self.layered)
    }

    /// Returns a share of the gate for calls by other code on the instance or one of its devices.
    pub(in super::super) fn share(&self) -> Option<Share> {
        Share::new(self.layered)
    }

    /// Returns the functions without a lock, to be called under [`Instance::share`] or `gate::alone`.
    pub(in super::super) fn raw(&self) -> &ash::Instance {
        &self.raw
    }

    /// Returns the maximum duration of one wait for the device, nanoseconds; short if other threads wait for
    /// the call.
    pub(in super::super) fn longest_wait(&self) -> u64 {
        const MILLISECOND: u64 = 1_000_000;
        if self.layered { MILLISECOND } else { u64::MAX }
    }

    /// Returns all physical devices, in the driver's order.
    pub(in super::super) fn physical_devices(&self) -> Result<Vec<vk::PhysicalDevice>, GpuError> {
        // SAFETY: the instance is alive.
        let devices = unsafe { self.calls().enumerate_physical_devices() };
        devices.map_err(call("vkEnumeratePhysicalDevices"))
    }
}

/// Checks that a driver can be loaded: with less address space, drivers are not found, or fail without a
/// reason.
fn check_address_space() -> Result<(), GpuError> {
    match address_space() {
        Some(available) if available.bytes < DRIVER_BYTES => {
            let what = "a Vulkan driver".to_owned();
            let need = Need { what, bytes: DRIVER_BYTES, advice: "raise the limit, or use --rasterizer cpu" };
            Err(MemoryError { need, available }.into())
        }
        _ => Ok(()),
    }
}

fn create(entry: &ash::Entry, validation: bool, messages: &Messages) -> Result<ash::Instance, GpuError> {
    let application = vk::ApplicationInfo::default()
        .application_name(c"point-skeleton")
        .engine_name(c"point-skeleton")
        .api_version(vk::API_VERSION_1_1);
    let layers = [LAYER.as_ptr()];
    let extensions: [&CStr; 2] = [ext::debug_utils::NAME, ext::validation_features::NAME];
    let extensions = extensions.map(CStr::as_ptr);
    let enabled = [vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION];
    let mut features = vk::ValidationFeaturesEXT::default().enabled_validation_features(&enabled);
    // The same messenger receives messages about the creation and destruction of the instance itself.
    let mut messenger = messenger_info(messages);
    let mut info = vk::InstanceCreateInfo::default().application_info(&application);
    if validation {
        info = info
            .enabled_layer_names(&layers)
            .enabled_extension_names(&extensions)
            .push_next(&mut features)
            .push_next(&mut messenger);
    }
    // SAFETY: everything that `info` points to lives until after the call, the messages until the
    // instance is destroyed.
    unsafe { entry.create_instance(&info, None) }.map_err(|source| match source {
        vk::Result::ERROR_INCOMPATIBLE_DRIVER => GpuError::NoDevice { found: drivers::none_found() },
        source => GpuError::Call { call: "vkCreateInstance", source },
    })
}

impl Drop for Instance {
    fn drop(&mut self) {
        let _alone = gate::alone();
        if let Some((utils, messenger)) = self.messenger.take() {
            // SAFETY: created from this instance, destroyed once and unused otherwise.
            unsafe { utils.destroy_debug_utils_messenger(messenger, None) };
        }
        // SAFETY: the device, the only remaining child, is destroyed before its `Instance` is dropped.
        unsafe { self.raw.destroy_instance(None) };
        if Arc::strong_count(&self.messages) == 1 {
            report(&self.messages.take());
        }
    }
}

/// Prints messages about the destruction, for use when no other handle to them remains.
#[expect(clippy::print_stderr, reason = "a drop cannot return an error, and validation is for developers")]
fn report(messages: &[String]) {
    for message in messages {
        eprintln!("validation: {message}");
    }
}
