//! Messages of the validation layer.

use std::ffi::{CStr, c_void};
use std::sync::Mutex;

use ash::vk;

use super::GpuError;

/// The layer's name.
pub(super) const LAYER: &CStr = c"VK_LAYER_KHRONOS_validation";

/// What the layer said so far, in order.
#[derive(Debug, Default)]
pub struct Messages(Mutex<Vec<String>>);

impl Messages {
    /// Takes them all.
    pub fn take(&self) -> Vec<String> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner))
    }

    /// Takes them all; none is good.
    ///
    /// # Errors
    /// [`GpuError::Validation`] with what was said.
    pub fn check(&self) -> Result<(), GpuError> {
        let messages = self.take();
        if messages.is_empty() { Ok(()) } else { Err(GpuError::Validation(messages)) }
    }

    fn push(&self, message: String) {
        self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push(message);
    }
}

/// Asks for warnings and errors of the layer. The loader's own messages (broken drivers that are not used) are
/// not asked for. `messages` must outlive the messenger and the instance.
pub(super) fn messenger_info(messages: &Messages) -> vk::DebugUtilsMessengerCreateInfoEXT<'static> {
    use vk::DebugUtilsMessageSeverityFlagsEXT as Severity;
    vk::DebugUtilsMessengerCreateInfoEXT::default()
        .message_severity(Severity::WARNING | Severity::ERROR)
        .message_type(vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION)
        .pfn_user_callback(Some(collect))
        .user_data(std::ptr::from_ref(messages).cast_mut().cast())
}

/// The callback: keeps the message, lets the call go on.
unsafe extern "system" fn collect(
    _: vk::DebugUtilsMessageSeverityFlagsEXT,
    _: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    user: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: `user` is the `Messages` given in `messenger_info`, which outlives the messenger.
    let messages = unsafe { user.cast::<Messages>().as_ref() };
    // SAFETY: the layer hands over a valid pointer that lives during the call.
    let data = unsafe { data.as_ref() };
    if let (Some(messages), Some(data)) = (messages, data) {
        // SAFETY: the layer's message is a string that ends in zero, or null, which gives `None`.
        let text = unsafe { data.message_as_c_str() };
        messages.push(text.unwrap_or(c"(no text)").to_string_lossy().into_owned());
    }
    vk::FALSE
}
