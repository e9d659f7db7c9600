use std::path::PathBuf;

use clap::Args;

use crate::cli::log_args;
use crate::cli::rasterizer::RasterizerArgs;
use crate::dataset::LogLocator;
use crate::generate::train::TrainOptions;

/// Train the small network of `pskel generate` on drives in the built-in town
///
/// Records drives first, unless DIR/drives has them: a skeleton of each town, its condition maps, true images. Everything
/// follows from logs, options and seed; --resume goes on to the same bytes. Leaves weights.safetensors, loss.csv and
/// loss.svg.
#[derive(Debug, Args)]
pub(in crate::cli) struct TrainArgs {
    /// Towns: town:seed=101,frames=40[,..]
    #[arg(value_name = "LOG", required = true, value_parser = log_args::log)]
    pub(super) logs: Vec<LogLocator>,
    /// Folder to write
    #[arg(long, value_name = "DIR", value_parser = log_args::output_folder())]
    pub(super) out: PathBuf,
    /// Folder of recorded drives; those that are missing are recorded [default: DIR/drives]
    #[arg(long, value_name = "DIR")]
    pub(super) drives: Option<PathBuf>,
    /// Drives of each log: one as it was driven, the others from up to 3.5 m beside and turned by up to 6 degrees
    #[arg(long, value_name = "N", default_value = "3", value_parser = clap::value_parser!(u16).range(1..=100))]
    pub(super) variants: u16,
    /// Leave the assets of the other drives as they are; else a share of them is thinned or cut to what one camera sees
    #[arg(long)]
    pub(super) no_augment: bool,
    /// What first weights, choices and noise follow from; drives are the same for all seeds
    #[arg(long, value_name = "SEED", default_value = "1")]
    pub(super) seed: u64,
    /// Steps in all; 0 records the drives alone
    #[arg(long, value_name = "N", default_value_t = TrainOptions::default().steps)]
    pub(super) steps: u64,
    /// Windows a step
    #[arg(long, value_name = "N", default_value_t = TrainOptions::default().batch as u16,
          value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub(super) batch: u16,
    /// Network, as JSON; what is missing is as shipped
    #[arg(long, value_name = "FILE")]
    pub(super) config: Option<PathBuf>,
    /// Go on from the last checkpoint, if there is one
    #[arg(long)]
    pub(super) resume: bool,
    /// Steps from one checkpoint to the next
    #[arg(long, value_name = "N", default_value = "200", value_parser = clap::value_parser!(u64).range(1..))]
    pub(super) checkpoint: u64,
    #[command(flatten)]
    pub(super) rasterizer: RasterizerArgs,
}

impl TrainArgs {
    /// What weights follow from, as a command: not where they are written, nor how often that was interrupted.
    pub(super) fn command(&self) -> String {
        let Self { logs, config, variants, no_augment, seed, steps, batch, .. } = self;
        let logs = logs.iter().map(LogLocator::to_string).collect::<Vec<_>>().join(" ");
        let config = config.as_ref().map_or(String::new(), |path| format!(" --config {}", path.display()));
        let plain = if *no_augment { " --no-augment" } else { "" };
        format!(
            "pskel train {logs}{config} --variants {variants}{plain} --seed {seed} --steps {steps} --batch {batch}"
        )
    }
}
