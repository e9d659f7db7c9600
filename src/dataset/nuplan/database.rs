//! SQLite files, read row by row with type-checked values.
//!
//! A damaged file may define endless views, or reference a page many times. So the number of SQLite
//! instructions and the bytes of rows are both limited in proportion to the file length.

use std::cell::Cell;
use std::fmt::Write;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use rusqlite::types::ValueRef;
use rusqlite::{Connection, OpenFlags};

use crate::dataset::clock::Unit;
use crate::dataset::limits::MAX_TIME_US;
use crate::dataset::{DatasetError, Gap};
use crate::error::FileError;
use crate::files::input::open_regular;
use crate::files::sniff;

/// An open SQLite file.
pub(super) struct Database {
    connection: Connection,
    path: PathBuf,
    /// Remaining budget for the bytes of rows.
    bytes_left: Cell<u64>,
}

/// Up to this number, all integers are exact floats.
const MAX_WHOLE: f64 = (1_i64 << 53) as f64;

/// First bytes of a database.
const MAGIC: &[u8] = b"SQLite format 3\0";

/// Maximum SQLite VM instructions per byte of a file; real logs and maps take less than one.
const STEPS_PER_BYTE: u64 = 64;
/// Additional instructions, for small files.
const STEPS: u64 = 1_000_000;
/// Interval for counting instructions.
const STEPS_COUNTED: u16 = 10_000;
/// Maximum bytes of rows per byte of a file: joins read rows more than once.
const ROW_BYTES_PER_BYTE: u64 = 8;

/// Selection of rows.
pub(super) struct Query<'a> {
    /// Name of the table, for messages.
    pub(super) table: &'a str,
    /// Columns to read; the first one identifies the row in messages.
    pub(super) columns: &'a [&'a str],
    /// SQL text after `SELECT columns`.
    pub(super) from: &'a str,
}

/// Row of a query; columns are addressed by their position in it.
pub(super) struct Row<'a> {
    row: &'a rusqlite::Row<'a>,
    query: &'a Query<'a>,
    path: &'a Path,
}

impl Database {
    /// Opens a file as immutable, so that SQLite creates no lock or journal files beside it.
    ///
    /// # Errors
    /// Fails if the file is missing, is not a SQLite database, or has a non-empty write-ahead log beside it.
    pub(super) fn open(path: &Path) -> Result<Self, FileError> {
        refuse_journal(path)?;
        // SQLite's message for an unreadable file is less specific.
        let (file, length) = open_regular(path)?;
        let mut head = [0; sniff::HEAD_BYTES];
        let bytes = file.read_at(&mut head, 0).map_err(FileError::io("read", path))?;
        if let Some(found) = sniff::described(&head[..bytes]).filter(|_| !head.starts_with(MAGIC)) {
            return Err(FileError::content("a SQLite database", found, path));
        }
        if let Some(whole) = declared_bytes(&head[..bytes]).filter(|whole| *whole > length) {
            let found = format!("{length} of at least {whole} bytes (cut off)");
            return Err(FileError::content("a whole SQLite database", found, path));
        }
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
        // Views in the file may not call functions with side effects. The query rejects files that are not a
        // database.
        connection.pragma_update(None, "trusted_schema", false).map_err(wrong)?;
        connection.query_row("SELECT count(*) FROM sqlite_master", [], |_| Ok(())).map_err(wrong)?;
        let bytes_left = Cell::new(length.saturating_mul(ROW_BYTES_PER_BYTE));
        Ok(Self { connection, path: path.to_owned(), bytes_left })
    }

    /// The file.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Passes every row to `each`, in the query's order.
    ///
    /// # Errors
    /// Fails if a table or column is missing, pages are damaged, or a limit is exceeded. Returns any error of
    /// `each`.
    pub(super) fn rows(
        &self,
        query: &Query<'_>,
        mut each: impl FnMut(&Row<'_>) -> Result<(), DatasetError>,
    ) -> Result<(), DatasetError> {
        let (table, path) = (query.table, self.path.as_path());
        let wrong = |e: rusqlite::Error| {
            // SQLite's message alone; the full error would include the whole statement.
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

    /// Returns whether a table has a column that not all versions of the layout have.
    ///
    /// # Errors
    /// Fails if the schema cannot be read.
    pub(super) fn has_column(&self, table: &str, column: &str) -> Result<bool, DatasetError> {
        let query = "SELECT count(*) FROM pragma_table_info(?1) WHERE name = ?2";
        let wrong = |e: rusqlite::Error| FileError::content("a SQLite database", e.to_string(), &self.path);
        let count = self.connection.query_row(query, [table, column], |row| row.get::<_, i64>(0));
        Ok(count.map_err(wrong)? > 0)
    }

    /// Subtracts a row's size from the budget: one byte, plus the lengths of texts and blobs. Numbers count
    /// as 0, the minimum that SQLite needs for them.
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

/// Returns the size of a database that its header declares; `None` if it declares none that is valid.
fn declared_bytes(head: &[u8]) -> Option<u64> {
    const HEADER_BYTES: u64 = 100;
    if !head.starts_with(MAGIC) {
        return None;
    }
    let word = |at: usize| head.get(at..)?.first_chunk::<4>().copied().map(u32::from_be_bytes);
    let (Some(version), Some(&[high, low])) = (word(92), head.get(16..).and_then(<[u8]>::first_chunk)) else {
        return Some(HEADER_BYTES);
    };
    let page = match u16::from_be_bytes([high, low]) {
        1 => 1 << 16,
        page => u64::from(page),
    };
    // Old versions write no number of pages.
    let pages = word(28).filter(|_| word(24) == Some(version))?;
    Some(page * u64::from(pages))
}

/// Aborts statements once all of them together exceed the instruction limit. No valid file of this length
/// reaches it.
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
    /// Returns the table and the first column, for messages.
    pub(super) fn name(&self) -> String {
        let key = match self.value(0) {
            ValueRef::Blob(bytes) => hex(bytes),
            other => shown(other),
        };
        format!("{} {key}", self.query.table)
    }

    /// Creates an error about the value of a column in this row.
    pub(super) fn wrong(&self, column: usize, expected: &str, found: &str) -> DatasetError {
        let (table, column) = (self.query.table, self.query.columns[column]);
        let column = column.strip_prefix(&format!("{table}.")).unwrap_or(column);
        let expected = format!("{expected} as {column} of {}", self.name());
        FileError::content(expected, found, self.path).into()
    }

    /// Creates the gap of this row, which refers to a row of another table that does not exist; `token` is
    /// `None` for an empty reference.
    pub(super) fn dangling(&self, kind: &'static str, table: &str, token: Option<&[u8]>) -> Gap {
        let token = token.map_or_else(|| "NULL".to_owned(), hex);
        Gap::dangling(kind, &self.name(), table, &token, self.path)
    }

    pub(super) fn is_null(&self, column: usize) -> bool {
        self.value(column) == ValueRef::Null
    }

    /// Returns a binary key.
    pub(super) fn blob(&self, column: usize) -> Result<&'a [u8], DatasetError> {
        match self.value(column) {
            ValueRef::Blob(bytes) => Ok(bytes),
            other => Err(self.wrong(column, "bytes", &shown(other))),
        }
    }

    /// Returns a binary key of another table; `None` if empty.
    pub(super) fn reference(&self, column: usize) -> Result<Option<&'a [u8]>, DatasetError> {
        if self.is_null(column) { Ok(None) } else { self.blob(column).map(Some) }
    }

    /// Returns an integer, or a float that is whole.
    pub(super) fn integer(&self, column: usize) -> Result<i64, DatasetError> {
        match self.value(column) {
            ValueRef::Integer(number) => Ok(number),
            ValueRef::Real(number) if number.fract() == 0.0 && number.abs() <= MAX_WHOLE => Ok(number as i64),
            other => Err(self.wrong(column, "a whole number", &shown(other))),
        }
    }

    /// Returns absolute microseconds, at most [`MAX_TIME_US`] from 1970. Fractions are rounded.
    pub(super) fn time_us(&self, column: usize) -> Result<i64, DatasetError> {
        let t_us = match self.value(column) {
            ValueRef::Real(t_us) if t_us.abs() <= MAX_WHOLE => t_us.round() as i64,
            _ => self.integer(column)?,
        };
        if t_us.unsigned_abs() > MAX_TIME_US.unsigned_abs() {
            return Err(self.wrong(
                column,
                "microseconds within a thousand years of 1970",
                &format!("{t_us}{}", Unit::MICROS.hint(t_us as f64)),
            ));
        }
        Ok(t_us)
    }

    /// Returns any number; SQLite stores whole numbers as integers in some columns.
    pub(super) fn number(&self, column: usize) -> Result<f64, DatasetError> {
        match self.value(column) {
            ValueRef::Integer(number) => Ok(number as f64),
            ValueRef::Real(number) => Ok(number),
            other => Err(self.wrong(column, "a number", &shown(other))),
        }
    }

    /// Returns the numbers of adjacent columns.
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

    /// Returns a whole number of any storage type: maps store identifiers as integers, as floats and as text.
    /// `None` if empty.
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
        // A column outside the query is a bug in this program; it appears as a NULL in the data.
        self.row.get_ref(column).unwrap_or(ValueRef::Null)
    }
}

/// Rejects a non-empty write-ahead log. Its rows are not in the file yet, and merging them would modify the
/// file.
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

/// Returns bytes as hexadecimal digits.
pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::with_capacity(2 * bytes.len()), |mut text, byte| {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

/// Formats a value for messages.
fn shown(value: ValueRef<'_>) -> String {
    match value {
        ValueRef::Null => "NULL".to_owned(),
        ValueRef::Integer(number) => number.to_string(),
        ValueRef::Real(number) => number.to_string(),
        ValueRef::Text(bytes) => format!("{:?}", String::from_utf8_lossy(&bytes[..bytes.len().min(60)])),
        ValueRef::Blob(bytes) => format!("{} bytes", bytes.len()),
    }
}
