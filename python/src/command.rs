//! The command line, for `python -m pskel`.

use std::ffi::OsString;

use pyo3::prelude::*;

/// Runs the command line `args` (the program's name first) and returns whether it succeeded.
#[pyfunction]
pub(crate) fn run_command(py: Python<'_>, args: Vec<OsString>) -> bool {
    py.detach(|| pskel::main(args.into_iter())) == std::process::ExitCode::SUCCESS
}
