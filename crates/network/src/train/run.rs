//! A training in a folder: its steps, checkpoints and output files.

use std::path::{Path, PathBuf};

use point_skeleton::error::FileError;
use point_skeleton::files::input::is_there;
use point_skeleton::files::json::{Difference, difference};
use point_skeleton::files::{Inputs, OutputFolder};
use pskel_generate::TrainingClip;
use serde_json::{Value, json};

use super::checkpoint;
use super::losses::{self, recent_loss};
use super::{StepReport, TrainOptions, Trainer};
use crate::{NetworkConfig, NetworkError};

/// Options of a training's files.
#[derive(Clone, Debug)]
pub struct RunOptions {
    /// Number of steps between checkpoints, at least 1.
    pub checkpoint_steps: u64,
    /// Whether the training continues from the last checkpoint, if there is one.
    pub resume: bool,
    /// Command line that is recorded in the file of the weights.
    pub command: String,
}

impl Default for RunOptions {
    fn default() -> Self {
        Self { checkpoint_steps: 200, resume: false, command: String::new() }
    }
}

/// Output folder of a training, locked while it is open.
pub struct TrainingFolder {
    path: PathBuf,
    files: OutputFolder,
}

/// A training in a folder.
pub struct Training<'c> {
    folder: TrainingFolder,
    trainer: Trainer<'c>,
    options: RunOptions,
    losses: Vec<StepReport>,
}

/// Result of a training.
#[derive(Clone, Debug)]
pub struct TrainingReport {
    /// All steps.
    pub losses: Vec<StepReport>,
    /// File of the weights.
    pub weights: PathBuf,
}

/// Writes a plot of the losses to a file.
pub type PlotLosses<'a> = &'a dyn Fn(&[StepReport], &Path) -> Result<(), FileError>;

/// Kind of the output folder.
const KIND: &str = "training";
const CHECKPOINT: &str = "checkpoint.safetensors";
const WEIGHTS: &str = "weights.safetensors";
const LOSS: &str = "loss.csv";
const CURVE: &str = "loss.svg";

impl TrainingFolder {
    /// Opens a new or empty folder, or the folder of an earlier training.
    ///
    /// # Errors
    /// Fails if the folder is in use, has other files or is one of `inputs`, or if it cannot be written.
    pub fn open(path: &Path, inputs: &Inputs) -> Result<Self, FileError> {
        let files = OutputFolder::open(path, KIND, inputs)?;
        files.check([CHECKPOINT, WEIGHTS, LOSS, CURVE])?;
        Ok(Self { path: path.to_owned(), files })
    }

    /// Checks, before clips are recorded, that a training that is resumed began with the same options and
    /// network.
    ///
    /// # Errors
    /// Fails if it began with others, or if its checkpoint is damaged.
    pub fn check(
        &self,
        config: &NetworkConfig,
        train: &TrainOptions,
        options: &RunOptions,
    ) -> Result<(), NetworkError> {
        let checkpoint = self.path.join(CHECKPOINT);
        if !(options.resume && is_there(&checkpoint)?) {
            return Ok(());
        }
        let (header, _) = checkpoint::open(&checkpoint)?;
        let before = json!({"options": header.options, "network": header.config});
        check_same(&before, &json!({"options": train, "network": config}), &checkpoint)
    }

    /// Starts or resumes a training on clips, whose windows are drawn with probabilities in the ratio of
    /// `shares`.
    ///
    /// # Errors
    /// Fails if the options or the configuration are inconsistent, if the clips do not fit them, or if the
    /// checkpoint is damaged or has other options.
    pub fn start<'c>(
        self,
        config: NetworkConfig,
        train: TrainOptions,
        options: RunOptions,
        clips: &'c [TrainingClip],
        shares: Vec<f64>,
    ) -> Result<Training<'c>, NetworkError> {
        let checkpoint = self.path.join(CHECKPOINT);
        let trainer = match options.resume && is_there(&checkpoint)? {
            true => resume(&checkpoint, (&config, &train, &shares), clips)?,
            false => Trainer::new(train, config, clips, shares)?,
        };
        let losses = losses::read(&self.path.join(LOSS), trainer.done())?;
        Ok(Training { folder: self, trainer, options, losses })
    }
}

/// Resumes a training with the same options. These include the number of steps, on which the learning rate
/// depends.
fn resume<'c>(
    checkpoint: &Path,
    (config, train, shares): (&NetworkConfig, &TrainOptions, &[f64]),
    clips: &'c [TrainingClip],
) -> Result<Trainer<'c>, NetworkError> {
    let trainer = Trainer::resume(checkpoint, clips)?;
    let before =
        json!({"options": trainer.options(), "network": trainer.config(), "shares": trainer.shares()});
    check_same(&before, &json!({"options": train, "network": config, "shares": shares}), checkpoint)?;
    Ok(trainer)
}

/// Names only the first difference: all options together are longer than a message.
fn check_same(before: &Value, now: &Value, checkpoint: &Path) -> Result<(), NetworkError> {
    match difference(before, now) {
        None => Ok(()),
        Some(Difference { place, values: [before, now] }) => {
            let expected = format!("the options of the earlier training, {place} {before}");
            Err(FileError::content(expected, now, checkpoint).into())
        }
    }
}

impl Training<'_> {
    /// Returns the number of remaining steps.
    pub fn steps_left(&self) -> u64 {
        self.trainer.options().steps - self.trainer.done()
    }

    /// Takes all remaining steps and writes checkpoints, weights and losses. `progress` receives each step
    /// and the mean loss of the last ones.
    ///
    /// # Errors
    /// Fails if the loss diverges or if a file cannot be written.
    pub fn run(
        mut self,
        plot: PlotLosses<'_>,
        progress: &mut dyn FnMut(&StepReport, f64),
    ) -> Result<TrainingReport, NetworkError> {
        while !self.trainer.is_done() {
            let report = self.trainer.step()?;
            self.losses.push(report);
            progress(&report, recent_loss(&self.losses));
            if self.trainer.done().is_multiple_of(self.options.checkpoint_steps) && !self.trainer.is_done() {
                self.write(plot)?;
            }
        }
        self.write(plot)?;
        self.folder.files.close()?;
        Ok(TrainingReport { losses: self.losses, weights: self.folder.path.join(WEIGHTS) })
    }

    /// Writes the checkpoint last, so that the files it refers to exist.
    fn write(&self, plot: PlotLosses<'_>) -> Result<(), NetworkError> {
        let files = &self.folder.files;
        losses::write(&files.claim(LOSS)?, &self.losses)?;
        plot(&self.losses, &files.claim(CURVE)?)?;
        self.trainer.weights(&self.options.command)?.write(&files.claim(WEIGHTS)?)?;
        self.trainer.save(&files.claim(CHECKPOINT)?)
    }
}
