//! Parameters in the layouts of the kernels, from arrays in PyTorch's layouts.

use super::images::{Stage, Weights3x3};
use crate::kernels::{LANES, Linear};

/// Source of named arrays.
pub(crate) trait Arrays {
    type Error;

    /// Returns the values of an array with a shape.
    ///
    /// # Errors
    /// Fails if there is no such array, or if it has another shape.
    fn take(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f32>, Self::Error>;
}

/// Arrays of a module by its name.
pub(crate) struct Module<'a, A> {
    arrays: &'a mut A,
    name: String,
}

impl<'a, A: Arrays> Module<'a, A> {
    pub(crate) fn new(arrays: &'a mut A, name: &str) -> Self {
        Self { arrays, name: name.to_owned() }
    }

    /// Returns a module of this one.
    pub(crate) fn part(&mut self, name: &str) -> Module<'_, A> {
        Module { name: format!("{}.{name}", self.name), arrays: self.arrays }
    }

    pub(crate) fn array(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f32>, A::Error> {
        self.arrays.take(&format!("{}.{name}", self.name), shape)
    }

    /// Reads a convolution: `weight [D, C, 3, 3]` and `bias [D]`.
    pub(crate) fn convolution(
        &mut self,
        name: &str,
        channels: usize,
        outputs: usize,
    ) -> Result<Weights3x3, A::Error> {
        let given = self.array(&format!("{name}.weight"), &[outputs, channels, 3, 3])?;
        let bias = self.array(&format!("{name}.bias"), &[outputs])?;
        let mut weights = vec![0.0; given.len()];
        for (place, value) in given.into_iter().enumerate() {
            let (tap, channel, output) = (place % 9, place / 9 % channels, place / 9 / channels);
            weights[(tap * channels + channel) * outputs + output] = value;
        }
        Ok(Weights3x3 { channels, outputs, weights, bias })
    }

    /// Reads two convolutions, `a` and `b`.
    pub(crate) fn stage(&mut self, name: &str, channels: usize, outputs: usize) -> Result<Stage, A::Error> {
        let mut part = self.part(name);
        let a = part.convolution("a", channels, outputs)?;
        Ok(Stage { a, b: part.convolution("b", outputs, outputs)? })
    }

    /// Reads a linear layer without bias: `weight [N, K]`.
    pub(crate) fn linear(&mut self, name: &str, inputs: usize, outputs: usize) -> Result<Linear, A::Error> {
        let given = self.array(&format!("{name}.weight"), &[outputs, inputs])?;
        let columns = outputs.next_multiple_of(LANES);
        let mut weights = vec![0.0; inputs * columns];
        for (place, value) in given.into_iter().enumerate() {
            weights[place % inputs * columns + place / inputs] = value;
        }
        Ok(Linear { inputs, outputs, weights, bias: vec![0.0; columns] })
    }

    /// Reads a linear layer with `bias [N]`.
    pub(crate) fn biased(&mut self, name: &str, inputs: usize, outputs: usize) -> Result<Linear, A::Error> {
        let mut linear = self.linear(name, inputs, outputs)?;
        let bias = self.array(&format!("{name}.bias"), &[outputs])?;
        linear.bias[..outputs].copy_from_slice(&bias);
        Ok(linear)
    }
}
