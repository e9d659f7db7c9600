//! Threads of the tensor library, which panics where it cannot start them.

use std::sync::{Mutex, PoisonError};

use candle_core::utils::{barrier_pool, get_num_threads};
use point_skeleton::threads::{ThreadError, probe};

/// Starts the threads of the tensor library, once.
///
/// # Errors
/// Fails if the system starts fewer.
pub(super) fn start() -> Result<(), ThreadError> {
    static IS_STARTED: Mutex<bool> = Mutex::new(false);
    let mut is_started = IS_STARTED.lock().unwrap_or_else(PoisonError::into_inner);
    if !*is_started {
        let asked = std::env::var("CANDLE_NUM_THREADS").ok().and_then(|text| text.parse::<usize>().ok());
        let threads = asked.filter(|threads| *threads > 0).unwrap_or_else(get_num_threads);
        // The calling thread is one of them.
        probe(threads.saturating_sub(1), "the threads of the tensor library")?;
        barrier_pool();
        *is_started = true;
    }
    Ok(())
}
