//! Tables with images or sweeps in their cells.

use std::sync::{Arc, Mutex, PoisonError};

use arrow_schema::DataType;

use crate::dataset::tables::{ArrowFile, Table};
use crate::error::FileError;

/// Form of the cells in a column `data`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CellKind {
    /// Names of files.
    Path,
    /// Encoded images or sweeps.
    Bytes,
    /// Numbers of frames in a video.
    Video,
}

/// Adds the row to an error about the content of a cell.
fn in_row(error: FileError, row: u32) -> FileError {
    match error {
        FileError::Content { expected, found, path } => {
            FileError::Content { expected: format!("{expected} in row {row}"), found, path }
        }
        other => other,
    }
}

/// Table of a sensor.
pub(super) struct CellTable {
    pub(super) file: ArrowFile,
    /// Key of the table, which precedes the names of its columns.
    pub(super) key: String,
    pub(super) kind: CellKind,
    data: String,
    /// Batch that was decoded last: batches may be compressed, and frames are read in order.
    last: Mutex<Option<(usize, Arc<Table>)>>,
}

impl CellTable {
    /// Takes a table that is mapped sparsely, to read its other columns.
    ///
    /// # Errors
    /// Fails if there is no column `data`, or it has an unknown type.
    pub(super) fn new(file: ArrowFile, key: &str) -> Result<Self, FileError> {
        let data = format!("{key}.data");
        let kind = match file.column_type(&data) {
            Some(DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View) => CellKind::Path,
            Some(DataType::Binary | DataType::LargeBinary | DataType::BinaryView) => CellKind::Bytes,
            Some(DataType::Int32 | DataType::Int64) => CellKind::Video,
            found => {
                let found = found.map_or_else(|| "none".to_owned(), |found| format!("type {found}"));
                return Err(FileError::content(
                    format!("paths, bytes or frame numbers in column {data}"),
                    found,
                    file.path(),
                ));
            }
        };
        Ok(Self { file, key: key.to_owned(), kind, data, last: Mutex::new(None) })
    }

    /// Ends the reading of columns other than the cells.
    ///
    /// # Errors
    /// Fails if the file has changed.
    pub(super) fn ready(self) -> Result<Self, FileError> {
        Ok(Self { file: self.file.map_again()?, ..self })
    }

    /// Name of a column.
    pub(super) fn column(&self, name: &str) -> String {
        format!("{}.{name}", self.key)
    }

    /// Returns the names of the files; `None` for empty cells, and if the cells hold none.
    ///
    /// # Errors
    /// Fails if the column is damaged.
    pub(super) fn names(&self) -> Result<Vec<Option<String>>, FileError> {
        match self.kind {
            CellKind::Path => self.file.table(&[&self.data], &[])?.column(&self.data)?.texts_or_none(),
            CellKind::Bytes | CellKind::Video => Ok(vec![None; self.file.rows() as usize]),
        }
    }

    /// Reads the cell of a row by a function.
    ///
    /// # Errors
    /// Fails if the row does not exist, its cell is empty, or its batch is damaged, and as the function.
    pub(super) fn read<T>(
        &self,
        row: u32,
        read: impl FnOnce(&[u8]) -> Result<T, FileError>,
    ) -> Result<T, FileError> {
        let (batch, place) = self.file.place(row.into()).ok_or_else(|| self.no_cell(row))?;
        let table = self.batch(batch)?;
        let bytes = table.column(&self.data)?.bytes(place)?;
        read(bytes.ok_or_else(|| self.no_cell(row))?).map_err(|error| in_row(error, row))
    }

    fn batch(&self, batch: usize) -> Result<Arc<Table>, FileError> {
        let known = self.last.lock().unwrap_or_else(PoisonError::into_inner).clone();
        if let Some((_, table)) = known.filter(|(known, _)| *known == batch) {
            return Ok(table);
        }
        let table = Arc::new(self.file.batch(batch, &[&self.data], &[])?);
        *self.last.lock().unwrap_or_else(PoisonError::into_inner) = Some((batch, Arc::clone(&table)));
        Ok(table)
    }

    fn no_cell(&self, row: u32) -> FileError {
        FileError::content(format!("data in row {row} of column {}", self.data), "none", self.file.path())
    }
}
