//! Arrow IPC files: tables with named columns, as in Feather files (version 2) and logs of py123d.
//!
//! # How it works
//! [`ArrowFile`] validates the footer and the declared sizes of all batches of rows (`layout`, `check`), but
//! decodes none. [`ArrowFile::table`] decodes selected columns of the whole file, [`ArrowFile::batch`] those
//! of one batch. [`Column`] gives values whatever the width of the numbers. A file is in memory, or its
//! batches are read one by one, or it is mapped where cells hold images and sweeps. Format:
//! <https://arrow.apache.org/docs/format/Columnar.html#ipc-file-format>.

mod check;
mod column;
mod layout;
mod lists;
mod metadata;

#[cfg(feature = "123d")]
pub(super) use check::check_batch;
pub(super) use column::Column;

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use arrow_array::{ArrayRef, RecordBatch};
use arrow_buffer::Buffer;
use arrow_ipc::reader::FileDecoder;
use arrow_schema::{DataType, Schema, SchemaRef};

use self::layout::Layout;
use crate::error::FileError;
use crate::files::input::{SWEEP_BYTES, open_regular, read_file};
use crate::gpu::MappedFile;

/// Arrow IPC file with a validated layout.
pub(in crate::dataset) struct ArrowFile {
    path: PathBuf,
    source: Source,
    layout: Layout,
}

/// Where batches come from.
enum Source {
    /// All bytes, in memory or mapped.
    Bytes(Buffer),
    /// Each batch is read when it is decoded.
    Batches(File),
}

impl ArrowFile {
    /// Reads a file of at most [`SWEEP_BYTES`] into memory.
    ///
    /// # Errors
    /// Fails if the file is missing, damaged or not an Arrow IPC file.
    pub(in crate::dataset) fn read(path: &Path) -> Result<Self, FileError> {
        Self::of(Buffer::from_vec(read_file(path, SWEEP_BYTES)?), path)
    }

    /// Opens a file of any size, of which one batch at a time is in memory.
    ///
    /// # Errors
    /// Fails as [`ArrowFile::read`].
    pub(in crate::dataset) fn open(path: &Path) -> Result<Self, FileError> {
        let (file, _) = open_regular(path)?;
        Ok(Self { source: Source::Batches(file), ..Self::map_sparse(path)? })
    }

    /// Maps a file of any size to decode small columns beside large ones.
    ///
    /// # Errors
    /// Fails as [`ArrowFile::read`].
    pub(in crate::dataset) fn map_sparse(path: &Path) -> Result<Self, FileError> {
        Self::of(mapped(MappedFile::open_sparse(path)?), path)
    }

    /// Maps the file again, to decode large columns.
    ///
    /// # Errors
    /// Fails if the file has changed.
    pub(in crate::dataset) fn map_again(self) -> Result<Self, FileError> {
        let bytes = mapped(MappedFile::open(&self.path)?);
        if let Source::Bytes(before) = &self.source
            && before.len() != bytes.len()
        {
            let [expected, found] = [before.len(), bytes.len()].map(|length| format!("{length} bytes"));
            return Err(FileError::content(expected, format!("{found} (changed since)"), &self.path));
        }
        Ok(Self { source: Source::Bytes(bytes), ..self })
    }

    fn of(bytes: Buffer, path: &Path) -> Result<Self, FileError> {
        let layout = Layout::of(&bytes).map_err(|found| no_arrow(found, path))?;
        Ok(Self { path: path.to_owned(), source: Source::Bytes(bytes), layout })
    }

    /// The file.
    pub(in crate::dataset) fn path(&self) -> &Path {
        &self.path
    }

    /// Number of rows.
    pub(in crate::dataset) fn rows(&self) -> u64 {
        self.layout.rows
    }

    /// Number of batches.
    pub(in crate::dataset) fn batches(&self) -> usize {
        self.layout.blocks.len()
    }

    /// Names of the columns.
    pub(in crate::dataset) fn columns(&self) -> impl Iterator<Item = &str> {
        self.layout.schema.fields().iter().map(|field| field.name().as_str())
    }

    /// Type of a column; `None` if there is none of this name.
    pub(in crate::dataset) fn column_type(&self, name: &str) -> Option<&DataType> {
        self.layout.schema.field_with_name(name).ok().map(|field| field.data_type())
    }

    /// Entry of the schema's metadata, as stored.
    pub(in crate::dataset) fn metadata(&self, key: &str) -> Option<&[u8]> {
        self.layout.metadata.iter().find(|(name, _)| name == key).map(|(_, value)| value.as_slice())
    }

    /// Returns the batch that holds a row, and the row's number in it; `None` beyond the last row.
    pub(in crate::dataset) fn place(&self, row: u64) -> Option<(usize, usize)> {
        let mut first = 0;
        for (batch, (_, rows)) in self.layout.blocks.iter().enumerate() {
            if row < first + rows {
                return Some((batch, (row - first) as usize));
            }
            first += rows;
        }
        None
    }

    /// Decodes columns of all batches, and others that may be missing.
    ///
    /// # Errors
    /// Fails if a column is missing or damaged.
    pub(in crate::dataset) fn table(&self, columns: &[&str], optional: &[&str]) -> Result<Table, FileError> {
        let decoder = self.decoder(columns, optional)?;
        let batches = (0..self.batches()).map(|batch| self.decode(&decoder, batch));
        let batches = batches.collect::<Result<_, _>>()?;
        Ok(Table { path: self.path.clone(), schema: self.layout.schema.clone(), batches })
    }

    /// Decodes columns of one batch, and others that may be missing.
    ///
    /// # Errors
    /// Fails if a column is missing or damaged.
    pub(in crate::dataset) fn batch(
        &self,
        batch: usize,
        columns: &[&str],
        optional: &[&str],
    ) -> Result<Table, FileError> {
        let batches = vec![self.decode(&self.decoder(columns, optional)?, batch)?];
        Ok(Table { path: self.path.clone(), schema: self.layout.schema.clone(), batches })
    }

    /// Checks that columns exist.
    ///
    /// # Errors
    /// Fails with the first missing one.
    pub(in crate::dataset) fn require(&self, columns: &[&str]) -> Result<(), FileError> {
        self.decoder(columns, &[]).map(drop)
    }

    fn decoder(&self, columns: &[&str], optional: &[&str]) -> Result<FileDecoder, FileError> {
        let place = |name: &str| self.layout.schema.index_of(name).ok();
        let missing = |name: &str| missing_column(name, &self.layout.schema, &self.path);
        let mut places = Vec::with_capacity(columns.len() + optional.len());
        for name in columns {
            places.push(place(name).ok_or_else(|| missing(name))?);
        }
        places.extend(optional.iter().filter_map(|name| place(name)));
        Ok(FileDecoder::new(self.layout.schema.clone(), self.layout.version).with_projection(places))
    }

    fn decode(&self, decoder: &FileDecoder, batch: usize) -> Result<RecordBatch, FileError> {
        let (block, _) = &self.layout.blocks[batch];
        let (start, length) = layout::span(block);
        let bytes = match &self.source {
            Source::Bytes(bytes) => bytes.slice_with_length(start, length),
            Source::Batches(file) => {
                let mut bytes = vec![0; length];
                file.read_exact_at(&mut bytes, start as u64).map_err(FileError::io("read", &self.path))?;
                Buffer::from_vec(bytes)
            }
        };
        let read = decoder.read_record_batch(block, &bytes);
        let read = read.map_err(|error| no_arrow(error.to_string(), &self.path))?;
        read.ok_or_else(|| no_arrow("a batch without rows".to_owned(), &self.path))
    }
}

/// Decoded columns.
pub(in crate::dataset) struct Table {
    path: PathBuf,
    schema: SchemaRef,
    batches: Vec<RecordBatch>,
}

impl Table {
    /// Number of rows.
    pub(in crate::dataset) fn rows(&self) -> usize {
        self.batches.iter().map(RecordBatch::num_rows).sum()
    }

    /// Returns the parts of at most `rows` rows, which share the memory.
    pub(in crate::dataset) fn parts(&self, rows: usize) -> impl Iterator<Item = Self> {
        let part = move |batch: &RecordBatch, start: usize| {
            let batches = vec![batch.slice(start, rows.min(batch.num_rows() - start))];
            Self { path: self.path.clone(), schema: self.schema.clone(), batches }
        };
        let starts = move |batch: &RecordBatch| (0..batch.num_rows()).step_by(rows.max(1));
        self.batches.iter().flat_map(move |batch| starts(batch).map(move |start| part(batch, start)))
    }

    /// Returns whether a column was decoded.
    pub(in crate::dataset) fn has(&self, name: &str) -> bool {
        self.batches.iter().all(|batch| batch.column_by_name(name).is_some())
    }

    /// The file.
    pub(in crate::dataset) fn path(&self) -> &Path {
        &self.path
    }

    /// Returns a column that was decoded.
    ///
    /// # Errors
    /// Fails if it was not.
    pub(in crate::dataset) fn column(&self, name: &str) -> Result<Column<'_>, FileError> {
        let parts: Option<Vec<&ArrayRef>> = self.batches.iter().map(|b| b.column_by_name(name)).collect();
        let parts = parts.ok_or_else(|| missing_column(name, &self.schema, &self.path))?;
        Ok(Column::new(name.to_owned(), parts, &self.path))
    }
}

fn mapped(file: MappedFile) -> Buffer {
    Buffer::from(bytes::Bytes::from_owner(file))
}

fn no_arrow(found: String, path: &Path) -> FileError {
    FileError::content("an Arrow file (Feather)", found, path)
}

fn missing_column(name: &str, schema: &Schema, path: &Path) -> FileError {
    let names: Vec<&str> = schema.fields().iter().map(|f| f.name().as_str()).collect();
    FileError::content(format!("a column {name}"), format!("columns {}", names.join(", ")), path)
}
