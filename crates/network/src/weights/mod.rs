pub(super) mod config;

use std::collections::{BTreeMap, HashMap};
use std::hash::Hasher;
use std::path::Path;

use bytemuck::{cast_slice, pod_collect_to_vec};
use point_skeleton::error::FileError;
use point_skeleton::files::input::read_table;
use point_skeleton::files::json;
use point_skeleton::files::write_whole;
use pskel_generate::Recipe;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rand_seeder::{Seeder, SipHasher};
use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};
use serde::{Deserialize, Serialize};

use super::model::{Arrays, Model};
use super::{NetworkConfig, NetworkError, Statistics};

/// Provenance of weights.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Seed of the training.
    pub seed: u64,
    /// Number of training steps.
    pub steps: u64,
    /// Logs in the training data.
    pub logs: Vec<String>,
    /// Command that trained the weights.
    pub command: String,
}

/// Weights of a network. The file is safetensors, f32, with the names and layouts of the PyTorch modules of
/// `pskel.models.small`; configuration and statistics are JSON in the metadata entry `network`, and the
/// provenance in `training`.
#[derive(Clone, Debug)]
pub struct Weights {
    /// Configuration of the network.
    pub config: NetworkConfig,
    /// Statistics of the training data.
    pub statistics: Statistics,
    /// Provenance of the weights.
    pub about: Provenance,
    arrays: BTreeMap<String, Array>,
}

#[derive(Clone, Debug)]
struct Array {
    shape: Vec<usize>,
    values: Vec<f32>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    config: NetworkConfig,
    statistics: Statistics,
}

const HEADER: &str = "network";
const TRAINING: &str = "training";
/// Output of `python -m pskel.train`.
const SHIPPED: &[u8] = include_bytes!("../../shipped/weights.safetensors");

impl Weights {
    /// Creates the weights of an untrained network: its images are about the filled color.
    ///
    /// # Errors
    /// Returns an error if the configuration is inconsistent, or if the statistics do not fit it.
    pub fn random(config: &NetworkConfig, statistics: &Statistics, seed: u64) -> Result<Self, NetworkError> {
        config.check_with(statistics)?;
        let mut random = RandomArrays { seed, taken: BTreeMap::new() };
        Model::read(config, statistics, &mut random)?;
        let about = Provenance { seed, ..Provenance::default() };
        Ok(Self { config: config.clone(), statistics: statistics.clone(), about, arrays: random.taken })
    }

    /// Number of trained parameters.
    pub fn count(&self) -> usize {
        self.arrays.values().map(|array| array.values.len()).sum()
    }

    /// Returns a hash of the configuration, the statistics and all parameters.
    pub fn fingerprint(&self) -> String {
        let mut hasher = SipHasher::new();
        hasher.write(format!("{:?} {:?}", self.config, self.statistics).as_bytes());
        for (name, array) in &self.arrays {
            hasher.write(name.as_bytes());
            hasher.write(cast_slice(&array.values));
        }
        format!("{:016x}", hasher.finish())
    }

    /// Returns the model with these weights.
    pub(crate) fn model(&self) -> Result<Model, NetworkError> {
        Model::read(&self.config, &self.statistics, &mut Known(&self.arrays))
    }

    /// Writes the weights to a file.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), FileError> {
        use std::io::Write;
        let Self { config, statistics, about, arrays } = self.clone();
        let failed = |error: String| FileError::io("write", path)(std::io::Error::other(error));
        let text = |json: serde_json::Result<String>| json.map_err(|error| failed(error.to_string()));
        let header = text(serde_json::to_string(&Header { config, statistics }))?;
        let training = text(serde_json::to_string(&about))?;
        let mut views = Vec::with_capacity(arrays.len());
        for (name, array) in &arrays {
            let view = TensorView::new(Dtype::F32, array.shape.clone(), cast_slice(&array.values));
            views.push((name, view.map_err(|error| failed(error.to_string()))?));
        }
        let entries = [(HEADER.to_owned(), header), (TRAINING.to_owned(), training)];
        let bytes = serialize(views, Some(HashMap::from(entries)));
        let bytes = bytes.map_err(|error| failed(error.to_string()))?;
        write_whole(path, |out| out.write_all(&bytes).map_err(FileError::io("write", path)))
    }

    /// Reads a file of weights.
    ///
    /// # Errors
    /// Fails if the file cannot be read or its header is invalid, or if parameters are missing, superfluous,
    /// or of another shape or type.
    pub fn open(path: &Path) -> Result<Self, NetworkError> {
        Self::read(&read_table(path)?, path)
    }

    /// Returns the weights that are included in the program.
    ///
    /// # Errors
    /// Never fails, unless the program was built with an invalid file.
    pub fn shipped() -> Result<Self, NetworkError> {
        Self::read(SHIPPED, Path::new("../../shipped/weights.safetensors"))
    }

    /// Returns the recipe of the weights that are included in the program.
    pub(crate) fn shipped_recipe() -> Result<Recipe, NetworkError> {
        Ok(header(SHIPPED, Path::new("../../shipped/weights.safetensors"))?.0.config.recipe)
    }

    fn read(bytes: &[u8], path: &Path) -> Result<Self, NetworkError> {
        let wrong = |found: String| FileError::content("weights", found, path);
        let (Header { config, statistics }, about) = header(bytes, path)?;
        config.check_with(&statistics).map_err(|error| in_file(error, path))?;
        let tensors = SafeTensors::deserialize(bytes).map_err(|e| wrong(e.to_string()))?;
        let mut stored = Stored { tensors: &tensors, path, taken: BTreeMap::new() };
        Model::read(&config, &statistics, &mut stored)?;
        let arrays = stored.taken;
        if tensors.len() != arrays.len() {
            let expected = format!("{} parameters", arrays.len());
            return Err(FileError::content(expected, tensors.len().to_string(), path).into());
        }
        Ok(Self { config, statistics, about, arrays })
    }
}

/// Parses the header of a file. Weights that something else wrote may lack a provenance.
fn header(bytes: &[u8], path: &Path) -> Result<(Header, Provenance), FileError> {
    let wrong = |found: String| FileError::content("weights", found, path);
    let (_, head) = SafeTensors::read_metadata(bytes).map_err(|e| wrong(format!("no safetensors: {e}")))?;
    let entry = |name| head.metadata().as_ref().and_then(|all| all.get(name));
    let header = entry(HEADER).ok_or_else(|| wrong(format!("no {HEADER} in the header")))?;
    let about = entry(TRAINING).map_or(Ok(Provenance::default()), |text| json::parsed(text.as_bytes()));
    Ok((json::parsed(header.as_bytes()).map_err(wrong)?, about.map_err(wrong)?))
}

/// Adds the path of the file to an error about its content.
fn in_file(error: NetworkError, path: &Path) -> NetworkError {
    match error {
        NetworkError::Input { expected, found } => FileError::content(expected, found, path).into(),
        other => other,
    }
}

/// Arrays in memory.
struct Known<'a>(&'a BTreeMap<String, Array>);

impl Arrays for Known<'_> {
    type Error = NetworkError;

    fn take(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f32>, NetworkError> {
        let found = self.0.get(name).filter(|array| array.shape == shape);
        let found = found.ok_or_else(|| NetworkError::input(format!("{name} of {shape:?}"), "none"))?;
        Ok(found.values.clone())
    }
}

/// Arrays of a file.
struct Stored<'a> {
    tensors: &'a SafeTensors<'a>,
    path: &'a Path,
    taken: BTreeMap<String, Array>,
}

impl Arrays for Stored<'_> {
    type Error = FileError;

    /// Checks type, shape and finiteness.
    fn take(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f32>, FileError> {
        let expected = || format!("{name} of f32 {shape:?}");
        let wrong = |found: String| FileError::content(expected(), found, self.path);
        let tensor = self.tensors.tensor(name).map_err(|_| wrong("no such array".to_owned()))?;
        if tensor.dtype() != Dtype::F32 || tensor.shape() != shape {
            return Err(wrong(format!("{:?} {:?}", tensor.dtype(), tensor.shape())));
        }
        let values: Vec<f32> = pod_collect_to_vec(tensor.data());
        if let Some(place) = values.iter().position(|value| !value.is_finite()) {
            let found = format!("{} at {place}", values[place]);
            return Err(FileError::content(format!("finite numbers in {name}"), found, self.path));
        }
        self.taken.insert(name.to_owned(), Array { shape: shape.to_vec(), values: values.clone() });
        Ok(values)
    }
}

/// Random arrays: matrices and convolutions with a gain of about 1, vectors of 0.
struct RandomArrays {
    seed: u64,
    taken: BTreeMap<String, Array>,
}

impl Arrays for RandomArrays {
    type Error = NetworkError;

    fn take(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f32>, NetworkError> {
        let mut random: ChaCha8Rng = Seeder::from((self.seed, name)).into_rng();
        let inputs: usize = shape.iter().skip(1).product();
        let spread = if shape.len() > 1 { 1.0 / (inputs as f32).sqrt() } else { 0.0 };
        let normal = || spread * <StandardNormal as Distribution<f32>>::sample(&StandardNormal, &mut random);
        let mut values = vec![0.0; shape.iter().product()];
        values.fill_with(normal);
        self.taken.insert(name.to_owned(), Array { shape: shape.to_vec(), values: values.clone() });
        Ok(values)
    }
}
