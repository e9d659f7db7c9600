//! `pskel train`.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context;
use clap::Args;
use point_skeleton::dataset::{LogLocator, LogOpener};
use point_skeleton::files::{FileName, Inputs, is_one_file, own_folder};
use pskel_eval::loss_plot;
use pskel_generate::TrainingClip;
use pskel_network::NetworkConfig;
use pskel_network::train::{
    ClipRecorder, RecordOptions, RunOptions, StepReport, TrainOptions, TrainingFolder, recent_loss,
};

use crate::args::frames::HoldOutArgs;
use crate::args::log::{self, LogRoots};
use crate::args::numbers;
use crate::args::outputs::FolderArgs;
use crate::args::rasterizer::RasterizerArgs;
use crate::progress::Progress;
use crate::{WrongUsage, logs, print_result};

/// Train the small network of `pskel generate` on recorded logs and synthetic towns
///
/// Records training clips first, unless DIR/drives has them: a skeleton of each log, its condition maps,
/// ground-truth images. Everything is determined by logs, options and seed; --resume continues to identical
/// bytes. Writes weights.safetensors, loss.csv and loss.svg.
#[derive(Debug, Args)]
pub(crate) struct TrainArgs {
    /// Logs with images: town:seed=101,frames=40[,..], nuscenes:.., nuplan:.. or av2:..
    #[arg(value_name = "LOG", required = true, value_parser = log::log)]
    logs: Vec<LogLocator>,
    #[command(flatten)]
    roots: LogRoots,
    /// How often each log is drawn from, relative to the others: as many numbers as logs [default: by their
    /// frames]
    #[arg(long, value_name = "W,..", value_delimiter = ',', value_parser = numbers::non_negative)]
    weights: Option<Vec<f64>>,
    #[command(flatten)]
    held_out: HoldOutArgs,
    #[command(flatten)]
    folder: FolderArgs,
    /// Folder of training clips; missing ones are recorded [default: DIR/drives]
    #[arg(long, value_name = "DIR")]
    drives: Option<PathBuf>,
    /// Training clips per log: one at the recorded poses, the others of synthetic logs offset by up to 3.5 m
    /// to the side and rotated by up to 6 degrees
    #[arg(long, value_name = "N", default_value_t = RecordOptions::default().variants as u16,
          value_parser = clap::value_parser!(u16).range(1..=100))]
    variants: u16,
    /// Leave the assets of the other clips unchanged; otherwise a share of them is thinned or reduced to the
    /// points seen by one camera
    #[arg(long)]
    no_augment: bool,
    /// Seed of initial weights, sampling and noise; training clips are the same for all seeds
    #[arg(long, value_name = "SEED", default_value_t = TrainOptions::default().seed)]
    seed: u64,
    /// Total number of steps; 0 only records the training clips
    #[arg(long, value_name = "N", default_value_t = TrainOptions::default().steps)]
    steps: u64,
    /// Windows per step
    #[arg(long, value_name = "N", default_value_t = TrainOptions::default().batch as u16,
          value_parser = clap::value_parser!(u16).range(1..=1024))]
    batch: u16,
    /// Network configuration, as JSON; missing fields are as in the shipped network
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Continue from the last checkpoint, if there is one
    #[arg(long)]
    resume: bool,
    /// Number of steps between checkpoints
    #[arg(long, value_name = "N", default_value_t = RunOptions::default().checkpoint_steps,
          value_parser = clap::value_parser!(u64).range(1..))]
    checkpoint: u64,
    #[command(flatten)]
    rasterizer: RasterizerArgs,
}

/// Runs the command: records, trains, writes.
pub(crate) fn run(args: &TrainArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    log::check_once(&args.logs)?;
    args.check_weights()?;
    let config = args.config.as_deref().map_or_else(|| Ok(NetworkConfig::default()), NetworkConfig::read)?;
    let options = TrainOptions {
        seed: args.seed,
        steps: args.steps,
        batch: usize::from(args.batch),
        infer_steps: 2 * config.frames,
        ..TrainOptions::default()
    };
    config.check()?;
    TrainOptions { steps: args.steps.max(1), ..options }.check(&config)?;
    let drives = args.drives.clone().map_or_else(|| own_folder(&args.folder.out, "drives"), Ok)?;
    if args.steps > 0 && is_one_file(&args.folder.out, &drives) {
        let message = format!("expected two folders for --out and --drives, found {}", drives.display());
        return Err(WrongUsage(message).into());
    }
    let record = RecordOptions {
        variants: usize::from(args.variants),
        augment: !args.no_augment,
        rasterizer: args.rasterizer.desc()?,
    };
    let read = args.inputs();
    let recorder = ClipRecorder { folder: &drives, read: &read, config: &config, options: &record };
    recorder.check()?;
    let files =
        RunOptions { checkpoint_steps: args.checkpoint, resume: args.resume, command: args.command() };
    let folder = (args.steps > 0).then(|| TrainingFolder::open(&args.folder.out, &read)).transpose()?;
    if let Some(folder) = &folder {
        folder.check(&config, &options, &files)?;
        args.check_frames(config.frames)?;
    }
    let (clips, shares) = args.clips(&recorder)?;
    let frames: usize = clips.iter().map(|clip| clip.frames.len()).sum();
    let seconds = start.elapsed().as_secs_f64();
    print_result(&format!(
        "{} drives of {frames} frames in {seconds:.2} s: {}",
        clips.len(),
        drives.display()
    ));
    let Some(folder) = folder else { return Ok(()) };
    let training = folder.start(config, options, files, &clips, shares)?;
    let mut progress = Progress::new(usize::try_from(training.steps_left())?);
    let mut on_step = |report: &StepReport, mean: f64| {
        progress.step(&format!("step {}, loss {mean:.4}", report.step));
    };
    let report = training.run(&|losses, path| loss_plot(losses).write(path), &mut on_step)?;
    drop(progress);
    print_result(&format!(
        "trained {} steps, loss {:.4}, in {:.2} s: {}",
        report.losses.len(),
        recent_loss(&report.losses),
        start.elapsed().as_secs_f64(),
        report.weights.display()
    ));
    Ok(())
}

impl TrainArgs {
    /// Returns everything that is read, except for drives.
    fn inputs(&self) -> Inputs {
        self.roots.inputs(&self.logs).and(&self.config)
    }

    fn check_weights(&self) -> Result<(), WrongUsage> {
        let (Some(weights), logs) = (&self.weights, self.logs.len()) else { return Ok(()) };
        if weights.len() == logs && weights.iter().any(|weight| *weight > 0.0) {
            return Ok(());
        }
        Err(WrongUsage(format!("expected {logs} --weights, not all of them 0, found {weights:?}")))
    }

    /// Checks, before clips are recorded, that each log has as many frames as the windows of the network.
    fn check_frames(&self, least: usize) -> anyhow::Result<()> {
        let opener = LogOpener::new();
        for locator in &self.logs {
            let outline = opener.outline(&self.roots.locate(locator));
            let frames = outline.with_context(|| format!("log {locator}"))?.frames;
            let left = frames - self.held_out.hold_out.map_or(0, |every| frames / usize::from(every));
            let held = if left < frames { " that are not held out" } else { "" };
            anyhow::ensure!(
                left >= least,
                "expected at least {least} frames{held}, the window of the network, found {left}: log \
                    {locator}"
            );
        }
        Ok(())
    }

    /// Returns the clips of all logs, in order, and how often each is drawn from.
    fn clips(&self, recorder: &ClipRecorder<'_>) -> anyhow::Result<(Vec<TrainingClip>, Vec<f64>)> {
        let mut progress = Progress::new(self.logs.len());
        let (mut clips, mut shares, mut names) = (Vec::new(), Vec::new(), Vec::new());
        for (place, locator) in self.logs.iter().enumerate() {
            let (name, log) = logs::open_recording(&self.roots.locate(locator))?;
            let file = FileName::new(&name).with_context(|| format!("log {locator}"))?;
            anyhow::ensure!(
                !names.contains(&file),
                "expected logs of different names, found {file} again: {locator}"
            );
            names.push(file);
            let recorded = recorder.clips(&name, &log).with_context(|| format!("log {locator}"))?;
            let frames: usize = recorded.iter().map(|clip| clip.frames.len()).sum();
            let weight = self.weights.as_ref().map_or(frames as f64, |weights| weights[place]);
            shares.extend(recorded.iter().map(|clip| weight * clip.frames.len() as f64 / frames as f64));
            clips.extend(recorded.into_iter().map(|clip| match self.held_out.hold_out {
                Some(every) => clip.without_every(usize::from(every)),
                None => clip,
            }));
            progress.step(&name);
        }
        Ok((clips, shares))
    }

    /// Returns the command that determines the weights, without output paths and interruptions.
    fn command(&self) -> String {
        let Self { logs, config, variants, no_augment, seed, steps, batch, weights, held_out, .. } = self;
        let logs = logs.iter().map(LogLocator::to_string).collect::<Vec<_>>().join(" ");
        let config = config.as_ref().map_or(String::new(), |path| format!(" --config {}", path.display()));
        let weights = weights.as_ref().map_or(String::new(), |weights| {
            format!(" --weights {}", weights.iter().map(f64::to_string).collect::<Vec<_>>().join(","))
        });
        let held = held_out.hold_out.map_or(String::new(), |every| format!(" --hold-out {every}"));
        let plain = if *no_augment { " --no-augment" } else { "" };
        format!(
            "pskel train {logs}{weights}{held}{config} --variants {variants}{plain} --seed {seed} --steps \
                {steps} --batch {batch}"
        )
    }
}
