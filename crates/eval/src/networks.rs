//! FID, FVD and masks of vehicles by networks in Python: `python -m pskel.metrics.server`.
//!
//! # How it works
//! Networks of the literature run in PyTorch. The server is started at the first request and answers JSON
//! lines, so weights are loaded once. It keeps features in a folder, and masks where they are requested: an
//! interrupted run continues.

use std::path::{Path, PathBuf};

use pskel_sim::peer::{
    Framing, Link, MAX_TIMEOUT_S, PeerAddress, PeerError, PeerSpec, ProtocolError, begin_of,
};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Networks for metrics, all optional, and the program that runs them.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct NetworkPaths {
    /// Python interpreter with the package `pskel` and its extra `metrics`.
    #[serde(skip)]
    pub python: PathBuf,
    /// Device of PyTorch.
    #[serde(skip)]
    pub device: String,
    /// Weights of Inception, for FID.
    pub inception: Option<PathBuf>,
    /// Weights of I3D, for FVD.
    pub i3d: Option<PathBuf>,
    /// Folder of Mask2Former, for masks of vehicles.
    pub segmentor: Option<PathBuf>,
}

/// A Fréchet distance of two sets of features.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Distance {
    /// The distance, in squared units of the features.
    pub distance: f64,
    /// Number of generated and of other images or clips.
    pub samples: [usize; 2],
    /// Number of features of each.
    pub features: usize,
}

/// Distances of generated images.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Distances {
    pub(crate) fid: Option<Distance>,
    pub(crate) fvd: Option<Distance>,
    /// Reasons of missing distances and images.
    pub(crate) notes: Vec<String>,
}

/// Error of a network for metrics.
#[derive(Debug, thiserror::Error)]
pub enum NetworkError {
    /// The process cannot be started, or has ended.
    #[error("{0}; metrics need Python with the package pskel[metrics]: --python PROGRAM or $PSKEL_PYTHON")]
    Process(#[from] PeerError),
    /// The process reports an error.
    #[error("{0}")]
    Reported(String),
}

/// The server's networks.
pub struct MetricNetworks {
    paths: NetworkPaths,
    /// `None` before the first request.
    link: Option<Link>,
}

/// A request of the server.
#[derive(Serialize)]
#[serde(rename_all = "snake_case")]
enum Request<'a> {
    Distances {
        rollouts: &'a [PathBuf],
        references: Option<&'a [PathBuf]>,
        inception: Option<&'a Path>,
        i3d: Option<&'a Path>,
        cache: &'a Path,
        device: &'a str,
    },
    Masks {
        rollout: &'a Path,
        out: &'a Path,
        mask2former: &'a Path,
        device: &'a str,
    },
}

/// Maximum length of an answer.
const ANSWER_BYTES: u64 = 1 << 20;

impl MetricNetworks {
    /// Uses these networks; nothing is started.
    pub fn new(paths: NetworkPaths) -> Self {
        Self { paths, link: None }
    }

    /// Returns the networks that are used.
    pub(crate) fn paths(&self) -> &NetworkPaths {
        &self.paths
    }

    /// Compares the generated images of rollouts with their ground truth, or with the ground truth of the
    /// `references`. Features are kept in the folder `cache`.
    pub(crate) fn distances(
        &mut self,
        rollouts: &[PathBuf],
        references: Option<&[PathBuf]>,
        cache: &Path,
    ) -> Result<Distances, NetworkError> {
        let NetworkPaths { python, inception, i3d, device, .. } = &self.paths;
        let (inception, i3d) = (inception.as_deref(), i3d.as_deref());
        if inception.is_none() && i3d.is_none() {
            return Ok(Distances::default());
        }
        let request = Request::Distances { rollouts, references, inception, i3d, cache, device };
        ask(&mut self.link, python, &request)
    }

    /// Writes the masks of vehicles in the generated images of a rollout, `out/NNNNNN/CAM.png`, except for
    /// those that are there. Does nothing without a segmentor.
    pub(crate) fn masks(&mut self, rollout: &Path, out: &Path) -> Result<(), NetworkError> {
        let NetworkPaths { python, segmentor, device, .. } = &self.paths;
        let Some(mask2former) = segmentor else { return Ok(()) };
        let request = Request::Masks { rollout, out, mask2former, device };
        ask::<Value>(&mut self.link, python, &request).map(drop)
    }
}

/// Sends a request and waits for the answer, after starting the server if there is none.
fn ask<T: DeserializeOwned>(
    link: &mut Option<Link>,
    python: &Path,
    request: &Request<'_>,
) -> Result<T, NetworkError> {
    let link = match link {
        Some(link) => link,
        none => none.insert(start(python)?),
    };
    let request = serde_json::to_vec(request).map_err(|error| link.cannot_write(error.into()))?;
    let answer = link.ask(request)?;
    let wrong = |_| ProtocolError::new("an answer of JSON", begin_of(&answer));
    let mut value: Value = serde_json::from_slice(&answer).map_err(|error| link.refuse(wrong(error)))?;
    if let Some(Value::String(error)) = value.get_mut("error").map(Value::take) {
        return Err(NetworkError::Reported(error));
    }
    serde_json::from_value(value).map_err(|error| link.refuse(wrong(error)).into())
}

fn start(python: &Path) -> Result<Link, PeerError> {
    let quoted = python.display().to_string().replace('\'', r"'\''");
    let address = PeerAddress::Command(format!("'{quoted}' -m pskel.metrics.server"));
    let spec = PeerSpec { address, timeout_s: MAX_TIMEOUT_S };
    Link::open("networks", &spec, Framing::Lines { max_bytes: ANSWER_BYTES })
}
