use std::collections::BTreeMap;

use serde::Serialize;

/// Work that failed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Failure {
    /// Name of the log or of the shard.
    pub name: String,
    /// Error with its causes.
    pub error: String,
}

/// Result of an export: what was written, and everything that was not.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ExportReport {
    /// Shards written by this run.
    pub written: usize,
    /// Shards of an earlier run or of another process.
    pub present: usize,
    /// Shards that another process is writing.
    pub busy: usize,
    /// Samples in the shards written by this run.
    pub samples: usize,
    /// Skeletons built by this run.
    pub built: usize,
    /// Skipped and missing items in the logs and shards of this run, by kind.
    pub notes: BTreeMap<String, usize>,
    /// Logs and shards that failed, in order of the list.
    pub failures: Vec<Failure>,
    /// Whether all shards of the list exist, so that the index was written.
    pub complete: bool,
}

impl ExportReport {
    pub(crate) fn note(&mut self, notes: &BTreeMap<String, usize>) {
        for (kind, count) in notes {
            *self.notes.entry(kind.clone()).or_default() += count;
        }
    }

    pub(crate) fn add(&mut self, other: Self) {
        self.written += other.written;
        self.present += other.present;
        self.busy += other.busy;
        self.samples += other.samples;
        self.built += other.built;
        self.note(&other.notes);
        self.failures.extend(other.failures);
    }
}
