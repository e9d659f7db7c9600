//! Rows of a JSON table without reading the whole file: tables of the trainval set have more than a gigabyte.

use std::fs::File;
use std::io::{ErrorKind, Read};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::error::FileError;
use crate::files::input::{TABLE_BYTES, open_regular, open_up_to};
use crate::files::{json, sniff};

/// Bytes to read at a time.
const CHUNK_BYTES: usize = 1 << 20;
/// Maximum size of a row in bytes.
const ROW_BYTES: usize = 64 << 20;

/// Place of a row in its file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) struct RowPlace {
    pub(in super::super) offset: u64,
    pub(in super::super) len: u32,
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
/// Fails if the file cannot be read, or is not one array of objects, each of at most [`ROW_BYTES`] bytes. The
/// objects themselves are not checked. Returns the error of the function as one of the row.
pub(in super::super) fn for_each_row<E: std::fmt::Display>(
    path: &Path,
    of: &str,
    mut visit: impl FnMut(RowPlace, &[u8]) -> Result<(), E>,
) -> Result<(), FileError> {
    let wrong = |found: String| no_table(of, found, path);
    let (file, length) = open_up_to(path, TABLE_BYTES)?;
    let mut file = file.take(length);
    let mut mark = [0; json::BYTE_ORDER_MARK.len()];
    let has_mark = file.get_ref().read_at(&mut mark, 0).is_ok_and(|_| mark == json::BYTE_ORDER_MARK);
    let start = if has_mark { file.read_exact(&mut mark).map_or(0, |()| mark.len()) } else { 0 };
    let mut buffer = Vec::with_capacity(2 * CHUNK_BYTES);
    // Position in the file of the buffer, place in it of the next byte and of the current row.
    let (mut base, mut next, mut row) = (start as u64, 0, 0);
    let (mut state, mut depth) = (State::Start, 0_u32);
    loop {
        // Rows that end in the next chunk begin in this one.
        let retained = if depth > 0 { row } else { next };
        buffer.drain(..retained);
        (base, next, row) = (base + retained as u64, next - retained, 0);
        if buffer.len() > ROW_BYTES {
            return Err(wrong(format!("a record of more than {ROW_BYTES} bytes at byte {base}")));
        }
        let read = file.by_ref().take(CHUNK_BYTES as u64).read_to_end(&mut buffer);
        if read.map_err(FileError::io("read", path))? == 0 {
            break;
        }
        while next < buffer.len() {
            let byte = buffer[next];
            let unexpected = || wrong(unexpected(&buffer, next, base, state));
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
                        visit(place, bytes).map_err(|e| wrong(in_record(&e, offset, bytes)))?;
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
        _ if length == 0 => Err(wrong("an empty file".to_owned())),
        _ => Err(wrong(format!("an end of the file after {} bytes", base + buffer.len() as u64))),
    }
}

/// Describes a byte of a table that does not continue an array of objects.
fn unexpected(buffer: &[u8], next: usize, base: u64, state: State) -> String {
    let rest = &buffer[next..buffer.len().min(next + sniff::HEAD_BYTES)];
    let at = base + next as u64;
    match (state, rest[0]) {
        (State::Start, b'{') => json::object_instead_of_array(&buffer[next..]),
        (State::Before(true), b']') => format!("a comma before the closing bracket at byte {at}"),
        // Text in UTF-16 begins with the bracket too.
        (State::Start | State::Before(false), _) if at <= 2 && sniff::marked(buffer).is_some() => {
            sniff::marked(buffer).unwrap_or_default().to_owned()
        }
        _ => {
            let text: String = String::from_utf8_lossy(rest).chars().take(20).collect();
            format!("{text:?} at byte {at}")
        }
    }
}

/// Adds the record's name to a description, unless it is already named.
fn in_record(found: &impl std::fmt::Display, offset: u64, row: &[u8]) -> String {
    /// Any record of a table.
    #[derive(Deserialize)]
    struct Token {
        token: String,
    }
    let found = found.to_string();
    let is_named = json::parsed::<Token>(row).is_ok_and(|record| found.contains(&record.token));
    if is_named { found } else { format!("{found} in the record at byte {offset}") }
}

/// Describes a table in messages.
pub(in super::super) fn array_of(table: &str) -> String {
    format!("a JSON array of {table} records")
}

/// Creates the error of a table that is no array of records.
fn no_table(of: &str, found: String, path: &Path) -> FileError {
    FileError::content(array_of(of), found, path)
}

/// Open table with access to single rows.
#[derive(Debug)]
pub(in super::super) struct RowFile {
    file: File,
    path: PathBuf,
}

impl RowFile {
    /// Opens a table.
    ///
    /// # Errors
    /// Fails if it is not a regular file or cannot be opened.
    pub(in super::super) fn open(path: PathBuf) -> Result<Self, FileError> {
        Ok(Self { file: open_regular(&path)?.0, path })
    }

    /// Reads and parses a row.
    ///
    /// # Errors
    /// Fails if the bytes cannot be read or are not such a record, as they may be after the file was changed.
    pub(in super::super) fn read<R: DeserializeOwned>(
        &self,
        place: RowPlace,
        of: &str,
    ) -> Result<R, FileError> {
        let offset = place.offset;
        let wrong = |found: String| no_table(of, found, &self.path);
        let mut bytes = vec![0; place.len as usize];
        self.file.read_exact_at(&mut bytes, place.offset).map_err(|error| match error.kind() {
            ErrorKind::UnexpectedEof => wrong(format!("the end of the file in the record at byte {offset}")),
            _ => FileError::io("read", &self.path)(error),
        })?;
        json::parsed(&bytes).map_err(|found| wrong(in_record(&found, offset, &bytes)))
    }

    /// Returns the path of the table.
    pub(in super::super) fn path(&self) -> &Path {
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
        assert_eq!(rows(b"\xef\xbb\xbf[{}]").unwrap(), ["{}"]);
        let text = br#" [ {"a": "}\"]{", "b": [{}, []]} ,
            {"c\\": 1}]"#;
        assert_eq!(rows(text).unwrap(), [r#"{"a": "}\"]{", "b": [{}, []]}"#, r#"{"c\\": 1}"#]);
    }

    #[test]
    fn rows_may_cross_chunks() {
        let row = |i: usize| format!("{{\"{}\": {i}}}", "x".repeat(i * 1000 % 70_001));
        let expected: Vec<String> = (0..200).map(row).collect();
        let text = format!("[{}]", expected.join(",\n"));
        assert!(text.len() > 4 * CHUNK_BYTES);
        assert_eq!(rows(text.as_bytes()).unwrap(), expected);
    }

    #[test]
    fn rejects_non_array() {
        for (text, found) in [
            ("", "an empty file"),
            ("{\"a\": 1}\n{\"a\": 2}", "an object instead of an array (JSON lines?"),
            ("{\"data\": [{}]}", "an object instead of an array (its field data holds the records?"),
            ("[\0{\0\"\0", "UTF-16 text (save it as UTF-8)"),
            ("\0[\0{\0\"", "UTF-16 text (save it as UTF-8)"),
            ("\u{1f}", "\"\\u{1f}\" at byte 0"),
            ("{}", "an object instead of an array"),
            ("[{}", "an end of the file after 3 bytes"),
            ("[{\"a", "an end of the file after 4 bytes"),
            ("[{},]", "a comma before the closing bracket at byte 4"),
            ("[{}{}]", "\"{}]\" at byte 3"),
            ("[1]", "\"1]\" at byte 1"),
            ("[] []", "\"[]\" at byte 3"),
        ] {
            let message = rows(text.as_bytes()).unwrap_err();
            assert!(
                message.contains("a JSON array of sensor records") && message.contains(found),
                "{message}"
            );
        }
    }
}
