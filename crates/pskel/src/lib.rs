//! The command line: one module per subcommand, and the only part that prints to the user.
//!
//! # How it works
//! [`run`] parses the arguments, runs the subcommand and converts its result into an exit code: 0 success, 1
//! failure, 2 wrong usage. Progress and errors go to stderr, the summary line to stdout.

mod advice;
mod args;
mod commands;
pub mod logs;
mod progress;
mod signals;
mod terminal;

use std::ffi::OsString;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::Context;
use clap::{Parser, Subcommand};
use point_skeleton::error::with_causes;
use point_skeleton::files::lacks_locks;
use point_skeleton::memory::variable_limit;
use point_skeleton::threads::start_pool;

use self::terminal::{print_notes, print_progress, print_result, warn, warn_of_boxes_alone};

/// Converts driving recordings into camera conditions: color, metric depth, class, instance and layout maps.
#[derive(Debug, Parser)]
#[command(name = "pskel", version, max_term_width = 110)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Info(commands::info::InfoArgs),
    Build(commands::build::BuildArgs),
    Render(Box<commands::render::RenderArgs>),
    Export(Box<commands::export::ExportArgs>),
    Simulate(Box<commands::simulate::SimulateArgs>),
    #[cfg(feature = "drive")]
    Drive(Box<commands::drive::DriveArgs>),
    Scenario(Box<commands::scenario::ScenarioCommandArgs>),
    Splat(commands::splat::SplatArgs),
    Convert(commands::convert::ConvertArgs),
    Templates(commands::templates::TemplatesArgs),
    Bench(Box<commands::bench::BenchArgs>),
    #[cfg(feature = "town")]
    Town(commands::town::TownArgs),
    #[cfg(feature = "town")]
    Fidelity(Box<commands::fidelity::FidelityArgs>),
    #[cfg(feature = "network")]
    Generate(Box<commands::generate::GenerateArgs>),
    Evaluate(commands::evaluate::EvaluateArgs),
    /// Run an evaluation protocol
    #[cfg(feature = "network")]
    #[command(subcommand, disable_help_subcommand = true)]
    Protocol(commands::protocol::ProtocolCommand),
}

impl Command {
    fn run(self) -> anyhow::Result<()> {
        match self {
            Self::Info(args) => commands::info::run(args),
            Self::Build(args) => commands::build::run(args),
            Self::Render(args) => commands::render::run(*args),
            Self::Export(args) => commands::export::run(&args),
            Self::Simulate(args) => commands::simulate::run(*args),
            #[cfg(feature = "drive")]
            Self::Drive(args) => commands::drive::run(&args),
            Self::Scenario(args) => commands::scenario::run(&args),
            Self::Splat(args) => commands::splat::run(args),
            Self::Convert(args) => commands::convert::run(args),
            Self::Templates(args) => commands::templates::run(&args),
            Self::Bench(args) => commands::bench::run(&args),
            #[cfg(feature = "town")]
            Self::Town(args) => commands::town::run(&args),
            #[cfg(feature = "town")]
            Self::Fidelity(args) => commands::fidelity::run(&args),
            #[cfg(feature = "network")]
            Self::Generate(args) => commands::generate::run(*args),
            Self::Evaluate(args) => commands::evaluate::run(&args),
            #[cfg(feature = "network")]
            Self::Protocol(command) => commands::protocol::run(command),
        }
    }
}

/// Runs the command line `args` (the program's name first) and returns its exit code.
pub fn run(args: impl Iterator<Item = OsString>) -> u8 {
    let cli = match Cli::try_parse_from(args) {
        Ok(cli) => cli,
        Err(error) => {
            // Help and version are also reported as errors, with exit code 0.
            terminal::note(error.print());
            return match terminal::check() {
                Ok(()) => u8::try_from(error.exit_code()).unwrap_or(2),
                Err(_) => FAILURE,
            };
        }
    };
    let done = prepare().and_then(|()| cli.command.run()).and_then(|()| terminal::check());
    signals::wait_if_stopping();
    if lacks_locks() {
        warn("the file system of an output has no locks: make sure that no other process writes there");
    }
    match done {
        Ok(()) => 0,
        Err(error) => {
            terminal::print_progress(&format!("error: {}", with_causes(error.as_ref())));
            if let Some(advice) = advice::advice(&error) {
                terminal::print_progress(&format!("  hint: {advice}"));
            }
            if error.is::<WrongUsage>() { 2 } else { FAILURE }
        }
    }
}

/// Exit code after an error.
const FAILURE: u8 = 1;

/// Invalid combination of options that the parser cannot detect.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct WrongUsage(String);

/// Sets up the process before any command.
fn prepare() -> anyhow::Result<()> {
    args::threads::check_environment()?;
    variable_limit().map_err(|error| WrongUsage(error.to_string()))?;
    survive_file_limits()?;
    signals::install().map_err(|error| anyhow::anyhow!("cannot handle signals: {error}"))?;
    Ok(start_pool()?)
}

/// Makes a write beyond the file size limit return an error, which names the file and cleans up, instead of
/// killing the process.
fn survive_file_limits() -> anyhow::Result<()> {
    let seen = Arc::new(AtomicBool::new(false));
    signal_hook::flag::register(signal_hook::consts::SIGXFSZ, seen).context("cannot handle SIGXFSZ")?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        use clap::CommandFactory;
        Cli::command().debug_assert();
    }
}
