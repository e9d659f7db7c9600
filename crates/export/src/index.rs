//! The index of a complete export.

use std::path::Path;

use point_skeleton::error::FileError;
use point_skeleton::files::{FileKind, SharedFolder, write_json};
use serde_json::json;

use crate::shard::ShardRecord;
use crate::{Layout, WorkList, layout};

/// Index of a complete export.
const INDEX: &str = "index.json";
/// Kind of the index.
const INDEX_KIND: FileKind = FileKind {
    name: "the index of an export",
    begin: b"{\n  \"__kind__\": \"wids-shard-index-v1\"",
    marks: &[b"shardlist"],
};

/// What makes a shard exist.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Completeness {
    /// Its record, and its files with their lengths.
    Files,
    /// Its record, where the files are somewhere else.
    Record,
}

/// Writes `index.json` and the layout's lists of clips if all shards of a list exist, and returns whether
/// they do.
///
/// # Errors
/// Fails if a file cannot be written, or if the samples are too few for the layout.
pub fn write_index(
    list: &WorkList,
    out: &Path,
    layout: Layout,
    completeness: Completeness,
) -> Result<bool, FileError> {
    let mut entries = Vec::new();
    let mut samples = 0;
    let mut clips = layout::clip_lists(layout);
    for unit in list.logs.iter().flat_map(|log| &log.units) {
        let record = match completeness {
            Completeness::Files => ShardRecord::read(out, unit, None, false)?,
            Completeness::Record => ShardRecord::parse(out, unit)?,
        };
        let Some(record) = record else { return Ok(false) };
        samples += record.samples;
        if let Some(clips) = &mut clips {
            clips.add(&record);
        }
        entries.push(layout::index_entry(layout, &record));
    }
    let mut index = json!({
        "__kind__": "wids-shard-index-v1", "wids_version": 1, "layout": layout,
        "nsamples": samples, "shardlist": entries,
    });
    let path = out.join(INDEX);
    INDEX_KIND.check(&path)?;
    if let Some(clips) = clips {
        index["clips"] = clips.write(out)?;
    }
    unless_busy(write_json(&path, &index))?;
    SharedFolder::remove_work(out); // before, other processes may still begin shards
    Ok(true)
}

/// Returns the result of writing a file, which is a success if another process writes it: of the same shards
/// come the same bytes.
pub(crate) fn unless_busy(written: Result<(), FileError>) -> Result<(), FileError> {
    match written {
        Err(FileError::Busy { .. }) => Ok(()),
        written => written,
    }
}
