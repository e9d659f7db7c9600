use std::ops::Deref;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use pyo3::prelude::*;

use crate::error::RenderError;

/// A log, and the process that rendered its images, if it is synthetic: the device of that process belongs to
/// it.
pub(crate) struct OwnedLog {
    log: Arc<point_skeleton::Log>,
    /// 0 if no image was rendered.
    rendered_by: AtomicU32,
}

impl OwnedLog {
    pub(crate) fn new(log: point_skeleton::Log) -> Self {
        Self { log: Arc::new(log), rendered_by: AtomicU32::new(0) }
    }

    /// Returns whether images are rendered, by a device, and not recorded.
    pub(crate) fn is_rendered(&self) -> bool {
        self.log.reader().view_renderer().is_some()
    }

    /// Notes, before images are read, that this process renders them. No effect if they are recorded.
    ///
    /// # Errors
    /// Raises `RenderError` in a fork of the process that rendered images.
    pub(crate) fn claim_images(&self) -> PyResult<()> {
        if !self.is_rendered() {
            return Ok(());
        }
        let here = std::process::id();
        match self.rendered_by.compare_exchange(0, here, Ordering::Relaxed, Ordering::Relaxed) {
            Err(owner) if owner != here => Err(RenderError::new_err(format!(
                "expected the process that rendered images of the log ({owner}), found its fork {here}: open \
                    the Log in \
                 each process"
            ))),
            _ => Ok(()),
        }
    }
}

impl Deref for OwnedLog {
    type Target = point_skeleton::Log;

    fn deref(&self) -> &Self::Target {
        &self.log
    }
}

/// A fork must not release the device of its parent.
impl Drop for OwnedLog {
    fn drop(&mut self) {
        let owner = *self.rendered_by.get_mut();
        if owner != 0 && owner != std::process::id() {
            std::mem::forget(Arc::clone(&self.log));
        }
    }
}
