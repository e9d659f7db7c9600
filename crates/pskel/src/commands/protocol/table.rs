//! Tables of several methods.

use std::path::PathBuf;

use clap::Args;
use pskel_eval::protocol::{MethodTable, TableFormat};

use crate::args::names::names;
use crate::print_result;

/// Join the results of several methods, folders of protocol commands, into one table
///
/// Says what cannot be compared: other clips or frames, options, networks or references.
#[derive(Debug, Args)]
pub(crate) struct TableArgs {
    /// Folders with results.json, one per method
    #[arg(value_name = "DIR", required = true)]
    folders: Vec<PathBuf>,
    /// Format of the table
    #[arg(long, default_value_t, value_parser = names::<TableFormat>())]
    format: TableFormat,
    /// Add the figures of the paper to its parts, marked as published
    #[arg(long)]
    published: bool,
}

/// Reads the results and prints the table.
pub(super) fn run(args: &TableArgs) -> anyhow::Result<()> {
    let table = MethodTable::read(&args.folders)?;
    print_result(table.format(args.format, args.published).trim_end());
    Ok(())
}
