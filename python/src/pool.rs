//! Calls without the interpreter lock, also in forked processes.
//!
//! A fork inherits the thread pool of the library without its threads, so that any use of it would wait
//! forever. In a process other than the one that imported the module, calls therefore run in a pool of that
//! process.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use point_skeleton::threads::{new_pool, start_pool};
use pyo3::prelude::*;
use rayon::ThreadPool;

use crate::error::raise;

static IMPORTED_BY: OnceLock<u32> = OnceLock::new();
static POOL: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);

/// Notes the process that imports the module.
pub(crate) fn imported() {
    IMPORTED_BY.get_or_init(std::process::id);
}

/// Runs a call without the interpreter lock.
pub(crate) fn detached<T: Send>(py: Python<'_>, call: impl FnOnce() -> PyResult<T> + Send) -> PyResult<T> {
    let here = std::process::id();
    if IMPORTED_BY.get() == Some(&here) {
        return py.detach(|| {
            start_pool().map_err(raise)?;
            call()
        });
    }
    py.detach(|| pool_of(here)?.install(call))
}

fn pool_of(process: u32) -> PyResult<Arc<ThreadPool>> {
    let mut pool = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((owner, pool)) = &*pool
        && *owner == process
    {
        return Ok(Arc::clone(pool));
    }
    let made = Arc::new(new_pool().map_err(raise)?);
    // The pool of the parent process has no threads here: dropping it would wait for them.
    std::mem::forget(pool.replace((process, Arc::clone(&made))));
    Ok(made)
}
