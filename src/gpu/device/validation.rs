//! Messages of the validation layer.

use std::ffi::{CStr, c_void};
use std::sync::Mutex;

use ash::vk;

use crate::gpu::GpuError;

/// The layer's name.
pub(in super::super) const LAYER: &CStr = c"VK_LAYER_KHRONOS_validation";

/// Messages that the layer has reported so far, in order.
#[derive(Debug, Default)]
pub struct Messages(Mutex<Vec<String>>);

impl Messages {
    /// Removes and returns all messages.
    pub fn take(&self) -> Vec<String> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner))
    }

    /// Removes all messages and fails if there were any.
    ///
    /// # Errors
    /// Returns [`GpuError::Validation`] with the messages.
    pub fn check(&self) -> Result<(), GpuError> {
        let messages = self.take();
        if messages.is_empty() { Ok(()) } else { Err(GpuError::Validation(messages)) }
    }

    fn push(&self, message: String) {
        self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push(message);
    }
}

/// Returns the create info of a messenger for the layer's warnings and errors. It excludes the loader's own
/// messages (about broken drivers that are not used). `messages` must outlive the messenger and the instance.
pub(in super::super) fn messenger_info(messages: &Messages) -> vk::DebugUtilsMessengerCreateInfoEXT<'static> {
    use vk::DebugUtilsMessageSeverityFlagsEXT as Severity;
    vk::DebugUtilsMessengerCreateInfoEXT::default()
        .message_severity(Severity::WARNING | Severity::ERROR)
        .message_type(vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION)
        .pfn_user_callback(Some(collect))
        .user_data(std::ptr::from_ref(messages).cast_mut().cast())
}

/// Messenger callback: stores the message and lets the call proceed.
unsafe extern "system" fn collect(
    _: vk::DebugUtilsMessageSeverityFlagsEXT,
    _: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    user: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: `user` is the `Messages` passed to `messenger_info`, which outlives the messenger.
    let messages = unsafe { user.cast::<Messages>().as_ref() };
    // SAFETY: the layer passes a valid pointer that lives during the call.
    let data = unsafe { data.as_ref() };
    if let (Some(messages), Some(data)) = (messages, data) {
        // SAFETY: the layer's message is a null-terminated string, or a null pointer, which gives `None`.
        let text = unsafe { data.message_as_c_str() };
        messages.push(text.unwrap_or(c"(no text)").to_string_lossy().into_owned());
    }
    vk::FALSE
}
