use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use clap::Args;
use point_skeleton::dataset::LogLocator;
use point_skeleton::files::{Inputs, check_place};
use pskel_eval::protocol::ablation::{
    Ablation, AblationError, AblationOptions, Networks, RunResult, Table, Variant,
};
use pskel_network::{Network, NetworkName};

use super::logs::ProtocolLogs;
use crate::args::names::names;
use crate::args::rasterizer::RasterizerArgs;
use crate::progress::Progress;
use crate::{WrongUsage, logs, print_result};

/// Any logs: strategies, conditions and trainings of the generator, compared on the same frames
///
/// In each town the ego changes lanes in a closed loop; in a recorded log it follows the log, since the
/// ground truth is known only there. Use logs that were not used to train the networks. Writes SCENE/ROW.json
/// and SCENE/ROW.png for each variant, then results.json, table.md and curves as SVG. Existing results are
/// reused, so the command resumes after an interruption and accepts additional networks and logs.
#[derive(Debug, Args)]
pub(crate) struct AblationArgs {
    #[command(flatten)]
    given: ProtocolLogs,
    /// Tables to compute [default: all]
    #[arg(long, value_name = "PART,..", value_delimiter = ',', value_parser = names::<Table>())]
    parts: Vec<Table>,
    /// Network: network (shipped with the program), or network:FILE with weights of `python -m pskel.train`
    #[arg(long, value_name = "NETWORK", default_value = "network")]
    generator: NetworkName,
    /// Weights of `python -m pskel.train --variant NAME`, for a row with the conditions of that training; may
    /// be repeated. NAME is layout, previous_clean, previous_noised, color, depth, augmentation,
    /// relative_depth or metric_depth
    #[arg(long = "variant", value_name = "NAME=FILE", value_parser = variant)]
    variants: Vec<(Variant, PathBuf)>,
    /// Weights of the same training with another seed, for a row that measures random variation; may be
    /// repeated
    #[arg(long = "other-seed", value_name = "FILE")]
    other_seeds: Vec<PathBuf>,
    /// Number of frames to generate in each scene, after the references
    #[arg(long, value_name = "N", default_value_t = AblationOptions::default().steps as u16,
          value_parser = clap::value_parser!(u16).range(2..))]
    steps: u16,
    /// Seed of the noise
    #[arg(long, value_name = "SEED", default_value_t = AblationOptions::default().seed)]
    noise_seed: u64,
    #[command(flatten)]
    rasterizer: RasterizerArgs,
}

/// Renders, generates, scores, writes the report.
pub(super) fn run(args: &AblationArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    let weights = args.weights()?;
    args.check_tables()?;
    let (locators, out) = (args.given.expand()?, &args.given.folder.out);
    let rasterizer = args.rasterizer.desc()?;
    let read = args.inputs(&locators, weights);
    check_place(out, &read)?; // before a log is read for the networks
    let cameras = cameras(&locators)?;
    let open = |path: &PathBuf| Network::open(path, cameras);
    let networks = Networks {
        main: Network::open_or_shipped(weights, cameras)?,
        variants: args.open_variants(cameras)?,
        others: args.other_seeds.iter().map(open).collect::<Result<_, _>>()?,
    };
    let options = AblationOptions { steps: usize::from(args.steps), seed: args.noise_seed };
    let mut study = Ablation::open((out, &read), networks, &args.parts, options).map_err(usage)?;
    let variants = study.variants();
    let mut progress = Progress::new(locators.len() * variants);
    let mut on_result = |result: &RunResult| progress.step(&format!("{}, {}", result.scene, result.row));
    for locator in &locators {
        let context = || format!("log {locator}");
        let (name, log) = logs::open_recording(locator).with_context(context)?;
        let scene = (name.as_str(), &log, args.given.skeletons.skeletons.join(&name));
        study.add_scene(scene, &rasterizer, &mut on_result).with_context(context)?;
    }
    drop(progress);
    print_result(study.finish()?.table().trim_end());
    let (scenes, seconds) = (locators.len(), start.elapsed().as_secs_f64());
    print_result(&format!("{variants} variants in {scenes} scenes in {seconds:.2} s: {}", out.display()));
    Ok(())
}

/// Returns the number of cameras in the first log, which all logs must have.
fn cameras(locators: &[LogLocator]) -> anyhow::Result<usize> {
    let Some(first) = locators.first() else { return Ok(0) };
    let dataset = logs::open(first).with_context(|| format!("log {first}"))?;
    Ok(dataset.recording().cameras.len())
}

impl AblationArgs {
    /// Returns the file of weights; `None` for the shipped ones.
    fn weights(&self) -> Result<Option<&Path>, WrongUsage> {
        match &self.generator {
            NetworkName::Network(path) => Ok(path.as_deref()),
            other => Err(WrongUsage(format!("expected --generator network or network:FILE, found {other}"))),
        }
    }

    /// Opens the networks of variants, each of which may be given once.
    fn open_variants(&self, cameras: usize) -> anyhow::Result<Vec<(Variant, Network)>> {
        let mut opened: Vec<(Variant, Network)> = Vec::new();
        for (variant, path) in &self.variants {
            if opened.iter().any(|(other, _)| other == variant) {
                let name = variant.name();
                return Err(WrongUsage(format!("expected each --variant once, found {name} again")).into());
            }
            opened.push((*variant, Network::open(path, cameras)?));
        }
        Ok(opened)
    }

    /// Returns everything that is read, except for skeletons.
    fn inputs(&self, locators: &[LogLocator], weights: Option<&Path>) -> Inputs {
        let variants = self.variants.iter().map(|(_, path)| path);
        let others = variants.chain(&self.other_seeds).map(PathBuf::as_path);
        Inputs::new(locators.iter().flat_map(LogLocator::inputs)).and(weights.into_iter().chain(others))
    }

    /// Checks that tables which compare other weights are requested together with these weights.
    fn check_tables(&self) -> Result<(), WrongUsage> {
        let given = [
            (Table::Trainings, "--variant", !self.variants.is_empty()),
            (Table::Seeds, "--other-seed", !self.other_seeds.is_empty()),
        ];
        let wrong = given.into_iter().find(|(table, _, given)| *given != self.parts.contains(table));
        let Some((table, option, given)) = wrong.filter(|_| !self.parts.is_empty()) else { return Ok(()) };
        let (table, found) = (table.name(), if given { "the weights alone" } else { "the part alone" });
        Err(WrongUsage(format!("expected {option} and part {table} together, found {found}")))
    }
}

/// Parses the name of a variant and the file of its weights.
fn variant(text: &str) -> Result<(Variant, PathBuf), String> {
    let (name, path) = text.split_once('=').ok_or_else(|| format!("expected NAME=FILE, found {text:?}"))?;
    let variant = name.parse::<Variant>().map_err(|error| error.to_string())?;
    Ok((variant, PathBuf::from(path)))
}

/// Converts invalid options into [`WrongUsage`], which has its own exit code.
fn usage(error: AblationError) -> anyhow::Error {
    match error {
        AblationError::Networks { .. } | AblationError::Generate(_) => WrongUsage(error.to_string()).into(),
        _ => error.into(),
    }
}
