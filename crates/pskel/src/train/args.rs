use std::path::PathBuf;

use clap::Args;
use point_skeleton::dataset::LogLocator;
use pskel_network::train::TrainOptions;

use crate::log_args;
use crate::rasterizer::RasterizerArgs;

/// Train the small network of `pskel generate` on recordings of synthetic towns
///
/// Records training clips first, unless DIR/drives has them: a skeleton of each town, its condition maps,
/// ground-truth images. Everything is determined by logs, options and seed; --resume continues to identical bytes.
/// Writes weights.safetensors, loss.csv and loss.svg.
#[derive(Debug, Args)]
pub(crate) struct TrainArgs {
    /// Synthetic towns: town:seed=101,frames=40[,..]
    #[arg(value_name = "LOG", required = true, value_parser = log_args::log)]
    pub(super) logs: Vec<LogLocator>,
    /// Folder to write
    #[arg(long, value_name = "DIR", value_parser = log_args::output_folder())]
    pub(super) out: PathBuf,
    /// Folder of training clips; missing ones are recorded [default: DIR/drives]
    #[arg(long, value_name = "DIR")]
    pub(super) drives: Option<PathBuf>,
    /// Training clips per log: one at the recorded poses, the others offset by up to 3.5 m to the side and rotated by
    /// up to 6 degrees
    #[arg(long, value_name = "N", default_value = "3", value_parser = clap::value_parser!(u16).range(1..=100))]
    pub(super) variants: u16,
    /// Leave the assets of the other clips unchanged; otherwise a share of them is thinned or reduced to the points
    /// seen by one camera
    #[arg(long)]
    pub(super) no_augment: bool,
    /// Seed of initial weights, sampling and noise; training clips are the same for all seeds
    #[arg(long, value_name = "SEED", default_value = "1")]
    pub(super) seed: u64,
    /// Total number of steps; 0 only records the training clips
    #[arg(long, value_name = "N", default_value_t = TrainOptions::default().steps)]
    pub(super) steps: u64,
    /// Windows per step
    #[arg(long, value_name = "N", default_value_t = TrainOptions::default().batch as u16,
          value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub(super) batch: u16,
    /// Network configuration, as JSON; missing fields are as in the shipped network
    #[arg(long, value_name = "FILE")]
    pub(super) config: Option<PathBuf>,
    /// Continue from the last checkpoint, if there is one
    #[arg(long)]
    pub(super) resume: bool,
    /// Number of steps between checkpoints
    #[arg(long, value_name = "N", default_value = "200", value_parser = clap::value_parser!(u64).range(1..))]
    pub(super) checkpoint: u64,
    #[command(flatten)]
    pub(super) rasterizer: RasterizerArgs,
}

impl TrainArgs {
    /// Returns the command that determines the weights, without output paths and interruptions.
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
