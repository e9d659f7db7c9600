//! Archives in the form of USDZ.

use std::io::{Cursor, Write};
use std::path::Path;

use point_skeleton::error::FileError;
use serde_json::Value;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

/// Multiple at which the content of a file begins, bytes.
const ALIGNMENT: u16 = 64;

/// A file of an archive.
pub(super) struct Entry {
    pub(super) path: String,
    pub(super) bytes: Vec<u8>,
}

impl Entry {
    /// Creates a JSON file. It is valid YAML too.
    pub(super) fn json(path: &str, value: &Value) -> Self {
        Self { path: path.to_owned(), bytes: format!("{value}\n").into_bytes() }
    }
}

/// Returns an archive of files, in their order and at a fixed time. `path` is the file that errors name.
///
/// # Errors
/// Fails if it is larger than the format allows.
pub(super) fn stored(entries: &[Entry], path: &Path) -> Result<Vec<u8>, FileError> {
    let write = || -> zip::result::ZipResult<Vec<u8>> {
        let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .last_modified_time(DateTime::default())
            .unix_permissions(0o644)
            .with_alignment(ALIGNMENT);
        for Entry { path, bytes } in entries {
            zip.start_file(path, options)?;
            zip.write_all(bytes)?;
        }
        Ok(zip.finish()?.into_inner())
    };
    write().map_err(|error| FileError::io("write", path)(std::io::Error::other(error)))
}
