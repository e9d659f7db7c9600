//! The recording and the skeleton that a command renders.

use std::path::{Path, PathBuf};

use clap::Args;
use point_skeleton::Log;
use point_skeleton::dataset::{DatasetError, LogLocator, Recording};
use point_skeleton::error::FileError;
use point_skeleton::files::Inputs;
use point_skeleton::skeleton::Skeleton;

use super::log::{self, LogRoots};
use super::outputs::output_folder;
use crate::warn;

/// A recording and its skeleton.
#[derive(Clone, Debug, Args)]
pub(crate) struct SourceArgs {
    /// Recording: [FORMAT:]PATH[@VERSION][#SCENE], like /data/nuscenes#scene-0061
    #[arg(value_parser = log::log)]
    pub(crate) log: LogLocator,
    /// Skeleton that was built from the recording
    #[arg(long, value_name = "SKEL")]
    pub(crate) skeleton: PathBuf,
    #[command(flatten)]
    pub(crate) roots: LogRoots,
}

/// Points and cameras without a recording.
#[derive(Clone, Debug, Args)]
pub(crate) struct CloudArgs {
    /// Points: NPY, floats Nx6 (x y z r g b, colors 0-255) or Nx7 with the class last; or PLY (colors 0-255,
    /// or 0-1 as floats)
    #[arg(long, value_name = "P.npy|P.ply", requires = "cameras")]
    pub(crate) points: Option<PathBuf>,
    /// Cameras: {"cameras": [{"name", "width", "height", "intrinsics": 3x3, "camera_from_world": 4x4}]}
    #[arg(long, value_name = "C.json", requires = "points")]
    pub(crate) cameras: Option<PathBuf>,
}

/// Skeletons of many recordings.
#[derive(Clone, Debug, Args)]
pub(crate) struct SkeletonsArgs {
    /// Folder of skeletons, one per recording and named after it; those that do not exist are built
    #[arg(long, value_name = "DIR", value_parser = output_folder())]
    pub(crate) skeletons: PathBuf,
}

impl SourceArgs {
    /// Returns everything that is read.
    pub(crate) fn inputs(&self) -> Inputs {
        Inputs::new(self.roots.locate(&self.log).inputs()).and([&self.skeleton])
    }

    /// Opens the recording, and warns if parts of it are missing.
    pub(crate) fn open(&self) -> Result<Log, DatasetError> {
        self.roots.open(&self.log)
    }

    /// Opens the skeleton of the recording, and warns if it was built from another one of the same name.
    pub(crate) fn open_skeleton(&self, log: &Recording) -> Result<Skeleton, FileError> {
        open_skeleton(&self.skeleton, log)
    }
}

/// Opens a skeleton as [`Skeleton::open_for`], and warns if it was built from another recording of the same
/// name.
///
/// # Errors
/// Fails as [`Skeleton::open_for`], or if the list of its files cannot be read.
pub(crate) fn open_skeleton(path: &Path, log: &Recording) -> Result<Skeleton, FileError> {
    let skeleton = Skeleton::open_for(path, log)?;
    if skeleton.is_of(log)? == Some(false) {
        warn(&format!(
            "the skeleton was built from another recording or state of the name {}: other frames, poses, \
                cameras, files, categories or boxes: {}",
            log.shown_name(),
            path.display()
        ));
    }
    Ok(skeleton)
}
