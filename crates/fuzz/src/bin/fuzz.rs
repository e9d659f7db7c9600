//! Runs a target under libFuzzer. `PSKEL_FUZZ_TARGET` names it; if unset, all targets are printed with their
//! maximum input length. `PSKEL_FUZZ_BYTES` names a file to which the total size of all inputs is written
//! about once a second.
#![no_main]
#![allow(clippy::print_stdout)]
#![allow(unsafe_code)] // for the macro's function that libFuzzer calls

use std::cell::RefCell;
use std::path::PathBuf;
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use point_skeleton_fuzz::{TARGETS, Target, run, target};

static TARGET: LazyLock<&Target> = LazyLock::new(|| {
    let name = std::env::var("PSKEL_FUZZ_TARGET").unwrap_or_default();
    target(&name).unwrap_or_else(|| panic!("PSKEL_FUZZ_TARGET must name a target, found {name:?}"))
});

/// Total size of all inputs.
struct Tally {
    file: Option<PathBuf>,
    bytes: u64,
    written: Instant,
}

thread_local! {
    static TALLY: RefCell<Tally> = RefCell::new(Tally {
        file: std::env::var_os("PSKEL_FUZZ_BYTES").map(PathBuf::from),
        bytes: 0,
        written: Instant::now(),
    });
}

fn init() {
    if std::env::var_os("PSKEL_FUZZ_TARGET").is_none() {
        TARGETS.iter().for_each(|target| println!("{} {}", target.name, target.max_len));
        std::process::exit(0);
    }
}

libfuzzer_sys::fuzz_target!(init: init(), |data: &[u8]| {
    run(&TARGET, data);
    TALLY.with_borrow_mut(|tally| {
        tally.bytes += data.len() as u64;
        if let Some(file) = tally.file.as_ref().filter(|_| tally.written.elapsed() > Duration::from_secs(1)) {
            std::fs::write(file, tally.bytes.to_string()).expect("the file of PSKEL_FUZZ_BYTES");
            tally.written = Instant::now();
        }
    });
});
