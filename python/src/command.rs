//! The command line, for `python -m pskel`.

use std::ffi::OsString;

use pyo3::prelude::*;

/// Runs the command line `args` (the program's name first) and returns its exit code.
#[pyfunction]
pub(crate) fn run_command(py: Python<'_>, args: Vec<OsString>) -> u8 {
    py.detach(|| pskel::run(args.into_iter()))
}
