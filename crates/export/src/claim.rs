//! The options of an export, in its folder.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;

use point_skeleton::error::FileError;
use point_skeleton::files::input::is_taken;
use point_skeleton::files::{Inputs, SharedFolder, check_place, json, write_json};
use serde_json::{Value, json};

use crate::ExportOptions;

/// File with the options of an export, in its folder.
const OPTIONS: &str = SharedFolder::OPTIONS;
/// Pause between attempts to write the options while another process does.
const PAUSE: Duration = Duration::from_millis(200);

/// Writes the options into the folder, or compares them with those there. Waits for another process that
/// writes them. `read` is everything that the export reads.
///
/// # Errors
/// Fails if the folder is a part of what is read, if it has an export with other options or foreign files, or
/// if it cannot be written.
pub(crate) fn claim(out: &Path, options: &ExportOptions, read: &Inputs) -> Result<(), FileError> {
    check_place(out, read)?;
    let path = out.join(OPTIONS);
    let content = content(options);
    std::fs::create_dir_all(out).map_err(FileError::io("create", out))?;
    loop {
        let foreign = foreign_file(out)?;
        if is_taken(&path) {
            let theirs: Value = json::read(&path, "the options of an export")?;
            let same = compare(&content, &theirs, &path);
            let is_ours = theirs["options"]["export_layout"].is_string() && !path.is_symlink();
            // Options of an export that never began a shard are replaced, other documents of that name are
            // not.
            if same.is_ok() || foreign.is_some() || !is_ours {
                return same;
            }
        }
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

/// Checks that a folder with a begun shard has these options.
///
/// # Errors
/// Fails if another process, which found no shard, has replaced them.
pub(crate) fn check(out: &Path, options: &ExportOptions) -> Result<(), FileError> {
    let path = out.join(OPTIONS);
    compare(&content(options), &json::read(&path, "the options of an export")?, &path)
}

fn content(options: &ExportOptions) -> Value {
    json!({ "version": env!("CARGO_PKG_VERSION"), "records": RECORDS, "options": options })
}

/// Version of shard records: raised when fingerprints of their input cover more.
const RECORDS: u32 = 3;

/// Compares options with an export's, and names the differing ones as on the command line.
fn compare(ours: &Value, theirs: &Value, path: &Path) -> Result<(), FileError> {
    if ours == theirs {
        return Ok(());
    }
    if theirs.get("records") != ours.get("records") {
        let expected = "an export whose records have fingerprints of all their input";
        let found = "one of an earlier version; keep it, and export to another folder";
        return Err(FileError::content(expected, found, path));
    }
    let names = |value: &Value| value["options"].as_object().map(|o| o.keys().cloned().collect::<Vec<_>>());
    let names: BTreeSet<String> = names(ours).into_iter().chain(names(theirs)).flatten().collect();
    let differs = |name: &&String| ours["options"].get(*name) != theirs["options"].get(*name);
    let differing: Vec<&String> = names.iter().filter(differs).collect();
    let shown = |value: &Value| {
        let options = differing.iter().map(|name| option(name, value["options"].get(*name)));
        let all: Vec<String> = options.collect();
        if all.is_empty() { format!("version {}", value["version"]) } else { all.join(" ") }
    };
    let expected = format!("an export with the same options, {}", shown(ours));
    let found = format!("{}; use the same or another folder", shown(theirs));
    Err(FileError::content(expected, found, path))
}

/// Formats an option as on the command line.
fn option(name: &str, value: Option<&Value>) -> String {
    let name = match name {
        "radius_m" => "radius",
        "times" => "hz or --between-images",
        "prompt" => "annotations",
        "library" => "templates",
        "use_default" => "no-default-templates",
        "layout" => "line-width or --map-layers",
        "export_layout" => "layout",
        name => name,
    };
    let value = value.filter(|value| !value.is_null());
    format!("--{} {}", name.replace('_', "-"), value.map_or("default".to_owned(), Value::to_string))
}

/// Returns the name of a file in a folder, other than the options, also under their temporary name.
fn foreign_file(folder: &Path) -> Result<Option<String>, FileError> {
    for entry in std::fs::read_dir(folder).map_err(FileError::io("read", folder))? {
        let name = entry.map_err(FileError::io("read", folder))?.file_name().to_string_lossy().into_owned();
        // File systems may have a folder of lost files in a mount point.
        if name != OPTIONS && !name.starts_with(&format!(".{OPTIONS}")) && name != "lost+found" {
            return Ok(Some(name));
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_differing_options() {
        let with = |options: Value| json!({ "version": "1", "records": 3, "options": options });
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
