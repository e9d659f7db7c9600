use std::path::PathBuf;

use clap::Args;
use point_skeleton::dataset::{LogLocator, expand};

use crate::args::log::{self, LogRoots};

/// Logs of a protocol, and its folders.
#[derive(Debug, Args)]
pub(super) struct ProtocolLogs {
    /// Recordings: FORMAT:PATH[@VERSION][#SCENE]; of sets, like nuscenes:ROOT@v1.0-trainval#* or
    /// nuplan-simgen:FOLDER, those of the protocol
    #[arg(value_name = "LOG", required = true, value_parser = log::log)]
    logs: Vec<LogLocator>,
    #[command(flatten)]
    pub(super) roots: LogRoots,
    /// Folder of skeletons, one per recording and named after it; those that do not exist are built
    #[arg(long, value_name = "DIR", value_parser = log::output_folder())]
    pub(super) skeletons: PathBuf,
    /// Folder to write
    #[arg(long, value_name = "DIR", value_parser = log::output_folder())]
    pub(super) out: PathBuf,
}

impl ProtocolLogs {
    /// Returns the logs, each once, with those of sets.
    pub(super) fn expand(&self) -> anyhow::Result<Vec<LogLocator>> {
        let mut found = Vec::new();
        for log in &self.logs {
            found.extend(expand(&self.roots.locate(log))?);
        }
        log::check_once(&found)?;
        Ok(found)
    }
}
