//! The options of an export, in its folder.

use std::path::Path;
use std::time::Duration;

use point_skeleton::error::FileError;
use point_skeleton::files::input::{is_taken, read_table};
use point_skeleton::files::write_json;
use serde_json::{Map, Value, json};

use crate::ExportOptions;

/// File with the options of an export, in its folder.
const OPTIONS: &str = "export.json";
/// Pause between attempts to write the options while another process does.
const PAUSE: Duration = Duration::from_millis(200);

/// Writes the options into the folder, or compares them with those there. Waits for another process that writes them.
///
/// # Errors
/// Fails if the folder has an export with other options or foreign files, or if it cannot be written.
pub(crate) fn claim(out: &Path, options: &ExportOptions) -> Result<(), FileError> {
    let path = out.join(OPTIONS);
    let content = json!({ "version": env!("CARGO_PKG_VERSION"), "records": RECORDS, "options": options });
    std::fs::create_dir_all(out).map_err(FileError::io("create", out))?;
    loop {
        if is_taken(&path) {
            let found = serde_json::from_slice(&read_table(&path)?)
                .map_err(|error| FileError::content("the options of an export", error.to_string(), &path))?;
            return compare(&content, &found, &path);
        }
        let foreign = foreign_file(out)?;
        // Another process may have begun an export since.
        if let Some(found) = foreign.filter(|_| !is_taken(&path)) {
            return Err(FileError::content("an export or an empty folder", found, out));
        }
        match write_json(&path, &content) {
            Err(FileError::Busy { .. }) => std::thread::sleep(PAUSE),
            written => return written,
        }
    }
}

/// Version of the records of shards; without fingerprints of the input, there was no such number.
const RECORDS: u32 = 2;

/// Compares options with those of an export, and names the first that differs as on the command line.
fn compare(ours: &Value, theirs: &Value, path: &Path) -> Result<(), FileError> {
    if theirs.get("records") != ours.get("records") {
        let expected = "an export whose records have fingerprints of their input";
        let found = "one of an earlier version; keep it, and export to another folder";
        return Err(FileError::content(expected, found, path));
    }
    let empty = Map::new();
    let fields = |value: &Value| value["options"].as_object().unwrap_or(&empty).clone();
    let (ours_fields, theirs_fields) = (fields(ours), fields(theirs));
    let differs = |name: &&String| ours_fields.get(*name) != theirs_fields.get(*name);
    let Some(name) = ours_fields.keys().chain(theirs_fields.keys()).find(differs) else {
        if ours == theirs {
            return Ok(());
        }
        let version = |value: &Value| format!("version {}", value["version"]);
        let expected = format!("an export with the same options, of {}", version(ours));
        return Err(FileError::content(expected, version(theirs), path));
    };
    let shown = |fields: &Map<String, Value>| {
        let value = fields.get(name).filter(|value| !value.is_null());
        format!("--{} {}", name.replace('_', "-"), value.map_or("default".to_owned(), Value::to_string))
    };
    let expected = format!("an export with the same options, {}", shown(&ours_fields));
    let found = format!("{}; use the same or another folder", shown(&theirs_fields));
    Err(FileError::content(expected, found, path))
}

/// Returns the name of a file in a folder, other than that of the options under their temporary name.
fn foreign_file(folder: &Path) -> Result<Option<String>, FileError> {
    for entry in std::fs::read_dir(folder).map_err(FileError::io("read", folder))? {
        let name = entry.map_err(FileError::io("read", folder))?.file_name().to_string_lossy().into_owned();
        // File systems may have a folder of lost files in a mount point.
        if !name.starts_with(&format!(".{OPTIONS}")) && name != "lost+found" {
            return Ok(Some(name));
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_option_that_differs_is_named() {
        let with = |options: Value| json!({ "version": "1", "records": 2, "options": options });
        let ours = with(json!({ "layout": "frames", "shard_frames": 2, "frames": null }));
        let compared = |theirs: &Value| compare(&ours, theirs, Path::new("export.json"));
        compared(&ours).unwrap();
        for (theirs, expected) in [
            (
                with(json!({ "layout": "frames", "shard_frames": 256, "frames": null })),
                "--shard-frames 2, found --shard-frames 256;",
            ),
            (
                with(json!({ "layout": "frames", "shard_frames": 2, "frames": [0, 1] })),
                "--frames default, found --frames [0,1];",
            ),
            (json!({ "version": "1", "options": {} }), "found one of an earlier version;"),
        ] {
            let message = compared(&theirs).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }
}
