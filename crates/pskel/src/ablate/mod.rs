//! `pskel ablate`: ablation study of the generator. [`rows`] defines the variants, [`scene`] renders their inputs,
//! [`run`] generates and scores one variant in a scene with the shared [`settings`], [`report`] writes the results.

mod report;
mod rows;
mod run;
mod scene;
mod settings;

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context;
use clap::Args;
use point_skeleton::dataset::LogLocator;
use point_skeleton::error::FileError;
use point_skeleton::files::input::is_there;
use point_skeleton::files::{OutputFolder, write_json};
use pskel_network::Network;

use self::report::Report;
use self::rows::{Networks, Row, Table};
use self::run::RunResult;
use self::scene::{Scene, SceneOptions};
use self::settings::Settings;
use super::log_args;
use super::progress::Progress;
use super::rasterizer::RasterizerArgs;
use super::{WrongUsage, say};
use crate::logs;

/// Compare strategies, conditions and trainings of the generator in synthetic towns, where ground truth is known
///
/// In each town the ego changes lanes in a closed loop, and each variant generates the same steps. Writes
/// SCENE/ROW.json and SCENE/ROW.png for each variant, then results.json, table.md and curves as SVG. Existing results
/// are reused, so the command resumes after an interruption and accepts additional networks and towns.
#[derive(Debug, Args)]
pub(super) struct AblateArgs {
    /// Towns that were not used to train the networks: town:seed=904,frames=80[,..]
    #[arg(value_name = "LOG", required = true, value_parser = log_args::log)]
    logs: Vec<LogLocator>,
    /// Weights of `pskel train` [default: those shipped with the program]
    #[arg(long, value_name = "FILE")]
    weights: Option<PathBuf>,
    /// Weights of `pskel train --no-augment`, for the row that measures the effect of asset augmentation
    #[arg(long, value_name = "FILE")]
    plain_weights: Option<PathBuf>,
    /// Weights of the same training with another seed, for a row that measures random variation; may be repeated
    #[arg(long = "other-seed", value_name = "FILE")]
    other_seeds: Vec<PathBuf>,
    /// Tables to compute [default: all]
    #[arg(long, value_name = "TABLE,..", value_delimiter = ',')]
    tables: Vec<Table>,
    /// Folder to write
    #[arg(long, value_name = "DIR", value_parser = log_args::output_folder())]
    out: PathBuf,
    /// Number of frames to generate in each scene, after the references
    #[arg(long, value_name = "N", default_value = "60", value_parser = clap::value_parser!(u16).range(2..))]
    steps: u16,
    /// Inference steps, T [default: frames of the window]
    #[arg(long, value_name = "T", value_parser = clap::value_parser!(u16).range(1..=1000))]
    infer_steps: Option<u16>,
    /// Augment a share of the scenes' assets with this seed, as in training: thinned, or reduced to the points seen
    /// by one camera
    #[arg(long, value_name = "SEED", num_args = 0..=1, require_equals = true, default_missing_value = "0")]
    augment: Option<u64>,
    /// Seed of noise, features and classifiers
    #[arg(long, value_name = "SEED", default_value = "0")]
    seed: u64,
    #[command(flatten)]
    rasterizer: RasterizerArgs,
}

/// Runs the command: renders, generates, scores, writes the report.
pub(super) fn run(args: &AblateArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    log_args::check_towns(&args.logs)?;
    let networks = Networks {
        main: Network::open_or_shipped(args.weights.as_deref())?,
        plain: args.plain_weights.as_deref().map(Network::open).transpose()?,
        others: args.other_seeds.iter().map(|path| Network::open(path)).collect::<Result<_, _>>()?,
    };
    networks.check()?;
    let settings = Settings {
        steps: usize::from(args.steps),
        infer_steps: args.infer_steps.map_or(networks.main.config().frames, usize::from),
        seed: args.seed,
        augment: args.augment,
    };
    let rows = networks.rows(&args.tables)?;
    for row in &rows {
        row.options(&networks, &settings).check().map_err(|error| WrongUsage(error.to_string()))?;
    }
    let files = OutputFolder::open(&args.out, "ablation", &[])?;
    let mut progress = Progress::new(args.logs.len() * rows.len());
    let mut results = Vec::new();
    for locator in &args.logs {
        let of_scene = scene_results(args, &files, locator, (&rows, &networks, &settings), &mut progress);
        results.extend(of_scene.with_context(|| format!("log {locator}"))?);
    }
    drop(progress);
    let report = Report::new(&args.tables, &rows, &results);
    report.write(&files)?;
    files.close()?;
    say(report.table().trim_end());
    let (scenes, seconds) = (args.logs.len(), start.elapsed().as_secs_f64());
    say(&format!("{} variants in {scenes} scenes in {seconds:.2} s: {}", rows.len(), args.out.display()));
    Ok(())
}

/// Returns the results of all rows in a scene. The scene is rendered only if a result is missing.
fn scene_results(
    args: &AblateArgs,
    files: &OutputFolder,
    locator: &LogLocator,
    (rows, networks, settings): (&[Row], &Networks, &Settings),
    progress: &mut Progress,
) -> anyhow::Result<Vec<RunResult>> {
    let town = logs::open_town(locator)?;
    let folder = args.out.join(town.recording());
    std::fs::create_dir_all(&folder).map_err(FileError::io("create", &folder))?;
    let mut scene = None;
    let mut results = Vec::new();
    for row in rows {
        let path = folder.join(format!("{}.json", row.name));
        let known =
            is_there(&path)?.then(|| RunResult::read(&path, &row.origin(networks, settings))).transpose()?;
        let result = match known {
            Some(result) => result,
            None => {
                let scene = match &mut scene {
                    Some(scene) => scene,
                    none => {
                        let options = SceneOptions {
                            recipe: networks.main.recipe(),
                            references: networks.main.config().frames - 1,
                            settings,
                            rasterizer: &args.rasterizer,
                            skeleton: &folder.join("skeleton"),
                        };
                        none.insert(Scene::draw(&town, &options)?)
                    }
                };
                let (result, strip) = run::run(scene, row, networks, settings)?;
                let name = |ending: &str| format!("{}/{}.{ending}", town.recording(), row.name);
                strip.save(&files.claim(name("png"))?)?;
                write_json(&files.claim(name("json"))?, &result)?;
                result
            }
        };
        progress.step(&format!("{}, {}", result.scene, row.name));
        results.push(result);
    }
    Ok(results)
}
