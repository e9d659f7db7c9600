use std::collections::BTreeMap;

use candle_core::backprop::GradStore;
use candle_core::{Device, Result, Tensor, Var};
use rayon::prelude::*;

use super::TrainOptions;

/// Decay rates of the first and second moments.
const FIRST: f32 = 0.9;
const SECOND: f32 = 0.99;
const EPSILON: f32 = 1e-8;

/// Trained parameters, with the state of AdamW and the moving average of each. Source: Loshchilov and Hutter,
/// "Decoupled Weight Decay Regularization", 2019.
#[derive(Debug)]
pub(super) struct State {
    /// Number of steps done.
    pub(super) step: u64,
    /// Parameters by name.
    pub(super) parameters: BTreeMap<String, TrainedParameter>,
}

/// A parameter with its optimizer state.
#[derive(Debug)]
pub(super) struct TrainedParameter {
    pub(super) value: Var,
    /// First and second moments of its gradient.
    pub(super) first: Vec<f32>,
    pub(super) second: Vec<f32>,
    /// Moving average of its values.
    pub(super) average: Vec<f32>,
}

/// Factors of an optimizer step.
#[derive(Clone, Copy)]
struct Factors {
    clip: f32,
    rate: f32,
    /// Square root of the second moment's bias correction.
    second: f32,
    /// Factor of weight decay, for matrices.
    retained: f32,
    average: f32,
}

impl TrainedParameter {
    /// Creates the state before the first step.
    pub(super) fn fresh(value: &Tensor) -> Result<Self> {
        let average = value.flatten_all()?.to_vec1::<f32>()?;
        let zeros = vec![0.0; average.len()];
        Ok(Self { value: Var::from_tensor(value)?, first: zeros.clone(), second: zeros, average })
    }

    fn update(&mut self, gradient: &[f32], by: Factors) -> Result<()> {
        let retained = if self.value.rank() > 1 { by.retained } else { 1.0 };
        let mut values = self.value.flatten_all()?.to_vec1::<f32>()?;
        for (i, value) in values.iter_mut().enumerate() {
            let slope = gradient[i] * by.clip;
            let (first, second) = (&mut self.first[i], &mut self.second[i]);
            *first = FIRST * *first + (1.0 - FIRST) * slope;
            *second = SECOND * *second + (1.0 - SECOND) * slope * slope;
            *value = *value * retained - by.rate * *first / (second.sqrt() / by.second + EPSILON);
            self.average[i] = by.average * self.average[i] + (1.0 - by.average) * *value;
        }
        self.value.set(&Tensor::from_vec(values, self.value.shape(), &Device::Cpu)?)
    }
}

impl State {
    /// Creates the state before the first step.
    pub(super) fn fresh(parameters: BTreeMap<String, Tensor>) -> Result<Self> {
        let trained =
            parameters.iter().map(|(name, value)| Ok((name.clone(), TrainedParameter::fresh(value)?)));
        Ok(Self { step: 0, parameters: trained.collect::<Result<_>>()? })
    }

    /// Returns the trained parameters by reference, without copying their values.
    pub(super) fn tensors(&self) -> BTreeMap<String, Tensor> {
        self.parameters.iter().map(|(name, t)| (name.clone(), t.value.as_tensor().clone())).collect()
    }

    /// Returns the moving averages of the parameters.
    pub(super) fn averages(&self) -> Result<BTreeMap<String, Tensor>> {
        let of = |(name, t): (&String, &TrainedParameter)| {
            Ok((name.clone(), Tensor::from_slice(&t.average, t.value.shape(), &Device::Cpu)?))
        };
        self.parameters.iter().map(of).collect()
    }

    /// Returns the gradients of the parameters in the order of their names, and their joint norm.
    pub(super) fn gradients(&self, gradients: &GradStore) -> Result<(Vec<Vec<f32>>, f64)> {
        let of = |trained: &TrainedParameter| match gradients.get(&trained.value) {
            Some(gradient) => gradient.flatten_all()?.to_vec1::<f32>(),
            None => Ok(vec![0.0; trained.average.len()]),
        };
        let all = self.parameters.values().map(of).collect::<Result<Vec<_>>>()?;
        let squares = |gradient: &Vec<f32>| gradient.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>();
        let length = all.iter().map(squares).sum::<f64>().sqrt();
        Ok((all, length))
    }

    /// Updates the parameters with their gradients, of norm `length`, and then the moving averages.
    pub(super) fn update(
        &mut self,
        options: &TrainOptions,
        gradients: &[Vec<f32>],
        length: f64,
    ) -> Result<()> {
        let done = (self.step + 1).min(i32::MAX as u64) as i32;
        let left = |share: f32| 1.0 - f64::from(share).powi(done);
        let rate = options.rate(self.step);
        // In the first steps, a faster decay keeps the initial parameters from dominating the average.
        let young = (1 + self.step) as f64 / (10 + self.step) as f64;
        let by = Factors {
            clip: (options.clip / length).min(1.0) as f32,
            rate: (rate / left(FIRST)) as f32,
            second: left(SECOND).sqrt() as f32,
            retained: 1.0 - (rate * options.weight_decay) as f32,
            average: options.average.min(young) as f32,
        };
        let all: Vec<_> = self.parameters.values_mut().zip(gradients).collect();
        all.into_par_iter().try_for_each(|(trained, gradient)| trained.update(gradient, by))?;
        self.step += 1;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first step of AdamW moves by the learning rate against the sign of the gradient, after weight
    /// decay.
    #[test]
    fn step_matches_adamw() {
        let options = TrainOptions {
            warmup: 0,
            learning_rate: 0.1,
            weight_decay: 0.5,
            clip: 1e9,
            ..TrainOptions::default()
        };
        let tensor = |shape: &[usize]| Tensor::from_vec(vec![1.0_f32, -2.0], shape, &Device::Cpu).unwrap();
        let parameters = BTreeMap::from([("a".to_owned(), tensor(&[1, 2])), ("b".to_owned(), tensor(&[2]))]);
        let mut state = State::fresh(parameters).unwrap();
        let near =
            |found: &[f32], expected: [f32; 2]| found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6);
        state.update(&options, &[vec![3.0, -4.0], vec![3.0, 0.0]], 1.0).unwrap();
        let values = |state: &State, name: &str| {
            state.parameters[name].value.flatten_all().unwrap().to_vec1::<f32>().unwrap()
        };
        assert!(near(&values(&state, "a"), [0.95 - 0.1, -1.9 + 0.1]), "{:?}", values(&state, "a"));
        assert!(near(&values(&state, "b"), [0.9, -2.0]));
        assert!(near(&state.parameters["b"].average, [0.1 + 0.9 * 0.9, -2.0]));
        // Moments of two steps by hand, with bias correction: 0.9 * 0.3 + 0.1 * 1 and 0.99 * 0.09 + 0.01 * 1.
        let rate = options.rate(1) as f32;
        state.update(&options, &[vec![0.0; 2], vec![1.0, 0.0]], 1.0).unwrap();
        let (first, second) = (0.37 / 0.19, (0.0991_f32 / 0.0199).sqrt());
        assert!(near(&values(&state, "b"), [0.9 - rate * first / second, -2.0]), "{:?}", values(&state, "b"));
    }

    #[test]
    fn long_gradients_are_clipped() {
        let options = TrainOptions { clip: 1.0, warmup: 0, ..TrainOptions::default() };
        let zero =
            || BTreeMap::from([("a".to_owned(), Tensor::from_vec(vec![0.0_f32], 1, &Device::Cpu).unwrap())]);
        let moment = |gradient: f32, length: f64| {
            let mut state = State::fresh(zero()).unwrap();
            state.update(&options, &[vec![gradient]], length).unwrap();
            state.parameters["a"].first[0]
        };
        assert!((moment(30.0, 30.0) - 0.1).abs() < 1e-7 && (moment(0.3, 0.3) - 0.03).abs() < 1e-7);
    }
}
