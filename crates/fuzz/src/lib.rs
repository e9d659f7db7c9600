//! Fuzz targets: every reader and protocol of `point-skeleton`, each behind a function of bytes.
//!
//! # How it works
//! A target writes its bytes to a file (or answers a socket with them), reads them by the library's public entry and
//! asserts what must hold whatever they are: no panic, an error that ends with the file's name, results within their
//! ranges, the same again after writing. [`run`] adds that memory stays within a small multiple of the bytes. Formats
//! that random bytes hardly get into are changed by value instead: see [`edits`].
//!
//! `ci/fuzz.sh` runs the targets under libFuzzer with coverage; `tests/short.rs` runs the committed corpus and a few
//! mutations of it as a test. `cargo run -p point-skeleton-fuzz --bin seeds` makes the corpus' seeds anew.

mod check;
mod choices;
pub mod edits;
mod folder;
mod made;
mod shared;
mod targets;
mod tiny_log;

use std::cell::RefCell;
use std::collections::BTreeSet;

use peak_alloc::PeakAlloc;

pub use targets::TARGETS;

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

/// What is fuzzed.
pub struct Target {
    /// Of its corpus folder, too.
    pub name: &'static str,
    /// Reads the bytes, and panics if something does not hold.
    pub run: fn(&[u8]),
    /// Inputs to begin with, by name.
    pub seeds: fn() -> Vec<Seed>,
    /// Longest input, bytes.
    pub max_len: usize,
    /// What a run may allocate at most.
    pub memory: Memory,
}

/// A named input.
pub type Seed = (String, Vec<u8>);

/// Memory that a run may take: `fixed + factor * input`, bytes.
#[derive(Clone, Copy)]
pub struct Memory {
    /// Whatever the input is: threads, buffers, the files that are not changed.
    pub fixed: usize,
    /// Per byte of input.
    pub factor: usize,
}

/// The target of a name.
pub fn target(name: &str) -> Option<&'static Target> {
    TARGETS.iter().find(|target| target.name == name)
}

thread_local! {
    /// Targets whose unchanged files are there: making them must not count.
    static READY: RefCell<BTreeSet<&'static str>> = const { RefCell::new(BTreeSet::new()) };
}

/// Runs a target and measures its memory. Allocations of other threads count, so nothing else may run beside it.
///
/// # Panics
/// Something does not hold.
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
