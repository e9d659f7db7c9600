//! SIGHUP, SIGINT and SIGTERM end the command: temporary files are removed and peers ended first.
//!
//! Files appear under their names only when they are whole, so the work can stop at any moment: a thread of its own
//! cleans up and exits, while the others are still at work. A second signal exits at once, but not one that comes
//! together with the first: `timeout` and job schedulers signal a process and then its group.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use signal_hook::{flag, low_level};

use super::terminal::tell;
use crate::{files, peer};

/// Signals so close together are one.
const TOGETHER: Duration = Duration::from_millis(500);

static IS_STOPPING: AtomicBool = AtomicBool::new(false);

/// Installs the handlers, but for signals that the parent process had ignored (nohup).
///
/// # Errors
/// Those of the system.
pub(super) fn install() -> std::io::Result<()> {
    let ignored = ignored_signals();
    let handled = [SIGHUP, SIGINT, SIGTERM].into_iter().filter(|signal| ignored >> (signal - 1) & 1 == 0);
    let handled: Vec<i32> = handled.collect();
    let is_second = Arc::new(AtomicBool::new(false));
    for &signal in &handled {
        flag::register_conditional_shutdown(signal, exit_code(signal), is_second.clone())?;
    }
    let mut signals = Signals::new(&handled)?;
    let wait = move || {
        if let Some(signal) = signals.forever().next() {
            let arm = move || {
                std::thread::sleep(TOGETHER);
                is_second.store(true, Ordering::SeqCst);
            };
            // Without this thread there is no second signal.
            let _ = std::thread::Builder::new().name("second signal".to_owned()).spawn(arm);
            stop(signal);
        }
    };
    std::thread::Builder::new().name("signals".to_owned()).spawn(wait)?;
    Ok(())
}

/// Blocks for good if a signal is ending the process: what fails meanwhile is not the command's result.
pub(super) fn wait_if_stopping() {
    while IS_STOPPING.load(Ordering::SeqCst) {
        std::thread::park();
    }
}

fn stop(signal: i32) {
    IS_STOPPING.store(true, Ordering::SeqCst);
    // From here on no thread begins or finishes a file, so what fails for want of a peer is not written.
    files::remove_pending();
    peer::end_all();
    let name = low_level::signal_name(signal).unwrap_or("a signal");
    tell(&format!("stopped by {name}: nothing half-written is left, finished outputs stay"));
    low_level::exit(exit_code(signal));
}

/// As shells report it.
fn exit_code(signal: i32) -> i32 {
    128 + signal
}

/// Bit `n - 1` is signal `n`.
fn ignored_signals() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0)
}
