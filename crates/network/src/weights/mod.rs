pub(super) mod config;
pub(super) mod parameters;

use std::collections::{BTreeMap, HashMap};
use std::hash::Hasher;
use std::path::Path;

use bytemuck::{cast_slice, pod_collect_to_vec};
use candle_core::{Device, Tensor};
use point_skeleton::error::FileError;
use point_skeleton::files::input::read_table;
use point_skeleton::files::json;
use point_skeleton::files::write_whole;
use rand_seeder::SipHasher;
use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use self::parameters::{fresh, shapes};
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

/// Weights of a network. The file is safetensors, f32; everything else is JSON in the metadata entry
/// `network`.
#[derive(Clone, Debug)]
pub struct Weights {
    /// Configuration of the network.
    pub config: NetworkConfig,
    /// Statistics of the training data.
    pub statistics: Statistics,
    /// Provenance of the weights.
    pub about: Provenance,
    pub(crate) parameters: BTreeMap<String, Tensor>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    config: NetworkConfig,
    statistics: Statistics,
    about: Provenance,
}

const HEADER: &str = "network";
/// Output of `pskel train`; `loss.csv` beside it is the course of its loss.
const SHIPPED: &[u8] = include_bytes!("../../shipped/weights.safetensors");

impl Weights {
    /// Creates the weights of an untrained network: its images are about the filled color.
    ///
    /// # Errors
    /// Returns an error if the configuration is inconsistent, or if the statistics do not fit it.
    pub fn fresh(config: &NetworkConfig, statistics: &Statistics, seed: u64) -> Result<Self, NetworkError> {
        config.check_with(statistics)?;
        let about = Provenance { seed, ..Provenance::default() };
        let parameters = fresh(config, seed)?;
        Ok(Self { config: config.clone(), statistics: statistics.clone(), about, parameters })
    }

    /// Number of trained parameters.
    pub fn count(&self) -> usize {
        self.parameters.values().map(Tensor::elem_count).sum()
    }

    /// Returns a hash of the configuration, the statistics and all parameters.
    pub fn fingerprint(&self) -> Result<String, NetworkError> {
        let mut hasher = SipHasher::new();
        hasher.write(format!("{:?} {:?}", self.config, self.statistics).as_bytes());
        for (name, tensor) in &self.parameters {
            hasher.write(name.as_bytes());
            hasher.write(cast_slice(&tensor.flatten_all()?.to_vec1::<f32>()?));
        }
        Ok(format!("{:016x}", hasher.finish()))
    }

    /// Writes the weights to a file.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), NetworkError> {
        use std::io::Write;
        let Self { config, statistics, about, .. } = self.clone();
        let mut arrays = Vec::new();
        for (name, tensor) in &self.parameters {
            arrays.push((name.clone(), tensor.dims().to_vec(), tensor.flatten_all()?.to_vec1::<f32>()?));
        }
        let bytes = serialized(&arrays, HEADER, &Header { config, statistics, about }, path)?;
        Ok(write_whole(path, |out| out.write_all(&bytes).map_err(FileError::io("write", path)))?)
    }

    /// Reads a file written by [`Weights::write`].
    ///
    /// # Errors
    /// Fails if the file cannot be read or its header is invalid, or if parameters are missing, superfluous,
    /// or of another shape or type.
    pub fn open(path: &Path) -> Result<Self, NetworkError> {
        Self::read(&read_whole(path)?, path)
    }

    /// Returns the weights that are included in the program.
    ///
    /// # Errors
    /// Never fails, unless the program was built with an invalid file.
    pub fn shipped() -> Result<Self, NetworkError> {
        Self::read(SHIPPED, Path::new("../../shipped/weights.safetensors"))
    }

    fn read(bytes: &[u8], path: &Path) -> Result<Self, NetworkError> {
        let (Header { config, statistics, about }, tensors) = read::<Header>(bytes, HEADER, "weights", path)?;
        config.check_with(&statistics).map_err(|error| in_file(error, path))?;
        let shapes = shapes(&config);
        if tensors.len() != shapes.len() {
            let expected = format!("{} parameters", shapes.len());
            return Err(FileError::content(expected, tensors.len().to_string(), path).into());
        }
        let mut parameters = BTreeMap::new();
        for (name, shape) in shapes {
            let values = find(&tensors, &name, &shape, path)?;
            parameters.insert(name, Tensor::from_vec(values, shape, &Device::Cpu)?);
        }
        Ok(Self { config, statistics, about, parameters })
    }
}

/// Adds the path of the file to an error about its content.
pub(crate) fn in_file(error: NetworkError, path: &Path) -> NetworkError {
    match error {
        NetworkError::Input { expected, found } => FileError::content(expected, found, path).into(),
        other => other,
    }
}

/// Reads all bytes of a file.
pub(crate) fn read_whole(path: &Path) -> Result<Vec<u8>, FileError> {
    read_table(path)
}

/// Serializes named f32 arrays as safetensors, with a header in the metadata.
pub(crate) fn serialized(
    arrays: &[(String, Vec<usize>, Vec<f32>)],
    key: &str,
    header: &impl Serialize,
    path: &Path,
) -> Result<Vec<u8>, FileError> {
    let failed = |error: String| FileError::io("write", path)(std::io::Error::other(error));
    let header = serde_json::to_string(header).map_err(|e| failed(e.to_string()))?;
    let mut views = Vec::with_capacity(arrays.len());
    for (name, shape, values) in arrays {
        let view = TensorView::new(Dtype::F32, shape.clone(), cast_slice(values));
        views.push((name, view.map_err(|e| failed(e.to_string()))?));
    }
    serialize(views, Some(HashMap::from([(key.to_owned(), header)]))).map_err(|e| failed(e.to_string()))
}

/// Parses the bytes written by [`serialized`] into header and arrays.
pub(crate) fn read<'a, H: DeserializeOwned>(
    bytes: &'a [u8],
    key: &str,
    what: &str,
    path: &Path,
) -> Result<(H, SafeTensors<'a>), FileError> {
    let wrong = |found: String| FileError::content(what, found, path);
    let (_, head) = SafeTensors::read_metadata(bytes).map_err(|e| wrong(format!("no safetensors: {e}")))?;
    let header = head.metadata().as_ref().and_then(|all| all.get(key));
    let header = header.ok_or_else(|| wrong(format!("no {key} in the header")))?;
    let header = json::parsed(header.as_bytes()).map_err(wrong)?;
    let tensors = SafeTensors::deserialize(bytes).map_err(|e| wrong(e.to_string()))?;
    Ok((header, tensors))
}

/// Returns the values of an array; checks type, shape and finiteness.
pub(crate) fn find(
    tensors: &SafeTensors<'_>,
    name: &str,
    shape: &[usize],
    path: &Path,
) -> Result<Vec<f32>, FileError> {
    let expected = || format!("{name} of f32 {shape:?}");
    let tensor = tensors.tensor(name).map_err(|_| FileError::content(expected(), "no such array", path))?;
    if tensor.dtype() != Dtype::F32 || tensor.shape() != shape {
        let found = format!("{:?} {:?}", tensor.dtype(), tensor.shape());
        return Err(FileError::content(expected(), found, path));
    }
    let values: Vec<f32> = pod_collect_to_vec(tensor.data());
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(values),
        Some(place) => {
            let found = format!("{} at {place}", values[place]);
            Err(FileError::content(format!("finite numbers in {name}"), found, path))
        }
    }
}
