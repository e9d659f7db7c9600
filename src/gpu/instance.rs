//! The Vulkan loader and instance.

use std::ffi::CStr;
use std::sync::Arc;

use ash::{ext, vk};

use super::GpuError;
use super::error::call;
use super::validation::{LAYER, Messages, messenger_info};

/// An instance without any window system; with the validation layer if asked for.
pub(super) struct Instance {
    pub(super) raw: ash::Instance,
    pub(super) validation: bool,
    pub(super) messages: Arc<Messages>,
    messenger: Option<(ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    /// Keeps the loader open.
    _entry: ash::Entry,
}

impl Instance {
    /// Opens the loader and creates an instance of Vulkan 1.1.
    pub(super) fn new(validation: bool) -> Result<Self, GpuError> {
        // SAFETY: the loader found on this system is taken to be a Vulkan loader.
        let entry = unsafe { ash::Entry::load() }.map_err(|source| GpuError::NoLoader { source })?;
        // SAFETY: a global query without arguments.
        let version = unsafe { entry.try_enumerate_instance_version() };
        if version.map_err(call("vkEnumerateInstanceVersion"))?.unwrap_or(vk::API_VERSION_1_0)
            < vk::API_VERSION_1_1
        {
            return Err(GpuError::NoDevice { found: "a Vulkan 1.0 loader".into() });
        }
        if validation && !has_layer(&entry)? {
            return Err(GpuError::NoValidationLayer);
        }
        let messages = Arc::new(Messages::default());
        let raw = create(&entry, validation, &messages)?;
        let mut instance = Self { raw, validation, messages, messenger: None, _entry: entry };
        if validation {
            let utils = ext::debug_utils::Instance::new(&instance._entry, &instance.raw);
            let info = messenger_info(&instance.messages);
            // SAFETY: the extension is enabled; the messages behind `info` outlive the messenger (see `drop`).
            let messenger = unsafe { utils.create_debug_utils_messenger(&info, None) };
            instance.messenger = Some((utils, messenger.map_err(call("vkCreateDebugUtilsMessengerEXT"))?));
        }
        instance.messages.check()?;
        Ok(instance)
    }

    /// All physical devices, in the driver's order.
    pub(super) fn physical_devices(&self) -> Result<Vec<vk::PhysicalDevice>, GpuError> {
        // SAFETY: the instance is alive.
        let devices = unsafe { self.raw.enumerate_physical_devices() };
        devices.map_err(call("vkEnumeratePhysicalDevices"))
    }
}

fn has_layer(entry: &ash::Entry) -> Result<bool, GpuError> {
    // SAFETY: a global query without arguments.
    let layers = unsafe { entry.enumerate_instance_layer_properties() };
    let layers = layers.map_err(call("vkEnumerateInstanceLayerProperties"))?;
    Ok(layers.iter().any(|layer| layer.layer_name_as_c_str() == Ok(LAYER)))
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
    // The same messenger hears about the creation and destruction of the instance itself.
    let mut messenger = messenger_info(messages);
    let mut info = vk::InstanceCreateInfo::default().application_info(&application);
    if validation {
        info = info
            .enabled_layer_names(&layers)
            .enabled_extension_names(&extensions)
            .push_next(&mut features)
            .push_next(&mut messenger);
    }
    // SAFETY: all that `info` points to lives until after the call, the messages until the instance is gone.
    unsafe { entry.create_instance(&info, None) }.map_err(|source| match source {
        vk::Result::ERROR_INCOMPATIBLE_DRIVER => GpuError::NoDevice { found: "no driver".into() },
        source => GpuError::Call { call: "vkCreateInstance", source },
    })
}

impl Drop for Instance {
    fn drop(&mut self) {
        if let Some((utils, messenger)) = self.messenger.take() {
            // SAFETY: created from this instance, destroyed once; nothing else uses it.
            unsafe { utils.destroy_debug_utils_messenger(messenger, None) };
        }
        // SAFETY: the device, the only child left, is destroyed before its `Instance` is dropped.
        unsafe { self.raw.destroy_instance(None) };
        if Arc::strong_count(&self.messages) == 1 {
            report(&self.messages.take());
        }
    }
}

/// What the layer said about the destruction, where nobody holds the messages to look at them any more.
#[expect(clippy::print_stderr, reason = "a drop cannot return an error, and validation is for developers")]
fn report(messages: &[String]) {
    for message in messages {
        eprintln!("validation: {message}");
    }
}
