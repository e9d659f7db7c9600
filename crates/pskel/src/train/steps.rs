//! The steps of a training, and its output files.

use std::path::{Path, PathBuf};

use point_skeleton::error::FileError;
use point_skeleton::files::input::{is_there, read_text};
use point_skeleton::files::{OutputFolder, write_whole};
use pskel_eval::plot::{Curve, Plot};
use pskel_generate::TrainingClip;
use pskel_network::NetworkConfig;
use pskel_network::train::{StepReport, TrainOptions, Trainer};
use serde::{Deserialize, Serialize};

use crate::progress::Progress;

/// Folder and settings of a training.
pub(super) struct Training<'a> {
    pub(super) folder: &'a Path,
    pub(super) options: TrainOptions,
    pub(super) config: NetworkConfig,
    pub(super) checkpoint_steps: u64,
    /// Command line, for the file of the weights.
    pub(super) command: String,
}

/// A line of `loss.csv`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Loss {
    pub(super) step: u64,
    pub(super) loss: f64,
    pub(super) gradient_norm: f64,
    pub(super) learning_rate: f64,
}

/// Kind of the output folder.
const KIND: &str = "training";
const CHECKPOINT: &str = "checkpoint.safetensors";
const WEIGHTS: &str = "weights.safetensors";
const LOSS: &str = "loss.csv";
const CURVE: &str = "loss.svg";
/// Number of last steps for the plotted and reported mean.
const RECENT: usize = 100;
const HEADER: &str = "step,loss,gradient_norm,learning_rate";

impl From<StepReport> for Loss {
    fn from(report: StepReport) -> Self {
        let StepReport { step, loss, gradient_norm, learning_rate } = report;
        Self { step, loss, gradient_norm, learning_rate }
    }
}

/// Opens the folder of a training, before anything is recorded.
pub(super) fn open(folder: &Path) -> Result<OutputFolder, FileError> {
    let files = OutputFolder::open(folder, KIND, &[])?;
    files.check([CHECKPOINT, WEIGHTS, LOSS, CURVE])?;
    Ok(files)
}

impl Training<'_> {
    /// Runs all remaining steps and writes the weights. Returns the losses of all steps.
    pub(super) fn run(
        &self,
        files: OutputFolder,
        drives: &[TrainingClip],
        resume: bool,
    ) -> anyhow::Result<Vec<Loss>> {
        let checkpoint = self.folder.join(CHECKPOINT);
        let mut trainer = match resume && is_there(&checkpoint)? {
            true => self.resumed(&checkpoint, drives)?,
            false => Trainer::new(self.options, self.config.clone(), drives)?,
        };
        let mut losses = read_losses(&self.folder.join(LOSS), trainer.done())?;
        let left = self.options.steps - trainer.done();
        let mut progress = Progress::new(usize::try_from(left)?);
        while !trainer.is_done() {
            let report = trainer.step()?;
            losses.push(report.into());
            progress.step(&format!("step {}, loss {:.4}", report.step, recent(&losses)));
            if trainer.done().is_multiple_of(self.checkpoint_steps) && !trainer.is_done() {
                self.write(&files, &trainer, &losses)?;
            }
        }
        self.write(&files, &trainer, &losses)?;
        files.close()?;
        Ok(losses)
    }

    /// Writes the checkpoint last, so that the files it refers to exist.
    fn write(&self, files: &OutputFolder, trainer: &Trainer<'_>, losses: &[Loss]) -> anyhow::Result<()> {
        write_losses(&files.claim(LOSS)?, losses)?;
        plot(losses).write(&files.claim(CURVE)?)?;
        trainer.weights(&self.command)?.write(&files.claim(WEIGHTS)?)?;
        Ok(trainer.save(&files.claim(CHECKPOINT)?)?)
    }

    /// Resumes a training with the same options. These include the number of steps, on which the learning rate
    /// depends.
    fn resumed<'d>(&self, checkpoint: &Path, drives: &'d [TrainingClip]) -> anyhow::Result<Trainer<'d>> {
        let trainer = Trainer::resume(checkpoint, drives)?;
        let text = |options: &TrainOptions, config: &NetworkConfig| format!("{options:?} of {config:?}");
        let (before, now) = (text(trainer.options(), trainer.config()), text(&self.options, &self.config));
        if before != now {
            return Err(FileError::content(before, now, checkpoint).into());
        }
        Ok(trainer)
    }

    /// Returns the path of the weights.
    pub(super) fn weights(&self) -> PathBuf {
        self.folder.join(WEIGHTS)
    }
}

/// Returns the mean loss of the last steps.
pub(super) fn recent(losses: &[Loss]) -> f64 {
    let last = &losses[losses.len().saturating_sub(RECENT)..];
    last.iter().map(|loss| loss.loss).sum::<f64>() / last.len().max(1) as f64
}

/// Plots the loss of each step, and its mean over the last ones.
fn plot(losses: &[Loss]) -> Plot<'static> {
    let each = losses.iter().map(|loss| [loss.step as f64, loss.loss]);
    let mean = (1..=losses.len()).map(|end| [(end - 1) as f64, recent(&losses[..end])]);
    let curve = |name: &str, points, is_faint| Curve { name: name.to_owned(), points, is_faint };
    Plot {
        title: "Training",
        axes: ["step", "loss"],
        curves: vec![
            curve("a step", each.collect(), true),
            curve(&format!("mean of {RECENT} steps"), mean.collect(), false),
        ],
    }
}

fn read_losses(path: &Path, done: u64) -> Result<Vec<Loss>, FileError> {
    if done == 0 {
        return Ok(Vec::new());
    }
    let text = read_text(path)?;
    let wrong = |line: &str| FileError::content(format!("lines of {HEADER}"), line, path);
    let loss = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        let &[step, loss, norm, rate] = cells.as_slice() else { return None };
        let number = |cell: &str| cell.parse::<f64>().ok();
        Some(Loss {
            step: step.parse().ok()?,
            loss: number(loss)?,
            gradient_norm: number(norm)?,
            learning_rate: number(rate)?,
        })
    };
    let lines = text.lines().skip(1).map(|line| loss(line).ok_or_else(|| wrong(line)));
    let losses: Vec<Loss> = lines.collect::<Result<_, _>>()?;
    let known = losses.into_iter().filter(|loss| loss.step < done).collect::<Vec<_>>();
    if known.len() as u64 != done {
        return Err(FileError::content(format!("{done} steps"), known.len().to_string(), path));
    }
    Ok(known)
}

fn write_losses(path: &Path, losses: &[Loss]) -> Result<(), FileError> {
    use std::io::Write;
    write_whole(path, |out| {
        let mut line = |text: String| writeln!(out, "{text}").map_err(FileError::io("write", path));
        line(HEADER.to_owned())?;
        losses.iter().try_for_each(|loss| {
            let Loss { step, loss, gradient_norm, learning_rate } = loss;
            line(format!("{step},{loss},{gradient_norm},{learning_rate}"))
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_are_read_as_they_were_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(LOSS);
        let loss =
            |step: u64| Loss { step, loss: 1.0 / (step + 3) as f64, gradient_norm: 0.1, learning_rate: 1e-3 };
        let losses: Vec<Loss> = (0..5).map(loss).collect();
        write_losses(&path, &losses).unwrap();
        assert_eq!(read_losses(&path, 5).unwrap(), losses);
        assert_eq!(read_losses(&path, 3).unwrap(), losses[..3]);
        assert!(read_losses(&path, 0).unwrap().is_empty());
        let error = read_losses(&path, 6).unwrap_err().to_string();
        assert!(error.contains("expected 6 steps, found 5"), "{error}");
        std::fs::write(&path, "step,loss\n1,x\n").unwrap();
        assert!(read_losses(&path, 1).unwrap_err().to_string().contains("found 1,x"));
    }
}
