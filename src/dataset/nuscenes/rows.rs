//! Rows of a JSON table without reading the whole file: tables of the trainval set have more than a gigabyte.

use std::fs::File;
use std::io::{ErrorKind, Read};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

use crate::error::FileError;
use crate::files::input::{TABLE_BYTES, open_regular, open_up_to};

/// Bytes to read at a time.
const CHUNK_BYTES: usize = 1 << 20;
/// Maximum size of a row in bytes.
const ROW_BYTES: usize = 64 << 20;

/// Place of a row in its file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RowPlace {
    pub(super) offset: u64,
    pub(super) len: u32,
}

/// State of the search for rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Before the array.
    Start,
    /// Before a row; `true` if one must follow.
    Before(bool),
    /// In a row.
    Row,
    /// In a string of a row; `true` after a backslash.
    Text(bool),
    /// After a row.
    After,
    /// After the array.
    End,
}

/// Calls a function with every object of a JSON array, in file order.
///
/// # Errors
/// Fails if the file cannot be read, or is not one array of objects, each of at most [`ROW_BYTES`] bytes. The objects
/// themselves are not checked. Returns the error of the function as one of the row.
pub(super) fn for_each_row<E: std::fmt::Display>(
    path: &Path,
    of: &str,
    mut visit: impl FnMut(RowPlace, &[u8]) -> Result<(), E>,
) -> Result<(), FileError> {
    let wrong = |found: String| no_table(of, found, path);
    let (file, length) = open_up_to(path, TABLE_BYTES)?;
    let mut file = file.take(length);
    let mut buffer = Vec::with_capacity(2 * CHUNK_BYTES);
    // Position in the file of the buffer, place in it of the next byte and of the current row.
    let (mut base, mut next, mut row) = (0_u64, 0, 0);
    let (mut state, mut depth) = (State::Start, 0_u32);
    loop {
        // Rows that end in the next chunk begin in this one.
        let kept = if depth > 0 { row } else { next };
        buffer.drain(..kept);
        (base, next, row) = (base + kept as u64, next - kept, 0);
        if buffer.len() > ROW_BYTES {
            return Err(wrong(format!("a record of more than {ROW_BYTES} bytes at byte {base}")));
        }
        let read = file.by_ref().take(CHUNK_BYTES as u64).read_to_end(&mut buffer);
        if read.map_err(FileError::io("read", path))? == 0 {
            break;
        }
        while next < buffer.len() {
            let byte = buffer[next];
            let unexpected = || {
                let found = String::from_utf8_lossy(&buffer[next..(next + 1).min(buffer.len())]).into_owned();
                wrong(format!("{found:?} at byte {}", base + next as u64))
            };
            state = match (state, byte) {
                (State::Text(true), _) => State::Text(false),
                (State::Text(false), b'\\') => State::Text(true),
                (State::Text(false), b'"') => State::Row,
                (State::Text(false), _) => state,
                (State::Row, b'"') => State::Text(false),
                (State::Row, b'{' | b'[') => {
                    depth += 1;
                    state
                }
                (State::Row, b'}' | b']') => {
                    depth -= 1;
                    if depth == 0 {
                        let offset = base + row as u64;
                        let bytes = &buffer[row..=next];
                        let place = RowPlace { offset, len: bytes.len() as u32 };
                        visit(place, bytes)
                            .map_err(|e| wrong(format!("{e} of the record at byte {offset}")))?;
                        State::After
                    } else {
                        state
                    }
                }
                (State::Row, _) | (_, b' ' | b'\t' | b'\r' | b'\n') => state,
                (State::Start, b'[') => State::Before(false),
                (State::Before(_), b'{') => {
                    (row, depth) = (next, 1);
                    State::Row
                }
                (State::After, b',') => State::Before(true),
                (State::Before(false) | State::After, b']') => State::End,
                _ => return Err(unexpected()),
            };
            next += 1;
        }
    }
    match state {
        State::End => Ok(()),
        _ => Err(wrong(format!("an end of the file after {} bytes", base + buffer.len() as u64))),
    }
}

/// Creates the error of a table that is no array of records.
pub(super) fn no_table(of: &str, found: String, path: &Path) -> FileError {
    FileError::content(format!("a JSON array of {of} records"), found, path)
}

/// Open table of which single rows are read.
#[derive(Debug)]
pub(super) struct RowFile {
    file: File,
    path: PathBuf,
}

impl RowFile {
    /// Opens a table.
    ///
    /// # Errors
    /// Fails if it is not a regular file or cannot be opened.
    pub(super) fn open(path: PathBuf) -> Result<Self, FileError> {
        Ok(Self { file: open_regular(&path)?.0, path })
    }

    /// Reads and parses a row.
    ///
    /// # Errors
    /// Fails if the bytes cannot be read or are not such a record, as they may be after the file was changed.
    pub(super) fn read<R: DeserializeOwned>(&self, place: RowPlace, of: &str) -> Result<R, FileError> {
        let wrong = |found: String| {
            no_table(of, format!("{found} of the record at byte {}", place.offset), &self.path)
        };
        let mut bytes = vec![0; place.len as usize];
        self.file.read_exact_at(&mut bytes, place.offset).map_err(|error| match error.kind() {
            ErrorKind::UnexpectedEof => wrong("the end of the file".to_owned()),
            _ => FileError::io("read", &self.path)(error),
        })?;
        serde_json::from_slice(&bytes).map_err(|error| wrong(error.to_string()))
    }

    /// Returns the path of the table.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the rows of a file with a text, or the message.
    fn rows(text: &[u8]) -> Result<Vec<String>, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.json");
        std::fs::write(&path, text).unwrap();
        let mut rows = Vec::new();
        let visit = |place: RowPlace, row: &[u8]| {
            let start = place.offset as usize;
            assert_eq!(&text[start..start + place.len as usize], row);
            rows.push(String::from_utf8_lossy(row).into_owned());
            Ok::<(), String>(())
        };
        for_each_row(&path, "sensor", visit).map_err(|e| e.to_string()).map(|()| rows)
    }

    #[test]
    fn rows_are_the_objects_of_the_array() {
        assert_eq!(rows(b" [ ]\n").unwrap(), [""; 0]);
        let text = br#" [ {"a": "}\"]{", "b": [{}, []]} ,
            {"c\\": 1}]"#;
        assert_eq!(rows(text).unwrap(), [r#"{"a": "}\"]{", "b": [{}, []]}"#, r#"{"c\\": 1}"#]);
    }

    #[test]
    fn rows_cross_chunks() {
        let row = |i: usize| format!("{{\"{}\": {i}}}", "x".repeat(i * 1000 % 70_001));
        let expected: Vec<String> = (0..200).map(row).collect();
        let text = format!("[{}]", expected.join(",\n"));
        assert!(text.len() > 4 * CHUNK_BYTES);
        assert_eq!(rows(text.as_bytes()).unwrap(), expected);
    }

    #[test]
    fn what_is_no_array_of_objects_is_refused() {
        for (text, found) in [
            ("", "an end of the file after 0 bytes"),
            ("{}", "\"{\" at byte 0"),
            ("[{}", "an end of the file after 3 bytes"),
            ("[{\"a", "an end of the file after 4 bytes"),
            ("[{},]", "\"]\" at byte 4"),
            ("[{}{}]", "\"{\" at byte 3"),
            ("[1]", "\"1\" at byte 1"),
            ("[] []", "\"[\" at byte 3"),
        ] {
            let message = rows(text.as_bytes()).unwrap_err();
            assert!(
                message.contains("a JSON array of sensor records") && message.contains(found),
                "{message}"
            );
        }
    }
}
