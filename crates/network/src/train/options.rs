use serde::{Deserialize, Serialize};

use crate::{NetworkConfig, NetworkError};

/// Options of training, beside the network and the recordings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainOptions {
    /// Seed of the initial parameters, of sampling and of noise.
    pub seed: u64,
    /// Total number of steps; the learning rate falls to a tenth along a cosine.
    pub steps: u64,
    /// Number of windows per step.
    pub batch: usize,
    /// Maximum learning rate.
    pub learning_rate: f64,
    /// Number of steps until the maximum learning rate.
    pub warmup: u64,
    /// Weight decay of matrices, per step and unit of learning rate.
    pub weight_decay: f64,
    /// Decay rate of the parameters' moving average.
    pub average: f64,
    /// Maximum norm of the gradient; longer ones are clipped.
    pub clip: f64,
    /// Probabilities of dropping conditions.
    pub drop: DropChances,
    /// Expected error of the trained network, as a share of the first guess's error; scales the network's
    /// input and output. A small value makes a network that was trained briefly answer with the mean of the
    /// possible images rather than with noise.
    pub expected_error: f32,
    /// Number of inference steps whose noise levels are trained, T.
    pub infer_steps: usize,
    /// Shift of the noise levels towards the noise.
    pub shift: f64,
    /// Share of windows with the noise levels of a roll: a staircase after some finished frames. The other
    /// windows have an independent level per frame.
    pub staircase: f32,
    /// Share of the other windows that begin with some finished frames, as with strategies that do not roll.
    pub history: f32,
    /// Share of windows that are changed at random: colors, exposures, missing points, reflection.
    pub augment: f32,
    /// Share of windows whose frames have errors like generated ones, so that the network does not trust
    /// earlier frames more than conditions.
    pub errors: f32,
    /// Share of windows with all cameras; the others have a random number of neighboring ones.
    pub all_cameras: f32,
}

/// Probabilities of dropping conditions, per window and independent of each other.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DropChances {
    /// Boxes and map.
    pub layout: f32,
    /// Ego motion.
    pub action: f32,
    /// Color of the points.
    pub color: f32,
    /// Depth of the points.
    pub depth: f32,
    /// All of them at once.
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
            steps: 3000,
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
            history: 0.5,
            augment: 0.9,
            errors: 0.8,
            all_cameras: 0.4,
        }
    }
}

impl TrainOptions {
    /// Checks that the options are consistent and fit a network.
    ///
    /// # Errors
    /// Returns an error if a value is out of range, or if the frames of the window cannot share the inference
    /// steps evenly.
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
        let shares = [
            drop.layout,
            drop.action,
            drop.color,
            drop.depth,
            drop.all,
            self.staircase,
            self.history,
            self.augment,
            self.errors,
            self.all_cameras,
        ];
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

    /// Returns the learning rate of a step: a linear warm-up, then a cosine decay.
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
    fn learning_rate_warms_up_and_decays_to_a_tenth() {
        let options = TrainOptions { steps: 300, warmup: 100, learning_rate: 2.0, ..TrainOptions::default() };
        let rates = [0, 99, 100, 200, 300, 900].map(|step| options.rate(step));
        let expected = [0.02, 2.0, 2.0, 1.1, 0.2, 0.2];
        assert!(rates.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{rates:?}");
    }

    #[test]
    fn rejects_inconsistent_options() {
        let (good, config) = (TrainOptions::default(), NetworkConfig::default());
        good.check(&config).unwrap();
        let refused: [(TrainOptions, &str); 5] = [
            (TrainOptions { infer_steps: 6, ..good }, "multiple of 4, found 6"),
            (TrainOptions { batch: 0, ..good }, "found 3000 and 0"),
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
