//! `pskel ablate`.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context;
use clap::Args;
use point_skeleton::dataset::LogLocator;
use point_skeleton::files::{Inputs, check_place};
use pskel_eval::ablate::{AblateError, AblateOptions, Ablation, Networks, RunResult, Table};
use pskel_network::Network;

use crate::args::log::{self, LogRoots};
use crate::args::names::names;
use crate::args::rasterizer::RasterizerArgs;
use crate::progress::Progress;
use crate::{WrongUsage, logs, say};

/// Compare strategies, conditions and trainings of the generator in synthetic towns and recorded logs
///
/// In each town the ego changes lanes in a closed loop; in a recorded log it follows the log, since the
/// ground truth is known only there. Each variant generates the same steps. Writes SCENE/ROW.json and
/// SCENE/ROW.png for each variant, then results.json, table.md and curves as SVG. Existing results are
/// reused, so the command resumes after an interruption and accepts additional networks and logs.
#[derive(Debug, Args)]
pub(crate) struct AblateArgs {
    /// Logs that were not used to train the networks: town:seed=904,frames=80[,..], nuscenes:.., nuplan:.. or
    /// av2:..
    #[arg(value_name = "LOG", required = true, value_parser = log::log)]
    logs: Vec<LogLocator>,
    #[command(flatten)]
    roots: LogRoots,
    /// Weights of `pskel train` [default: those shipped with the program]
    #[arg(long, value_name = "FILE")]
    weights: Option<PathBuf>,
    /// Weights of `pskel train --no-augment`, for the row that measures the effect of asset augmentation
    #[arg(long, value_name = "FILE")]
    plain_weights: Option<PathBuf>,
    /// Weights of the same training with another seed, for a row that measures random variation; may be
    /// repeated
    #[arg(long = "other-seed", value_name = "FILE")]
    other_seeds: Vec<PathBuf>,
    /// Tables to compute [default: all]
    #[arg(long, value_name = "TABLE,..", value_delimiter = ',', value_parser = names::<Table>())]
    tables: Vec<Table>,
    /// Folder to write
    #[arg(long, value_name = "DIR", value_parser = log::output_folder())]
    out: PathBuf,
    /// Number of frames to generate in each scene, after the references
    #[arg(long, value_name = "N", default_value_t = AblateOptions::default().steps as u16,
          value_parser = clap::value_parser!(u16).range(2..))]
    steps: u16,
    /// Inference steps, T [default: frames of the window]
    #[arg(long, value_name = "T", value_parser = clap::value_parser!(u16).range(1..=1000))]
    infer_steps: Option<u16>,
    /// With causal, noise on the previous frames, in steps of 1000
    #[arg(long, value_name = "N", default_value_t = 0)]
    history_noise: usize,
    /// With non_causal, forecasts in the window
    #[arg(long, value_name = "K", default_value_t = AblateOptions::default().ahead)]
    ahead: usize,
    /// Augment a share of the scenes' assets with this seed, as in training: thinned, or reduced to the
    /// points seen by one camera
    #[arg(long, value_name = "SEED", num_args = 0..=1, require_equals = true, default_missing_value = "0")]
    augment: Option<u64>,
    /// Seed of the noise
    #[arg(long, value_name = "SEED", default_value_t = AblateOptions::default().seed)]
    seed: u64,
    #[command(flatten)]
    rasterizer: RasterizerArgs,
}

/// Runs the command: renders, generates, scores, writes the report.
pub(crate) fn run(args: &AblateArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    log::check_once(&args.logs)?;
    args.check_tables()?;
    let rasterizer = args.rasterizer.desc()?;
    let read = args.inputs();
    check_place(&args.out, &read)?; // before a log is read for the networks
    let cameras = args.cameras()?;
    let open = |path: &PathBuf| Network::open(path, cameras);
    let networks = Networks {
        main: Network::open_or_shipped(args.weights.as_deref(), cameras)?,
        plain: args.plain_weights.as_ref().map(open).transpose()?,
        others: args.other_seeds.iter().map(open).collect::<Result<_, _>>()?,
    };
    let options = AblateOptions {
        steps: usize::from(args.steps),
        infer_steps: args.infer_steps.map(usize::from),
        seed: args.seed,
        augment: args.augment,
        history_noise: args.history_noise,
        ahead: args.ahead,
    };
    let opened = Ablation::open((&args.out, &read), networks, &args.tables, options);
    let mut study = opened.map_err(usage)?;
    let variants = study.variants();
    let mut progress = Progress::new(args.logs.len() * variants);
    let mut on_result = |result: &RunResult| progress.step(&format!("{}, {}", result.scene, result.row));
    for locator in &args.logs {
        let context = || format!("log {locator}");
        let opened = logs::open_recording(&args.roots.locate(locator));
        let (name, log) = opened.with_context(context)?;
        study.add_scene(&name, &log, &rasterizer, &mut on_result).with_context(context)?;
    }
    drop(progress);
    say(study.finish()?.table().trim_end());
    let (scenes, seconds) = (args.logs.len(), start.elapsed().as_secs_f64());
    say(&format!("{variants} variants in {scenes} scenes in {seconds:.2} s: {}", args.out.display()));
    Ok(())
}

impl AblateArgs {
    /// Returns everything that is read.
    fn inputs(&self) -> Inputs {
        let weights = self.weights.iter().chain(&self.plain_weights).chain(&self.other_seeds);
        self.roots.inputs(&self.logs).and(weights)
    }

    /// Returns the number of cameras of the first log, which all logs must have.
    fn cameras(&self) -> anyhow::Result<usize> {
        let Some(first) = self.logs.first() else { return Ok(0) };
        let opened = logs::open(&self.roots.locate(first));
        let dataset = opened.with_context(|| format!("log {first}"))?;
        Ok(dataset.recording().cameras.len())
    }

    /// Checks that tables which compare other weights are requested together with these weights.
    fn check_tables(&self) -> Result<(), WrongUsage> {
        let given = [
            (Table::Augmentation, "--plain-weights", self.plain_weights.is_some()),
            (Table::Seeds, "--other-seed", !self.other_seeds.is_empty()),
        ];
        let wrong = given.into_iter().find(|(table, _, given)| *given != self.tables.contains(table));
        let Some((table, option, given)) = wrong.filter(|_| !self.tables.is_empty()) else { return Ok(()) };
        let (table, found) = (table.name(), if given { "the weights alone" } else { "the table alone" });
        Err(WrongUsage(format!("expected {option} and table {table} together, found {found}")))
    }
}

/// Converts invalid options into [`WrongUsage`], which has its own exit code.
fn usage(error: AblateError) -> anyhow::Error {
    match error {
        AblateError::Networks { .. } | AblateError::Generate(_) => WrongUsage(error.to_string()).into(),
        _ => error.into(),
    }
}
