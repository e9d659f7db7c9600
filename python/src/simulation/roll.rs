use std::sync::{Mutex, MutexGuard, TryLockError};

use numpy::{IntoPyArray, PyArray1, PyArray4, PyArrayMethods};
use point_skeleton::error::with_causes;
use pskel_generate::{
    Cache, Condition, Denoiser, DenoiserError, DroppedConditions, Frame, GaussianNoise, GenerateError,
    GenerateOptions, Generator, Guidance, Latent, LatentShape, Prediction, SamplerOptions, Strategy,
};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyList};

use crate::error::Error;
use crate::maps::arrays::Numbers;
use crate::time::{Committed, Forecast};

/// The denoising loop of the generator with a function as the network: `denoise(latents, timesteps, sigmas,
/// conditions)` receives a window of noisy latents `[F, V, C, h, w]`, their noise levels `[F]` and the
/// conditions of the frames, and returns its prediction `[F, V, C, h, w]`.
///
/// - `shape`: (V, C, h, w) of the latents.
/// - `window`: frames per call of the network, 2 to 64.
/// - `steps`: inference steps; a multiple of `window - clean` for the strategies that roll.
/// - `clean`: frames at the start of the window that are always clean.
/// - `strategy`: reset_and_roll, rolling, causal or non_causal.
/// - `history_noise`: timestep, of 1000, of the noise added to previous frames (strategy causal).
/// - `forecasts`: number of forecasts in the window (strategy non_causal).
/// - `sampler`: flow_match or ddim.
/// - `shift`: shift of the noise levels towards the noise (sampler flow_match).
/// - `prediction`: epsilon, v_prediction (default) or sample (sampler ddim).
/// - `guidance`: scale; other than 1, the network is also called with `condition.without("layout",
///   "action")`.
/// - `seed`: seed of the noise.
///
/// Raises `ValueError` for options that do not fit.
#[pyclass(frozen, module = "pskel")]
pub(crate) struct ResetAndRoll {
    options: GenerateOptions,
    state: Mutex<State>,
}

struct State {
    seed: u64,
    network: Function,
    /// References, until the first step.
    references: Vec<(Latent, pskel_sim::Committed<Value>)>,
    generator: Option<Generator<Function, GaussianNoise>>,
}

#[pymethods]
impl ResetAndRoll {
    #[new]
    #[pyo3(signature = (denoise, shape, *, window=12, steps=36, clean=0, strategy="reset_and_roll",
        history_noise=0, forecasts=1, sampler="flow_match", shift=3.0, prediction=None, guidance=1.0,
        seed=0))]
    #[allow(clippy::too_many_arguments)] // keyword arguments of Python
    fn new(
        denoise: Py<PyAny>,
        shape: [usize; 4],
        window: usize,
        steps: usize,
        clean: usize,
        strategy: &str,
        history_noise: usize,
        forecasts: usize,
        sampler: &str,
        shift: f64,
        prediction: Option<&str>,
        guidance: f32,
        seed: u64,
    ) -> PyResult<Self> {
        let strategy = match strategy {
            "reset_and_roll" => Strategy::ResetAndRoll,
            "rolling" => Strategy::Rolling,
            "causal" => Strategy::Causal { history_noise },
            "non_causal" => Strategy::NonCausal { forecasts },
            other => return Err(wrong("the strategy reset_and_roll, rolling, causal or non_causal", other)),
        };
        if let ("flow_match", Some(found)) = (sampler, prediction) {
            return Err(wrong("no prediction with the sampler flow_match", found));
        }
        let sampler = match sampler {
            "flow_match" if shift.is_finite() && shift > 0.0 => SamplerOptions::FlowMatch { shift },
            "flow_match" => return Err(wrong("a shift above 0", &shift.to_string())),
            "ddim" => SamplerOptions::Ddim { prediction: predicted(prediction.unwrap_or("v_prediction"))? },
            other => return Err(wrong("the sampler flow_match or ddim", other)),
        };
        if !guidance.is_finite() {
            return Err(wrong("a finite guidance", &guidance.to_string()));
        }
        if shape.contains(&0) {
            return Err(wrong("a shape (V, C, h, w) above 0", &format!("{shape:?}")));
        }
        let guidance = Guidance { scale: guidance, ..Guidance::default() };
        let options = GenerateOptions { window, steps, clean, strategy, sampler, guidance };
        options.check().map_err(|error| PyValueError::new_err(with_causes(&error).to_string()))?;
        let [views, channels, height, width] = shape;
        let shape = LatentShape { views, channels, height, width };
        let network = Function { call: denoise, shape };
        let state = State { seed, network, references: Vec::new(), generator: None };
        Ok(Self { options, state: Mutex::new(state) })
    }

    /// Number of reference frames that the loop needs before its first step.
    #[getter]
    fn references(&self) -> usize {
        self.options.references()
    }

    /// Maximum number of forecasts that a step uses.
    #[getter]
    fn forecasts(&self) -> usize {
        self.options.forecasts()
    }

    /// Adds the clean latent of a reference frame, oldest first, with its conditions. Raises `ValueError` for
    /// another shape and for more references than needed.
    fn add_reference(&self, py: Python<'_>, latent: Numbers<'_>, condition: &Committed) -> PyResult<()> {
        let mut state = self.lock()?;
        let count = self.options.references();
        if state.generator.is_some() || state.references.len() == count {
            return Err(wrong(&format!("{count} references"), "one more"));
        }
        let latent = read(&latent, state.network.shape)?;
        state.references.push((latent, condition_of(py, condition)));
        Ok(())
    }

    /// Generates the next frame from its committed condition and forecasts of the next ones, and returns its
    /// latent `[V, C, h, w]`. Raises the exceptions of the network, and `Error` for predictions of another
    /// shape and values that are not finite; the state is then unchanged.
    fn step<'py>(
        &self,
        py: Python<'py>,
        condition: &Committed,
        forecasts: Vec<PyRef<'py, Forecast>>,
    ) -> PyResult<Bound<'py, PyArray4<f32>>> {
        let state = &mut *self.lock()?;
        let shape = state.network.shape.to_array();
        let now = condition_of(py, condition);
        let of = |forecast: &PyRef<'_, Forecast>| {
            pskel_sim::Forecast::new(Value(forecast.inner.get().clone_ref(py)))
        };
        let forecasts: Vec<_> = forecasts.iter().map(of).collect();
        if state.generator.is_none() {
            let count = self.options.references();
            if state.references.len() != count {
                let found = state.references.len().to_string();
                return Err(wrong(&format!("{count} references before the first step"), &found));
            }
            let noise = GaussianNoise { seed: state.seed };
            let references = std::mem::take(&mut state.references);
            let network = state.network.copy(py);
            state.generator = Some(Generator::new(network, noise, self.options, references).map_err(raise)?);
        }
        let Some(generator) = &mut state.generator else { unreachable!("created above") };
        let latent = generator.step(now, &forecasts).map_err(raise)?;
        PyArray1::from_vec(py, latent.values().to_vec()).reshape(shape)
    }

    /// Returns the state between two steps, for `load`. Raises `ValueError` before the first step.
    fn save<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let state = self.lock()?;
        let generator =
            state.generator.as_ref().ok_or_else(|| wrong("a loop that has generated a frame", "none"))?;
        let bytes = generator.cache().to_bytes();
        Ok(PyBytes::new(py, &bytes.map_err(|error| Error::new_err(with_causes(&error).to_string()))?))
    }

    /// Restores a state of a loop with the same options; `conditions`: the references of the last
    /// `references` frames, oldest first. Raises `ValueError` for a damaged state or one of other options.
    fn load(&self, py: Python<'_>, saved: &[u8], conditions: Vec<PyRef<'_, Committed>>) -> PyResult<()> {
        let mut state = self.lock()?;
        let cache = Cache::from_bytes(saved)
            .map_err(|error| PyValueError::new_err(with_causes(&error).to_string()))?;
        let shown = conditions.iter().map(|condition| condition_of(py, condition)).collect();
        let noise = GaussianNoise { seed: state.seed };
        let network = state.network.copy(py);
        let generator = Generator::resume(network, noise, self.options, cache, shown);
        let generator = generator.map_err(|error| PyValueError::new_err(with_causes(&error).to_string()))?;
        state.generator = Some(generator);
        Ok(())
    }
}

impl ResetAndRoll {
    /// Does not wait: the thread that holds the lock may wait for the interpreter, which this one holds.
    fn lock(&self) -> PyResult<MutexGuard<'_, State>> {
        match self.state.try_lock() {
            Ok(state) => Ok(state),
            Err(TryLockError::Poisoned(state)) => Ok(state.into_inner()),
            Err(TryLockError::WouldBlock) => {
                let message = "expected one call of the loop at a time, found another one in progress";
                Err(PyRuntimeError::new_err(message))
            }
        }
    }
}

/// Condition of a frame: any object.
struct Value(Py<PyAny>);

impl Clone for Value {
    fn clone(&self) -> Self {
        Python::attach(|py| Self(self.0.clone_ref(py)))
    }
}

impl Condition for Value {
    fn without(&self, dropped: DroppedConditions) -> Self {
        let DroppedConditions { layout, action, color, depth } = dropped;
        let parts = [("layout", layout), ("action", action), ("color", color), ("depth", depth)];
        let names: Vec<&str> = parts.iter().filter(|(_, dropped)| *dropped).map(|(name, _)| *name).collect();
        Python::attach(|py| {
            let arguments = pyo3::types::PyTuple::new(py, names);
            let called = arguments.and_then(|names| self.0.call_method1(py, "without", names));
            // A failure is found when the network receives the exception as the condition.
            Self(called.unwrap_or_else(|error| error.into_value(py).into_any()))
        })
    }
}

/// A network that is a function.
struct Function {
    call: Py<PyAny>,
    shape: LatentShape,
}

impl Function {
    fn copy(&self, py: Python<'_>) -> Self {
        Self { call: self.call.clone_ref(py), shape: self.shape }
    }

    fn call(&self, py: Python<'_>, window: &[Frame<'_, Value>]) -> PyResult<Vec<Latent>> {
        let values: Vec<f32> = window.iter().flat_map(|frame| frame.latent.values()).copied().collect();
        let [views, channels, height, width] = self.shape.to_array();
        let shape = [window.len(), views, channels, height, width];
        let latents = PyArray1::from_vec(py, values).reshape(shape)?;
        let timesteps: Vec<f32> = window.iter().map(|frame| frame.level.timestep).collect();
        let sigmas: Vec<f32> = window.iter().map(|frame| frame.level.sigma).collect();
        for frame in window {
            let condition = frame.condition.0.bind(py);
            if condition.is_instance_of::<pyo3::exceptions::PyBaseException>() {
                return Err(PyErr::from_value(condition.clone()));
            }
        }
        let conditions = PyList::new(py, window.iter().map(|frame| frame.condition.0.clone_ref(py)))?;
        let arguments = (latents, timesteps.into_pyarray(py), sigmas.into_pyarray(py), conditions);
        let answer = self.call.call1(py, arguments)?;
        let answer: Numbers<'_> = answer.extract(py)?;
        let view = answer.as_array();
        if view.shape() != shape {
            return Err(wrong(&format!("a prediction of {shape:?}"), &format!("{:?}", view.shape())));
        }
        let frames = view.outer_iter().map(|frame| {
            let values = frame.iter().map(|value| *value as f32).collect();
            Latent::new(self.shape, values).ok_or_else(|| wrong("a latent", "another"))
        });
        frames.collect()
    }
}

impl Denoiser for Function {
    type Condition = Value;

    fn shape(&self) -> LatentShape {
        self.shape
    }

    fn predict(&mut self, window: &[Frame<'_, Value>]) -> Result<Vec<Latent>, DenoiserError> {
        Python::attach(|py| self.call(py, window)).map_err(|error| DenoiserError::Network(Box::new(error)))
    }
}

fn condition_of(py: Python<'_>, committed: &Committed) -> pskel_sim::Committed<Value> {
    committed.inner.as_ref().map(|value| Value(value.clone_ref(py)))
}

fn read(latent: &Numbers<'_>, shape: LatentShape) -> PyResult<Latent> {
    let view = latent.as_array();
    if view.shape() != shape.to_array() {
        return Err(wrong(&format!("a latent of {shape}"), &format!("{:?}", view.shape())));
    }
    let values: Vec<f32> = view.iter().map(|value| *value as f32).collect();
    if let Some(value) = values.iter().find(|value| !value.is_finite()) {
        return Err(wrong("finite values of a latent", &value.to_string()));
    }
    Latent::new(shape, values).ok_or_else(|| wrong("a latent", "another"))
}

fn predicted(text: &str) -> PyResult<Prediction> {
    match text {
        "epsilon" => Ok(Prediction::Epsilon),
        "v_prediction" => Ok(Prediction::Velocity),
        "sample" => Ok(Prediction::Sample),
        other => Err(wrong("the prediction epsilon, v_prediction or sample", other)),
    }
}

/// Converts an error of the loop; exceptions of the network pass unchanged.
fn raise(error: GenerateError) -> PyErr {
    let text = with_causes(&error).to_string();
    match error {
        GenerateError::Denoiser { source: DenoiserError::Network(source), .. } => {
            source.downcast::<PyErr>().map_or_else(|_| Error::new_err(text), |error| *error)
        }
        GenerateError::Options { .. } => PyValueError::new_err(text),
        _ => Error::new_err(text),
    }
}

fn wrong(expected: &str, found: &str) -> PyErr {
    PyValueError::new_err(format!("expected {expected}, found {found}"))
}
