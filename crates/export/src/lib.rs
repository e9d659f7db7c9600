//! Export of the condition maps of whole data sets, in the layouts that trainers read.
//!
//! # How it works
//! A [`WorkList`] divides logs into units: some frames of a log, which become one shard of the export.
//! [`export`] opens each log, builds its skeleton if it does not exist, renders the samples of its units
//! (`samples`), and passes them to the writer of the layout (`layout`), which encodes while the next sample
//! is rendered. A shard is written in a work folder and appears with its record once it is complete
//! (`shard`). Its bytes depend on input and options alone, so shards of the same input that exist are
//! skipped, and any number of processes may share a work list without communication.

mod claim;
mod error;
mod files;
mod index;
mod job;
mod layout;
mod options;
mod report;
mod rules;
mod run;
mod samples;
mod shard;
mod work;

pub use error::ExportError;
pub use index::{Completeness, write_index};
pub use job::{ExportJob, ListedExport};
pub use options::{ExportOptions, Layout, SampleFormat, SampleTimes};
pub use report::{ExportReport, Failure};
pub use run::{Export, ExportProgress, OpenLog, export};
pub use work::{ListedLog, Part, WorkList, WorkUnit};
