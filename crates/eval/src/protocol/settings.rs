use std::path::Path;

use point_skeleton::error::FileError;
use point_skeleton::files::input::is_there;
use point_skeleton::files::json;
use serde_json::Value;

/// Compares the options of a run with the file of an earlier run in the same folder, if there is one.
///
/// # Errors
/// Fails if an option differs, or if the file cannot be read.
pub fn check_settings(path: &Path, settings: &Value) -> Result<(), FileError> {
    if !is_there(path)? {
        return Ok(());
    }
    let earlier: Value = json::read(path, "options of a protocol")?;
    let differs = |key: &&String| earlier.get(*key) != settings.get(*key);
    match settings.as_object().and_then(|fields| fields.keys().find(differs)) {
        Some(key) => Err(FileError::content(format!("the {key} of this command"), "another", path)),
        None => Ok(()),
    }
}
