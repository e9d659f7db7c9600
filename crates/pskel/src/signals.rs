//! SIGHUP, SIGINT and SIGTERM end the command: temporary files are removed and peers are ended first.
//!
//! Files appear under their names only when they are complete, so the work can stop at any moment: a separate
//! thread cleans up and exits while the other threads are still running. A second signal exits immediately,
//! unless it arrives together with the first: `timeout` and job schedulers signal a process and then its
//! group.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use point_skeleton::{files, threads};
use pskel_sim::peer;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use signal_hook::{flag, low_level};

use super::terminal::print_progress;

/// Interval within which signals count as one.
const TOGETHER: Duration = Duration::from_millis(500);

static IS_STOPPING: AtomicBool = AtomicBool::new(false);

/// Installs the handlers, except for signals that the parent process had ignored (nohup).
///
/// # Errors
/// Fails if a handler or the thread cannot be created.
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
            // If the thread cannot be started, second signals are not handled.
            let _ = threads::spawn("the thread of second signals", arm);
            stop(signal);
        }
    };
    threads::spawn("the thread of signals", wait)?;
    Ok(())
}

/// Blocks forever if a signal is ending the process: errors during that time are not the command's result.
pub(super) fn wait_if_stopping() {
    while IS_STOPPING.load(Ordering::SeqCst) {
        std::thread::park();
    }
}

fn stop(signal: i32) {
    IS_STOPPING.store(true, Ordering::SeqCst);
    // From here on no thread begins or finishes a file, so results of ended peers are not written.
    files::remove_pending();
    peer::end_all();
    let name = low_level::signal_name(signal).unwrap_or("a signal");
    print_progress(&format!("stopped by {name}: partial files were removed, finished outputs are retained"));
    low_level::exit(exit_code(signal));
}

/// Returns the exit code that shells report for a signal.
fn exit_code(signal: i32) -> i32 {
    128 + signal
}

/// Returns the mask of ignored signals; bit `n - 1` is signal `n`.
fn ignored_signals() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0)
}
