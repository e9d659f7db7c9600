//! SQLite files, read row by row; every value is checked for its type.
//!
//! A file may define views that never end, and pages that lie in many places at once. So both the steps that SQLite takes
//! and the bytes that rows hold are limited by the file's length.

use std::cell::Cell;
use std::fmt::Write;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use rusqlite::types::ValueRef;
use rusqlite::{Connection, OpenFlags};

use crate::dataset::{DatasetError, MAX_TIME_US};
use crate::error::FileError;
use crate::files::input::open_regular;

/// A SQLite file.
pub(super) struct Database {
    connection: Connection,
    path: PathBuf,
    /// Bytes that rows may still hold.
    bytes_left: Cell<u64>,
}

/// Instructions of SQLite's machine per byte of a file; real logs and maps take less than one.
const STEPS_PER_BYTE: u64 = 64;
/// More, for small files.
const STEPS: u64 = 1_000_000;
/// How often the steps are counted, instructions.
const STEPS_COUNTED: u16 = 10_000;
/// Bytes of rows per byte of a file: rows are read more than once where tables are joined.
const ROW_BYTES_PER_BYTE: u64 = 8;

/// Which rows are read.
pub(super) struct Query<'a> {
    /// The table, for messages.
    pub(super) table: &'a str,
    /// What is read; the first is what a row is called in messages.
    pub(super) columns: &'a [&'a str],
    /// What follows `SELECT columns`.
    pub(super) from: &'a str,
}

/// A row of a query; columns go by their place in it.
pub(super) struct Row<'a> {
    row: &'a rusqlite::Row<'a>,
    query: &'a Query<'a>,
    path: &'a Path,
}

impl Database {
    /// Opens a file. It is taken for unchanging, so that SQLite makes no lock or journal files beside it.
    ///
    /// # Errors
    /// A file that is missing, is no SQLite database, or has a write-ahead log beside it.
    pub(super) fn open(path: &Path) -> Result<Self, FileError> {
        refuse_journal(path)?;
        // SQLite says less about a file that it cannot read.
        let (_, length) = open_regular(path)?;
        let mut uri = String::from("file:");
        for byte in path.as_os_str().as_bytes() {
            match byte {
                b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'.' | b'-' | b'_' => {
                    uri.push(char::from(*byte))
                }
                // Writing to a string cannot fail.
                _ => _ = write!(uri, "%{byte:02x}"),
            }
        }
        uri += "?immutable=1";
        let flags =
            OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_URI | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let wrong = |e: rusqlite::Error| FileError::content("a SQLite database", e.to_string(), path);
        let mut connection = Connection::open_with_flags(uri, flags).map_err(wrong)?;
        limit_steps(&mut connection, length).map_err(wrong)?;
        // A view in the file may not call functions with effects; nor is a file taken that is no database.
        connection.pragma_update(None, "trusted_schema", false).map_err(wrong)?;
        connection.query_row("SELECT count(*) FROM sqlite_master", [], |_| Ok(())).map_err(wrong)?;
        let bytes_left = Cell::new(length.saturating_mul(ROW_BYTES_PER_BYTE));
        Ok(Self { connection, path: path.to_owned(), bytes_left })
    }

    /// The file.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Hands every row to `each`, in the query's order.
    ///
    /// # Errors
    /// A table or column that is not there, damaged pages, whatever `each` returns.
    pub(super) fn rows(
        &self,
        query: &Query<'_>,
        mut each: impl FnMut(&Row<'_>) -> Result<(), DatasetError>,
    ) -> Result<(), DatasetError> {
        let (table, path) = (query.table, self.path.as_path());
        let wrong = |e: rusqlite::Error| {
            // The message of SQLite alone: the rest would be the whole statement.
            let found = match e {
                rusqlite::Error::SqliteFailure(_, Some(message)) => message,
                rusqlite::Error::SqlInputError { msg, .. } => msg,
                other => other.to_string(),
            };
            FileError::content(format!("{table} with {}", query.columns.join(", ")), found, path)
        };
        let sql = format!("SELECT {} {}", query.columns.join(", "), query.from);
        let mut statement = self.connection.prepare(&sql).map_err(wrong)?;
        let mut rows = statement.query([]).map_err(wrong)?;
        while let Some(row) = rows.next().map_err(wrong)? {
            self.count_bytes(row, query)?;
            each(&Row { row, query, path })?;
        }
        Ok(())
    }
}

impl Database {
    /// Takes a row's bytes off those that are left. A number counts as what SQLite needs for it at least.
    fn count_bytes(&self, row: &rusqlite::Row<'_>, query: &Query<'_>) -> Result<(), FileError> {
        let size = |column: usize| match row.get_ref(column) {
            Ok(ValueRef::Text(bytes) | ValueRef::Blob(bytes)) => bytes.len() as u64,
            _ => 0,
        };
        let bytes = 1 + (0..query.columns.len()).map(size).sum::<u64>();
        let left = self.bytes_left.get().checked_sub(bytes).ok_or_else(|| {
            let expected = format!("rows of {} that fit into the file", query.table);
            FileError::content(expected, "more", &self.path)
        })?;
        self.bytes_left.set(left);
        Ok(())
    }
}

/// Ends statements, all together, after a number of instructions that no sound file of this length takes.
fn limit_steps(connection: &mut Connection, length: u64) -> rusqlite::Result<()> {
    let most = STEPS + length.saturating_mul(STEPS_PER_BYTE);
    let mut left = most / u64::from(STEPS_COUNTED);
    let count = move || {
        left = left.saturating_sub(1);
        left == 0
    };
    connection.progress_handler(STEPS_COUNTED.into(), Some(count))
}

impl<'a> Row<'a> {
    /// Table and first column, for messages.
    pub(super) fn name(&self) -> String {
        let key = match self.value(0) {
            ValueRef::Blob(bytes) => hex(bytes),
            other => shown(other),
        };
        format!("{} {key}", self.query.table)
    }

    /// A wrong content of this row; `column` is what it stands in.
    pub(super) fn wrong(&self, column: usize, expected: &str, found: &str) -> DatasetError {
        let (table, column) = (self.query.table, self.query.columns[column]);
        let column = column.strip_prefix(&format!("{table}.")).unwrap_or(column);
        let expected = format!("{expected} as {column} of {}", self.name());
        FileError::content(expected, found, self.path).into()
    }

    /// A key in another table that holds no such row.
    pub(super) fn dangling(&self, table: &str, token: &[u8]) -> DatasetError {
        let expected = format!("{table} to hold token {}", hex(token));
        FileError::content(expected, format!("none (referred to by {})", self.name()), self.path).into()
    }

    pub(super) fn is_null(&self, column: usize) -> bool {
        self.value(column) == ValueRef::Null
    }

    /// A key of bytes.
    pub(super) fn blob(&self, column: usize) -> Result<&'a [u8], DatasetError> {
        match self.value(column) {
            ValueRef::Blob(bytes) => Ok(bytes),
            other => Err(self.wrong(column, "bytes", &shown(other))),
        }
    }

    pub(super) fn integer(&self, column: usize) -> Result<i64, DatasetError> {
        match self.value(column) {
            ValueRef::Integer(number) => Ok(number),
            other => Err(self.wrong(column, "a whole number", &shown(other))),
        }
    }

    /// Absolute microseconds, not further from 1970 than [`MAX_TIME_US`].
    pub(super) fn time_us(&self, column: usize) -> Result<i64, DatasetError> {
        let t_us = self.integer(column)?;
        if t_us.unsigned_abs() > MAX_TIME_US.unsigned_abs() {
            return Err(self.wrong(
                column,
                "microseconds within a thousand years of 1970",
                &t_us.to_string(),
            ));
        }
        Ok(t_us)
    }

    /// Any number; SQLite stores whole ones as such in some columns.
    pub(super) fn number(&self, column: usize) -> Result<f64, DatasetError> {
        match self.value(column) {
            ValueRef::Integer(number) => Ok(number as f64),
            ValueRef::Real(number) => Ok(number),
            other => Err(self.wrong(column, "a number", &shown(other))),
        }
    }

    /// Numbers of neighbouring columns.
    pub(super) fn numbers<const N: usize>(&self, first: usize) -> Result<[f64; N], DatasetError> {
        let mut numbers = [0.0; N];
        for (i, number) in numbers.iter_mut().enumerate() {
            *number = self.number(first + i)?;
        }
        Ok(numbers)
    }

    pub(super) fn text(&self, column: usize) -> Result<&'a str, DatasetError> {
        let text = match self.value(column) {
            ValueRef::Text(bytes) => str::from_utf8(bytes).ok(),
            _ => None,
        };
        text.ok_or_else(|| self.wrong(column, "text", &shown(self.value(column))))
    }

    /// A whole number, however it is stored: maps have identifiers as numbers with and without fraction, and as text.
    pub(super) fn identifier(&self, column: usize) -> Result<Option<i64>, DatasetError> {
        let number = match self.value(column) {
            ValueRef::Null => return Ok(None),
            ValueRef::Integer(number) => Some(number),
            ValueRef::Real(number) if number.fract() == 0.0 => Some(number as i64),
            ValueRef::Text([]) => return Ok(None),
            ValueRef::Text(bytes) => str::from_utf8(bytes).ok().and_then(|text| text.trim().parse().ok()),
            _ => None,
        };
        let wrong = || self.wrong(column, "a whole number", &shown(self.value(column)));
        number.map(Some).ok_or_else(wrong)
    }

    fn value(&self, column: usize) -> ValueRef<'a> {
        // A column that is not in the query is a mistake of ours; it shows as one of the data.
        self.row.get_ref(column).unwrap_or(ValueRef::Null)
    }
}

/// What stands in a write-ahead log is not in the file yet, and taking it over would write to the file.
fn refuse_journal(path: &Path) -> Result<(), FileError> {
    let mut journal = path.as_os_str().to_owned();
    journal.push("-wal");
    let journal = PathBuf::from(journal);
    let bytes = match std::fs::metadata(&journal) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        found => found.map_err(FileError::io("read", &journal))?.len(),
    };
    if bytes == 0 {
        return Ok(());
    }
    let expected = "a database without a write-ahead log (open and close it with sqlite3 once)";
    Err(FileError::content(expected, format!("{bytes} bytes in {}", journal.display()), path))
}

/// Bytes as hexadecimal digits.
pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::with_capacity(2 * bytes.len()), |mut text, byte| {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

/// A value in a message.
fn shown(value: ValueRef<'_>) -> String {
    match value {
        ValueRef::Null => "NULL".to_owned(),
        ValueRef::Integer(number) => number.to_string(),
        ValueRef::Real(number) => number.to_string(),
        ValueRef::Text(bytes) => format!("{:?}", String::from_utf8_lossy(&bytes[..bytes.len().min(60)])),
        ValueRef::Blob(bytes) => format!("{} bytes", bytes.len()),
    }
}
