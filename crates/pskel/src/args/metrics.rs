//! Networks for metrics.

use std::path::{Path, PathBuf};

use clap::Args;
use pskel_eval::{MaskRule, MetricNetworks, NetworkPaths};

use super::names::names;

/// Networks for FID, FVD and masks of vehicles; they run in Python.
#[derive(Debug, Args)]
#[command(next_help_heading = "Metrics")]
pub(crate) struct MetricArgs {
    /// FID: weights of Inception, pt_inception-2015-12-05-6726825d.pth of torch-fidelity
    #[arg(long, value_name = "FILE")]
    inception: Option<PathBuf>,
    /// FVD: weights of I3D, i3d_pretrained_400.pt
    #[arg(long, value_name = "FILE")]
    i3d: Option<PathBuf>,
    /// IoU of vehicles: a folder of Mask2Former with the semantic classes of Cityscapes
    #[arg(long, value_name = "DIR")]
    segmentor: Option<PathBuf>,
    /// How the masks of vehicles are computed from class maps
    #[arg(long, requires = "segmentor", default_value_t, value_parser = names::<MaskRule>())]
    pub(crate) mask_rule: MaskRule,
    /// Python interpreter with the package pskel[metrics]
    #[arg(long, value_name = "PROGRAM", env = "PSKEL_PYTHON", default_value = "python3")]
    python: PathBuf,
    /// Device of PyTorch
    #[arg(long, value_name = "DEVICE", default_value = "cpu")]
    metrics_device: String,
}

impl MetricArgs {
    /// Returns the networks; nothing is started.
    pub(crate) fn networks(&self) -> MetricNetworks {
        let Self { inception, i3d, segmentor, python, metrics_device, .. } = self;
        MetricNetworks::new(NetworkPaths {
            python: python.clone(),
            device: metrics_device.clone(),
            inception: inception.clone(),
            i3d: i3d.clone(),
            segmentor: segmentor.clone(),
        })
    }

    /// Returns the files and folders that are read.
    pub(crate) fn inputs(&self) -> impl Iterator<Item = &Path> {
        [&self.inception, &self.i3d, &self.segmentor].into_iter().filter_map(Option::as_deref)
    }
}
