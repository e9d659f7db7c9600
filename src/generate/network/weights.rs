use std::collections::{BTreeMap, HashMap};
use std::hash::Hasher;
use std::path::Path;

use bytemuck::{cast_slice, pod_collect_to_vec};
use candle_core::{Device, Tensor};
use rand_seeder::SipHasher;
use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::model::{FirstGuess, fresh, shapes};
use super::{NetworkConfig, NetworkError, Statistics};
use crate::error::FileError;
use crate::files::input::read_table;
use crate::files::write_whole;

/// Where weights come from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct About {
    /// What training followed from.
    pub seed: u64,
    /// Steps of it.
    pub steps: u64,
    /// Logs that it saw.
    pub logs: Vec<String>,
    /// The command that made them.
    pub command: String,
}

/// All that a network needs: a file of safetensors, f32, with the rest as JSON in the metadata's `network`.
#[derive(Clone, Debug)]
pub struct Weights {
    /// Its size and shape.
    pub config: NetworkConfig,
    /// What was measured over the training data.
    pub statistics: Statistics,
    /// Where it comes from.
    pub about: About,
    pub(in crate::generate) parameters: BTreeMap<String, Tensor>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    config: NetworkConfig,
    statistics: Statistics,
    about: About,
}

const HEADER: &str = "network";
/// What `pskel train` has left; beside it is how its loss fell.
const SHIPPED: &[u8] = include_bytes!("shipped/weights.safetensors");

impl Weights {
    /// Of a network that was not trained: it shows what its conditions show, and noise.
    ///
    /// # Errors
    /// A configuration that does not go together, statistics or a guess that do not fit it.
    pub fn fresh(
        config: &NetworkConfig,
        statistics: &Statistics,
        guess: &FirstGuess,
        seed: u64,
    ) -> Result<Self, NetworkError> {
        config.check_with(statistics)?;
        let about = About { seed, ..About::default() };
        let parameters = fresh(config, guess, seed)?;
        Ok(Self { config: config.clone(), statistics: statistics.clone(), about, parameters })
    }

    /// Numbers that were trained.
    pub fn count(&self) -> usize {
        self.parameters.values().map(Tensor::elem_count).sum()
    }

    /// Tells weights apart: a hash of all numbers and of what they are for.
    pub fn fingerprint(&self) -> Result<String, NetworkError> {
        let mut hasher = SipHasher::new();
        hasher.write(format!("{:?} {:?}", self.config, self.statistics).as_bytes());
        for (name, tensor) in &self.parameters {
            hasher.write(name.as_bytes());
            hasher.write(cast_slice(&tensor.flatten_all()?.to_vec1::<f32>()?));
        }
        Ok(format!("{:016x}", hasher.finish()))
    }

    /// Writes them.
    ///
    /// # Errors
    /// The system's.
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

    /// Reads what [`Weights::write`] wrote.
    ///
    /// # Errors
    /// Anything else: another header, parameters that are missing, too many, or of other shapes or types.
    pub fn open(path: &Path) -> Result<Self, NetworkError> {
        Self::read(&read_whole(path)?, path)
    }

    /// Those that come with the program.
    ///
    /// # Errors
    /// None, unless the program was built with another file in their place.
    pub fn shipped() -> Result<Self, NetworkError> {
        Self::read(SHIPPED, Path::new("shipped/weights.safetensors"))
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

/// What does not go together, with the file that it stands in.
pub(in crate::generate) fn in_file(error: NetworkError, path: &Path) -> NetworkError {
    match error {
        NetworkError::Input { expected, found } => FileError::content(expected, found, path).into(),
        other => other,
    }
}

/// A file's bytes.
pub(in crate::generate) fn read_whole(path: &Path) -> Result<Vec<u8>, FileError> {
    read_table(path)
}

/// Safetensors of named f32 arrays, with a header in the metadata.
pub(in crate::generate) fn serialized(
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

/// The header and the arrays of such a file.
pub(in crate::generate) fn read<'a, H: DeserializeOwned>(
    bytes: &'a [u8],
    key: &str,
    what: &str,
    path: &Path,
) -> Result<(H, SafeTensors<'a>), FileError> {
    let wrong = |found: String| FileError::content(what, found, path);
    let (_, head) = SafeTensors::read_metadata(bytes).map_err(|e| wrong(format!("no safetensors: {e}")))?;
    let header = head.metadata().as_ref().and_then(|all| all.get(key));
    let header = header.ok_or_else(|| wrong(format!("no {key} in the header")))?;
    let header = serde_json::from_str(header).map_err(|e| wrong(e.to_string()))?;
    let tensors = SafeTensors::deserialize(bytes).map_err(|e| wrong(e.to_string()))?;
    Ok((header, tensors))
}

/// The values of one of its arrays.
pub(in crate::generate) fn find(
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
