//! `pskel train`: [`args`] defines the options, [`drives`] manages the training clips, [`record`] records them,
//! [`steps`] trains.

mod args;
mod drives;
mod record;
mod steps;

pub(super) use args::TrainArgs;

use std::path::Path;
use std::time::Instant;

use point_skeleton::error::FileError;
use point_skeleton::files::input::read_table;
use pskel_network::NetworkConfig;
use pskel_network::train::TrainOptions;

use self::drives::Recording;
use self::steps::{Training, recent};
use super::{log_args, say};

/// Runs the command: records, trains, writes.
pub(super) fn run(args: &TrainArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    log_args::check_towns(&args.logs)?;
    let config = config(args.config.as_deref())?;
    let options = TrainOptions {
        seed: args.seed,
        steps: args.steps,
        batch: usize::from(args.batch),
        infer_steps: 2 * config.frames,
        ..TrainOptions::default()
    };
    config.check()?;
    TrainOptions { steps: args.steps.max(1), ..options }.check(&config)?;
    let folder = args.drives.clone().unwrap_or_else(|| args.out.join("drives"));
    let recording = Recording {
        folder: &folder,
        recipe: &config.recipe,
        cameras: config.cameras,
        variants: usize::from(args.variants),
        augment: !args.no_augment,
        rasterizer: &args.rasterizer,
    };
    let files = (args.steps > 0).then(|| steps::open(&args.out)).transpose()?;
    let drives = recording.drives(&args.logs)?;
    let frames: usize = drives.iter().map(|drive| drive.frames.len()).sum();
    let seconds = start.elapsed().as_secs_f64();
    say(&format!("{} drives of {frames} frames in {seconds:.2} s: {}", drives.len(), folder.display()));
    let Some(files) = files else { return Ok(()) };
    let training = Training {
        folder: &args.out,
        options,
        config,
        checkpoint_steps: args.checkpoint,
        command: args.command(),
    };
    let losses = training.run(files, &drives, args.resume)?;
    say(&format!(
        "trained {} steps, loss {:.4}, in {:.2} s: {}",
        losses.len(),
        recent(&losses),
        start.elapsed().as_secs_f64(),
        training.weights().display()
    ));
    Ok(())
}

fn config(path: Option<&Path>) -> Result<NetworkConfig, FileError> {
    let Some(path) = path else { return Ok(NetworkConfig::default()) };
    let text = read_table(path)?;
    serde_json::from_slice(&text)
        .map_err(|e| FileError::content("a network's configuration", e.to_string(), path))
}
