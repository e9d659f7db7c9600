//! Fuzz targets: every reader and protocol of `point-skeleton`, each as a function of bytes.
//!
//! # How it works
//! A target writes its bytes to a file (or sends them through a socket), reads them through the library's
//! public API and asserts the invariants: no panic, an error that ends with the file's name, results within
//! their ranges, equality after writing and reading again. [`run`] also checks that memory stays within a
//! small multiple of the bytes. Formats that random bytes rarely match are edited by value instead; see
//! [`edits`].
//!
//! `ci/fuzz.sh` runs the targets under libFuzzer with coverage. `tests/short.rs` runs the committed corpus
//! and a few mutations of it as a test. `cargo run -p point-skeleton-fuzz --bin seeds` regenerates the seeds
//! of the corpus.

mod check;
mod choices;
pub mod edits;
mod folder;
mod synthetic_log;
mod targets;

use std::cell::RefCell;
use std::collections::BTreeSet;

use peak_alloc::PeakAlloc;

pub use targets::TARGETS;

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

/// Fuzz target.
pub struct Target {
    /// Name of the target and of its corpus folder.
    pub name: &'static str,
    /// Reads the bytes, and panics if an invariant does not hold.
    pub run: fn(&[u8]),
    /// Initial inputs, by name.
    pub seeds: fn() -> Vec<Seed>,
    /// Maximum length of an input, bytes.
    pub max_len: usize,
    /// Memory limit of a run.
    pub memory: Memory,
}

/// Name and bytes of an input.
pub type Seed = (String, Vec<u8>);

/// Memory limit of a run: `fixed + factor * input`, bytes.
#[derive(Clone, Copy)]
pub struct Memory {
    /// Constant part: threads, buffers, the unchanged files.
    pub fixed: usize,
    /// Bytes per byte of input.
    pub factor: usize,
}

/// Returns the target of a name.
pub fn target(name: &str) -> Option<&'static Target> {
    TARGETS.iter().find(|target| target.name == name)
}

thread_local! {
    /// Targets whose unchanged files exist: creating them must not count.
    static READY: RefCell<BTreeSet<&'static str>> = const { RefCell::new(BTreeSet::new()) };
}

/// Runs a target and measures its memory. Allocations of other threads count, so nothing else may run beside
/// it.
///
/// # Panics
/// Panics if an invariant does not hold or the run exceeds its memory limit.
pub fn run(target: &'static Target, data: &[u8]) {
    if READY.with_borrow_mut(|ready| ready.insert(target.name)) {
        (target.run)(&[]);
    }
    MEMORY.reset_peak_usage();
    let before = MEMORY.current_usage();
    (target.run)(data);
    let taken = MEMORY.peak_usage().saturating_sub(before);
    let most = target.memory.fixed + target.memory.factor * data.len();
    assert!(taken <= most, "{}: {taken} bytes of memory for {} of input", target.name, data.len());
}
