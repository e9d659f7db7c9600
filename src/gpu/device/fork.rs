//! Detection of forks: the threads and locks of a driver do not survive in a forked process.

use std::sync::atomic::{AtomicU32, Ordering};

use crate::gpu::GpuError;

/// Process that opened the first device; 0 before that.
static OPENED_BY: AtomicU32 = AtomicU32::new(0);

/// Checks that this process, rather than one that it was forked from, opened the first device.
pub(in super::super) fn check_process() -> Result<(), GpuError> {
    let here = std::process::id();
    match OPENED_BY.compare_exchange(0, here, Ordering::Relaxed, Ordering::Relaxed) {
        Err(opened_by) if opened_by != here => Err(GpuError::Forked { opened_by, found: here }),
        _ => Ok(()),
    }
}
