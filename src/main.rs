//! The command `pskel`.

use std::process::ExitCode;

fn main() -> ExitCode {
    point_skeleton::cli::main(std::env::args_os())
}
