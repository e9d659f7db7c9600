use std::path::{Path, PathBuf};

use point_skeleton::Log;
use point_skeleton::dataset::{LogLocator, LogOpener, expand};
use point_skeleton::error::with_causes;
use point_skeleton::raster::RasterizerDesc;

use crate::{
    Completeness, Export, ExportError, ExportOptions, ExportProgress, ExportReport, Failure, Part, WorkList,
    export, layout, write_index,
};

/// An export of named logs.
pub struct ExportJob {
    /// Logs, or sets of logs.
    pub logs: Vec<LogLocator>,
    /// Folder to write.
    pub out: PathBuf,
    /// Folder of skeletons, one per log and named after it. Those that do not exist are built.
    pub skeletons: PathBuf,
    /// Options, which determine the bytes.
    pub options: ExportOptions,
    /// Part of the shards to write; `None` for all.
    pub only: Option<Part>,
    /// Rasterizer and device.
    pub rasterizer: RasterizerDesc,
    /// Number of logs that are exported at a time.
    pub jobs: usize,
    /// Whether checksums of existing shards are compared.
    pub verify: bool,
    /// Keeps the tables of a data set between its logs.
    pub opener: LogOpener,
}

/// Shards of an export.
#[derive(Clone, Debug)]
pub struct ListedExport {
    /// All shards, for the index. Without them no index is written.
    pub list: Option<WorkList>,
    /// Shards to write.
    pub part: WorkList,
    /// Logs that cannot be opened.
    pub failures: Vec<Failure>,
}

impl ExportJob {
    /// Maximum number of logs that are exported at a time.
    pub const MAX_JOBS: usize = 64;

    /// Lists the shards.
    ///
    /// # Errors
    /// Fails if a set of logs cannot be read, or if two logs have one name.
    pub fn list(&self) -> Result<ListedExport, ExportError> {
        let mut locators = Vec::new();
        for log in &self.logs {
            locators.extend(expand(log)?);
        }
        let (mut known, mut failures) = (Vec::new(), Vec::new());
        for locator in locators {
            match self.opener.outline(&locator) {
                Ok(outline) => known.push((locator, outline)),
                Err(error) => {
                    failures.push(Failure { name: locator.to_string(), error: with_causes(&error) });
                }
            }
        }
        let frames = self.options.frames.map(|[first, end]| first..end);
        let whole = self.options.layout.has_whole_logs();
        let shard_frames = if whole { usize::MAX } else { self.options.shard_frames };
        let list = WorkList::new(known, shard_frames, frames)?;
        let part = self.only.map_or_else(|| list.clone(), |part| list.part(part));
        Ok(ListedExport { list: Some(list), part, failures })
    }

    /// Exports the shards of a part. The report includes the logs that could not be listed.
    ///
    /// # Errors
    /// Fails if options contradict each other, if the folder cannot be written, or if `progress` requests a
    /// stop.
    pub fn run(
        &self,
        listed: &ListedExport,
        progress: &dyn ExportProgress,
    ) -> Result<ExportReport, ExportError> {
        let mut report = export(Export {
            list: listed.list.as_ref(),
            part: &listed.part,
            out: &self.out,
            skeletons: &self.skeletons,
            options: &self.options,
            open: &|locator: &LogLocator| self.opener.open(locator).map(Log::new),
            rasterizer: &self.rasterizer,
            jobs: self.jobs,
            verify: self.verify,
            progress,
        })?;
        report.complete &= listed.failures.is_empty();
        report.failures.splice(0..0, listed.failures.iter().cloned());
        Ok(report)
    }

    /// Writes the index of an export whose records are in a folder, if all of them are. Returns whether they
    /// are.
    ///
    /// # Errors
    /// Fails if the layout cannot have logs of these names, if the samples are too few for it, or if a file
    /// cannot be written.
    pub fn write_index(&self, listed: &ListedExport, folder: &Path) -> Result<bool, ExportError> {
        let Some(list) = &listed.list else { return Ok(false) };
        layout::check_logs(&self.options, list)?;
        Ok(write_index(list, folder, self.options.layout, Completeness::Record)?)
    }
}
