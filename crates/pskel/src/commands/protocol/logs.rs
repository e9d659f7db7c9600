use clap::Args;
use point_skeleton::dataset::{LogLocator, expand};

use crate::args::log::{self, LogRoots};
use crate::args::outputs::FolderArgs;
use crate::args::source::SkeletonsArgs;

/// Logs of a protocol, and its folders.
#[derive(Debug, Args)]
pub(super) struct ProtocolLogs {
    /// Recordings: [FORMAT:]PATH[@VERSION][#SCENE]; of sets, like nuscenes:ROOT@v1.0-trainval#* or
    /// nuplan-simgen:FOLDER, the protocol's recordings
    #[arg(value_name = "LOG", required = true, value_parser = log::log)]
    logs: Vec<LogLocator>,
    #[command(flatten)]
    pub(super) skeletons: SkeletonsArgs,
    #[command(flatten)]
    pub(super) folder: FolderArgs,
    #[command(flatten)]
    pub(super) roots: LogRoots,
}

impl ProtocolLogs {
    /// Returns the logs, each once, including sets.
    pub(super) fn expand(&self) -> anyhow::Result<Vec<LogLocator>> {
        let mut found = Vec::new();
        for log in &self.logs {
            found.extend(expand(&self.roots.locate(log))?);
        }
        log::check_once(&found)?;
        Ok(found)
    }
}
