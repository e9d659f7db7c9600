use serde::{Deserialize, Serialize};

use crate::generate::network::{NetworkConfig, NetworkError};

/// What training depends on, beside the network and the drives.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainOptions {
    /// What first parameters, choices and noise follow from.
    pub seed: u64,
    /// Steps in all: the learning rate falls to a tenth along a cosine.
    pub steps: u64,
    /// Windows a step.
    pub batch: usize,
    /// Highest learning rate.
    pub learning_rate: f64,
    /// Steps until it is reached.
    pub warmup: u64,
    /// Decay of matrices, per step and learning rate.
    pub weight_decay: f64,
    /// Share of the parameters' moving average that a step leaves.
    pub average: f64,
    /// Longest gradient.
    pub clip: f64,
    /// How often conditions are dropped.
    pub drop: DropChances,
    /// Share of the first guess's error that the trained network is expected to leave: what it is shown and what it answers
    /// are scaled for that. Little of it makes a network that was trained for a short time answer with the mean of what
    /// could be there rather than with noise.
    pub expected_error: f32,
    /// Inference steps whose levels of noise are trained for, T.
    pub infer_steps: usize,
    /// Shift of the levels towards the noise.
    pub shift: f64,
    /// Share of windows with levels as in a roll: a staircase, after some finished frames. Others have an independent level
    /// per frame.
    pub staircase: f32,
    /// Share of those others that begin with some finished frames, as strategies without rolls have it.
    pub history: f32,
}

/// How often conditions are dropped, per window and independently.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DropChances {
    /// Boxes and map.
    pub layout: f32,
    /// The ego's motion.
    pub action: f32,
    /// Color of the points.
    pub color: f32,
    /// Depth of the points.
    pub depth: f32,
    /// All of them.
    pub all: f32,
}

impl Default for DropChances {
    fn default() -> Self {
        Self { layout: 0.1, action: 0.1, color: 0.15, depth: 0.15, all: 0.04 }
    }
}

impl Default for TrainOptions {
    fn default() -> Self {
        Self {
            seed: 1,
            steps: 6000,
            batch: 1,
            learning_rate: 1e-3,
            warmup: 100,
            weight_decay: 0.01,
            average: 0.999,
            clip: 1.0,
            drop: DropChances::default(),
            expected_error: 0.4,
            infer_steps: 8,
            shift: 3.0,
            staircase: 0.5,
            history: 0.0,
        }
    }
}

impl TrainOptions {
    /// Whether they go together, and with a network.
    ///
    /// # Errors
    /// Counts of zero, shares that are none, inference steps that the window's frames cannot share.
    pub fn check(&self, config: &NetworkConfig) -> Result<(), NetworkError> {
        let Self { batch, infer_steps, shift, drop, .. } = *self;
        let wrong = |expected: String, found: String| Err(NetworkError::input(expected, found));
        if self.steps == 0 || !(1..=1024).contains(&batch) {
            return wrong("a step and 1 to 1024 windows".to_owned(), format!("{} and {batch}", self.steps));
        }
        if !(1..=1000).contains(&infer_steps) || infer_steps % config.frames != 0 {
            let expected = format!("up to 1000 inference steps, a multiple of {}", config.frames);
            return wrong(expected, infer_steps.to_string());
        }
        let shares =
            [drop.layout, drop.action, drop.color, drop.depth, drop.all, self.staircase, self.history];
        if let Some(other) = shares.iter().find(|share| !(0.0..=1.0).contains(*share)) {
            return wrong("shares of 0 to 1".to_owned(), other.to_string());
        }
        let numbers = [self.learning_rate, self.clip, shift, f64::from(self.expected_error)];
        if let Some(other) = numbers.iter().find(|number| !(number.is_finite() && **number > 0.0)) {
            return wrong(
                "a learning rate, clip, shift and expected error above 0".to_owned(),
                other.to_string(),
            );
        }
        if !(0.0..1.0).contains(&self.average) || !(0.0..).contains(&self.weight_decay) {
            let found = format!("{} and {}", self.average, self.weight_decay);
            return wrong("an average of 0 to below 1 and no negative decay".to_owned(), found);
        }
        Ok(())
    }

    /// Learning rate of a step: rises along a line, falls along a cosine.
    pub fn rate(&self, step: u64) -> f64 {
        if step < self.warmup {
            return self.learning_rate * (step + 1) as f64 / self.warmup as f64;
        }
        let rest = self.steps.saturating_sub(self.warmup).max(1);
        let done = ((step - self.warmup) as f64 / rest as f64).min(1.0);
        self.learning_rate * (0.1 + 0.45 * (1.0 + (std::f64::consts::PI * done).cos()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_rises_and_falls_to_a_tenth() {
        let options = TrainOptions { steps: 300, warmup: 100, learning_rate: 2.0, ..TrainOptions::default() };
        let rates = [0, 99, 100, 200, 300, 900].map(|step| options.rate(step));
        let expected = [0.02, 2.0, 2.0, 1.1, 0.2, 0.2];
        assert!(rates.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{rates:?}");
    }

    #[test]
    fn what_does_not_go_together_is_refused() {
        let (good, config) = (TrainOptions::default(), NetworkConfig::default());
        good.check(&config).unwrap();
        let refused: [(TrainOptions, &str); 5] = [
            (TrainOptions { infer_steps: 6, ..good }, "multiple of 4, found 6"),
            (TrainOptions { batch: 0, ..good }, "found 6000 and 0"),
            (TrainOptions { staircase: 1.5, ..good }, "0 to 1, found 1.5"),
            (TrainOptions { learning_rate: f64::NAN, ..good }, "above 0, found NaN"),
            (TrainOptions { average: 1.0, ..good }, "found 1 and"),
        ];
        for (options, said) in refused {
            let error = options.check(&config).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
    }
}
