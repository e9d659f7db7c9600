use std::hash::Hasher;
use std::path::Path;

use candle_core::{Device, Tensor, Var};
use point_skeleton::error::FileError;
use point_skeleton::files::write_whole;
use pskel_generate::TrainingClip;
use serde::{Deserialize, Serialize};

use super::TrainOptions;
use super::optimizer::{State, TrainedParameter};
use crate::{NetworkConfig, NetworkError, Statistics, find, in_file, read, read_whole, serialized, shapes};

/// Header of a checkpoint, as JSON in the metadata entry `training`.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Header {
    pub(super) options: TrainOptions,
    pub(super) config: NetworkConfig,
    pub(super) statistics: Statistics,
    /// Number of steps done.
    pub(super) step: u64,
    /// Fingerprint of the recordings.
    pub(super) fingerprint: String,
    /// Probability of each recording, relative to the others.
    pub(super) shares: Vec<f64>,
}

const HEADER: &str = "training";

/// Writes the state of a run to resume from: for each parameter `value/..`, the moments `first/..` and
/// `second/..`, and `average/..`.
pub(super) fn save(path: &Path, header: &Header, state: &State) -> Result<(), NetworkError> {
    use std::io::Write;
    let mut arrays = Vec::with_capacity(4 * state.parameters.len());
    for (name, trained) in &state.parameters {
        let TrainedParameter { value, first, second, average } = trained;
        let values = value.flatten_all()?.to_vec1::<f32>()?;
        for (part, values) in [("value", &values), ("first", first), ("second", second), ("average", average)]
        {
            arrays.push((format!("{part}/{name}"), value.dims().to_vec(), values.clone()));
        }
    }
    let bytes = serialized(&arrays, HEADER, header, path)?;
    Ok(write_whole(path, |out| out.write_all(&bytes).map_err(FileError::io("write", path)))?)
}

/// Reads a checkpoint written by [`save`].
pub(super) fn open(path: &Path) -> Result<(Header, State), NetworkError> {
    let bytes = read_whole(path)?;
    let (header, tensors) = read::<Header>(&bytes, HEADER, "a saved training", path)?;
    let Header { options, config, statistics, step, .. } = &header;
    let checked = config.check_with(statistics).and_then(|()| options.check(config));
    checked.map_err(|error| in_file(error, path))?;
    let mut state = State { step: *step, parameters: std::collections::BTreeMap::new() };
    for (name, shape) in shapes(config) {
        let part = |part: &str| find(&tensors, &format!("{part}/{name}"), &shape, path);
        let value = Var::from_tensor(&Tensor::from_vec(part("value")?, &shape[..], &Device::Cpu)?)?;
        let trained = TrainedParameter {
            value,
            first: part("first")?,
            second: part("second")?,
            average: part("average")?,
        };
        state.parameters.insert(name, trained);
    }
    Ok((header, state))
}

/// Returns a hash of the recordings.
pub(super) fn fingerprint(drives: &[TrainingClip]) -> String {
    let mut hasher = rand_seeder::SipHasher::new();
    for drive in drives {
        let about = &drive.about;
        hasher.write(format!("{about:?} {}", drive.frames.len()).as_bytes());
        for frame in &drive.frames {
            for image in [&frame.color, &frame.boxes, &frame.map, &frame.truth] {
                hasher.write(image.as_flattened());
            }
            hasher.write(bytemuck::cast_slice(&frame.bins));
            hasher.write(bytemuck::cast_slice(&frame.action));
            hasher.write(bytemuck::cast_slice(&frame.cameras));
        }
    }
    format!("{:016x}", hasher.finish())
}
