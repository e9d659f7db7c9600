use std::path::Path;

use point_skeleton::conditions::{DepthEmbedding, TensorEncoder};
use point_skeleton::error::FileError;
use pskel_generate::TrainingClip;

use super::TrainOptions;
use super::batch::Source;
use super::checkpoint::{self, Header, fingerprint};
use super::objective::{LossWeights, loss};
use super::optimizer::State;
use super::statistics::{check, measure};
use crate::{Model, NetworkConfig, NetworkError, Provenance, Statistics, Weights, fresh};

/// Trains a network on recordings, step by step.
pub struct Trainer<'a> {
    options: TrainOptions,
    config: NetworkConfig,
    statistics: Statistics,
    drives: &'a [TrainingClip],
    fingerprint: String,
    shares: Vec<f64>,
    encoder: TensorEncoder,
    state: State,
}

/// Result of a training step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepReport {
    /// Number of the step, from 0.
    pub step: u64,
    /// Weighted mean square error of the answers; about 1 if the network reaches the expected error.
    pub loss: f64,
    /// Norm of the gradient before clipping.
    pub gradient_norm: f64,
    /// Learning rate of the step.
    pub learning_rate: f64,
}

impl<'a> Trainer<'a> {
    /// Computes the statistics of the recordings and creates the initial parameters. Windows are drawn from
    /// the recordings with probabilities in the ratio of `shares`.
    ///
    /// # Errors
    /// Returns an error if the options or the configuration are inconsistent, or if the recordings do not fit
    /// them.
    pub fn new(
        options: TrainOptions,
        config: NetworkConfig,
        drives: &'a [TrainingClip],
        shares: Vec<f64>,
    ) -> Result<Self, NetworkError> {
        config.check()?;
        options.check(&config)?;
        check_shares(&shares, drives.len())?;
        let mut statistics = measure(&config, drives)?;
        statistics.priors.iter_mut().for_each(|prior| *prior *= options.expected_error);
        let state = State::fresh(fresh(&config, options.seed)?)?;
        let fingerprint = fingerprint(drives);
        Self::of(Header { options, config, statistics, step: 0, fingerprint, shares }, drives, state)
    }

    /// Resumes from a file written by [`Trainer::save`], with the same recordings.
    ///
    /// # Errors
    /// Fails if the file is not a readable checkpoint, or if the recordings differ.
    pub fn resume(path: &Path, drives: &'a [TrainingClip]) -> Result<Self, NetworkError> {
        let (header, state) = checkpoint::open(path)?;
        check(&header.config, drives)?;
        let found = fingerprint(drives);
        if found != header.fingerprint {
            let expected = format!("the drives that it began with, {}", header.fingerprint);
            return Err(FileError::content(expected, format!("others, {found}"), path).into());
        }
        Self::of(header, drives, state)
    }

    fn of(header: Header, drives: &'a [TrainingClip], state: State) -> Result<Self, NetworkError> {
        let Header { options, config, statistics, fingerprint, shares, .. } = header;
        check_shares(&shares, drives.len())?;
        let encoder = TensorEncoder::new(config.recipe.bins, DepthEmbedding::Both);
        Ok(Self { options, config, statistics, drives, fingerprint, shares, encoder, state })
    }

    /// Options that training was started with.
    pub fn options(&self) -> &TrainOptions {
        &self.options
    }

    /// Configuration of the network.
    pub fn config(&self) -> &NetworkConfig {
        &self.config
    }

    /// Statistics of the recordings, with priors scaled by the expected error of the trained network.
    pub fn statistics(&self) -> &Statistics {
        &self.statistics
    }

    /// Probability of each recording, relative to the others.
    pub fn shares(&self) -> &[f64] {
        &self.shares
    }

    /// Number of steps done.
    pub fn done(&self) -> u64 {
        self.state.step
    }

    /// Returns whether all steps are done.
    pub fn is_done(&self) -> bool {
        self.state.step >= self.options.steps
    }

    /// Takes a training step.
    ///
    /// # Errors
    /// Returns an error if the loss or the gradient is not finite; the parameters are then unchanged.
    pub fn step(&mut self) -> Result<StepReport, NetworkError> {
        let step = self.state.step;
        let source = Source {
            options: &self.options,
            config: &self.config,
            drives: self.drives,
            shares: &self.shares,
            statistics: &self.statistics,
            encoder: &self.encoder,
        };
        let batch = source.batch(step)?;
        let model = Model::new(&self.config, &self.statistics, self.state.tensors())?;
        let expected_error = self.options.expected_error;
        let weighing = LossWeights { priors: &self.statistics.priors, expected_error };
        let loss = loss(&model, &self.config, &batch, self.options.batch, weighing)?;
        let value = f64::from(loss.to_scalar::<f32>()?);
        finite("loss", step, value)?;
        let (gradients, gradient_norm) = self.state.gradients(&loss.backward()?)?;
        finite("gradient", step, gradient_norm)?;
        let learning_rate = self.options.rate(step);
        self.state.update(&self.options, &gradients, gradient_norm)?;
        Ok(StepReport { step, loss: value, gradient_norm, learning_rate })
    }

    /// Writes a checkpoint for [`Trainer::resume`].
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), NetworkError> {
        let header = Header {
            options: self.options,
            config: self.config.clone(),
            statistics: self.statistics.clone(),
            step: self.state.step,
            fingerprint: self.fingerprint.clone(),
            shares: self.shares.clone(),
        };
        checkpoint::save(path, &header, &self.state)
    }

    /// Returns the current weights: the moving average of the parameters. The file records `command`.
    ///
    /// # Errors
    /// Returns any error of the tensor library.
    pub fn weights(&self, command: &str) -> Result<Weights, NetworkError> {
        let mut logs: Vec<String> = self.drives.iter().map(|drive| drive.about.log.clone()).collect();
        logs.dedup(); // a log can have several recordings
        Ok(Weights {
            config: self.config.clone(),
            statistics: self.statistics.clone(),
            about: Provenance {
                seed: self.options.seed,
                steps: self.state.step,
                logs,
                command: command.to_owned(),
            },
            parameters: self.state.averages()?,
        })
    }
}

fn check_shares(shares: &[f64], drives: usize) -> Result<(), NetworkError> {
    let is_share = |share: &f64| share.is_finite() && *share >= 0.0;
    if shares.len() == drives && shares.iter().all(is_share) && shares.iter().any(|share| *share > 0.0) {
        return Ok(());
    }
    let expected = format!("{drives} shares of recordings from 0, not all of them 0");
    Err(NetworkError::input(expected, format!("{shares:?}")))
}

fn finite(what: &'static str, step: u64, value: f64) -> Result<(), NetworkError> {
    if value.is_finite() { Ok(()) } else { Err(NetworkError::NotFinite { what, step, found: value }) }
}
