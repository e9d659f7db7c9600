//! Feather files (version 2, the Arrow IPC file format): tables with named columns.
//!
//! # How it works
//! The footer at the end of a file lists the columns and the offsets of the row batches. The `arrow-ipc`
//! crate decodes batches, but trusts their declared offsets and sizes: a wrong offset would panic, and a
//! wrong size would exhaust memory. So the whole file is loaded, and every offset and size is validated
//! against it before a batch is decoded. Format:
//! <https://arrow.apache.org/docs/format/Columnar.html#ipc-file-format>.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::{ArrayRef, RecordBatch};
use arrow_buffer::Buffer;
use arrow_ipc::convert::try_fb_to_schema;
use arrow_ipc::reader::{FileDecoder, read_footer_length};
use arrow_ipc::{Block, root_as_footer, root_as_message};
use arrow_schema::{DataType, Schema, SchemaRef};

use super::column::Column;
use crate::error::FileError;
use crate::files::input::{SWEEP_BYTES, read_file};
use crate::files::sniff;

const MAGIC: &[u8] = b"ARROW1";

/// Bytes of the footer length and the magic at the end of a file.
const TAIL_BYTES: usize = 10;

/// Bytes before a message: a marker and the message length.
const PREFIX_BYTES: usize = 8;

/// Maximum declared bytes of all columns per byte of the file: LZ4 and zstd shrink numbers by a small factor
/// only.
const MAX_EXPANSION: u64 = 64;
/// Lower bound of this limit, for small files, bytes.
const MIN_LIMIT_BYTES: u64 = 16 << 20;

/// Selected columns of a file.
pub(super) struct Table {
    path: PathBuf,
    schema: SchemaRef,
    batches: Vec<RecordBatch>,
}

impl Table {
    /// Reads the given columns of a file and ignores the others.
    ///
    /// # Errors
    /// Fails if the file is missing, damaged or not a Feather file, or if a column is missing.
    pub(super) fn read(path: &Path, columns: &[&str]) -> Result<Self, FileError> {
        Self::read_with(path, columns, &[])
    }

    /// Reads the given columns of a file, and others that may be missing.
    ///
    /// # Errors
    /// Fails as [`Table::read`].
    pub(super) fn read_with(path: &Path, columns: &[&str], optional: &[&str]) -> Result<Self, FileError> {
        let bytes = Buffer::from_vec(read_file(path, SWEEP_BYTES)?);
        let layout = Layout::of(&bytes).map_err(|found| no_feather(found, path))?;
        let mut places = layout.places(columns, path)?;
        places.extend(optional.iter().filter_map(|name| layout.places(&[name], path).ok()).flatten());
        let decoder = FileDecoder::new(layout.schema.clone(), layout.version).with_projection(places);
        let mut batches = Vec::new();
        for (block, _) in &layout.blocks {
            let (start, length) = span(block);
            let batch = decoder.read_record_batch(block, &bytes.slice_with_length(start, length));
            batches.extend(batch.map_err(|e| no_feather(e.to_string(), path))?);
        }
        Ok(Self { path: path.to_owned(), schema: layout.schema, batches })
    }

    /// Number of rows.
    pub(super) fn rows(&self) -> usize {
        self.batches.iter().map(RecordBatch::num_rows).sum()
    }

    /// Returns whether a column was read.
    pub(super) fn has(&self, name: &str) -> bool {
        self.batches.iter().all(|batch| batch.column_by_name(name).is_some())
    }

    /// The file.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Returns a column that was read.
    ///
    /// # Errors
    /// Fails if the column was not read.
    pub(super) fn column(&self, name: &str) -> Result<Column<'_>, FileError> {
        let parts: Option<Vec<&ArrayRef>> = self.batches.iter().map(|b| b.column_by_name(name)).collect();
        let parts = parts.ok_or_else(|| missing_column(name, &self.schema, &self.path))?;
        Ok(Column::new(name.to_owned(), parts, &self.path))
    }
}

/// Returns the number of rows that a file declares, after checking that it has the given columns. Decodes no
/// column.
///
/// # Errors
/// Fails as [`Table::read`], except for damage within columns.
pub(super) fn declared_rows(path: &Path, columns: &[&str]) -> Result<u64, FileError> {
    let bytes = read_file(path, SWEEP_BYTES)?;
    let layout = Layout::of(&bytes).map_err(|found| no_feather(found, path))?;
    layout.places(columns, path)?;
    let sum = layout.blocks.iter().try_fold(0_u64, |sum, (_, rows)| sum.checked_add(*rows));
    sum.ok_or_else(|| no_feather("more rows than can be counted".to_owned(), path))
}

fn no_feather(found: String, path: &Path) -> FileError {
    FileError::content("a Feather (Arrow IPC) file", found, path)
}

fn missing_column(name: &str, schema: &Schema, path: &Path) -> FileError {
    let names: Vec<&str> = schema.fields().iter().map(|f| f.name().as_str()).collect();
    FileError::content(format!("a column {name}"), format!("columns {}", names.join(", ")), path)
}

/// Content of the footer, validated against the file.
struct Layout {
    schema: SchemaRef,
    version: arrow_ipc::MetadataVersion,
    /// Batches with their number of rows.
    blocks: Vec<(Block, u64)>,
}

impl Layout {
    /// Parses and validates the footer.
    ///
    /// # Errors
    /// Returns a description of the invalid content.
    fn of(bytes: &[u8]) -> Result<Self, String> {
        let cut = || match sniff::marked(bytes) {
            Some(found) if !bytes.starts_with(MAGIC) => found.to_owned(),
            _ => format!("{} bytes (cut off, or another format)", bytes.len()),
        };
        let (body, tail) = bytes.split_last_chunk::<TAIL_BYTES>().ok_or_else(cut)?;
        if !bytes.starts_with(MAGIC) || !tail.ends_with(MAGIC) {
            return Err(cut());
        }
        let length = read_footer_length(*tail).map_err(|e| e.to_string())?;
        let start = body.len().checked_sub(length);
        let start = start.ok_or_else(|| format!("a footer of {length} bytes in {} bytes", bytes.len()))?;
        // The flatbuffer verifier requires aligned bytes.
        let footer = Buffer::from_slice_ref(&body[start..]);
        let footer = root_as_footer(&footer).map_err(|e| format!("a damaged footer ({e})"))?;
        let schema = footer.schema().ok_or("no columns")?;
        if !schema.endianness().equals_to_target_endianness() {
            return Err("numbers of the other byte order".to_owned());
        }
        let schema = Arc::new(try_fb_to_schema(schema).map_err(|e| e.to_string())?);
        if footer.dictionaries().is_some_and(|d| !d.is_empty()) {
            return Err("columns encoded by dictionaries (write them plain)".to_owned());
        }
        let blocks = footer.recordBatches().into_iter().flatten();
        let most = MIN_LIMIT_BYTES.max(MAX_EXPANSION.saturating_mul(bytes.len() as u64));
        let mut left = most;
        let mut check = |block: &Block| {
            let (rows, size) = check_block(block, &schema, &body[..start])?;
            let rest = left.checked_sub(size);
            left = rest.ok_or_else(|| {
                format!("columns that declare more than {most} bytes in a file of {}", bytes.len())
            })?;
            Ok((*block, rows))
        };
        let blocks = blocks.map(&mut check).collect::<Result<_, String>>()?;
        Ok(Self { schema, version: footer.version(), blocks })
    }

    /// Returns the indices of columns in the schema.
    fn places(&self, columns: &[&str], path: &Path) -> Result<Vec<usize>, FileError> {
        let place = |name: &&str| {
            let found = self.schema.fields().iter().position(|f| f.name() == name);
            found.ok_or_else(|| missing_column(name, &self.schema, path))
        };
        columns.iter().map(place).collect()
    }
}

/// Returns the byte offset and length of a validated block.
fn span(block: &Block) -> (usize, usize) {
    (block.offset() as usize, block.metaDataLength() as usize + block.bodyLength() as usize)
}

/// Validates the declared sizes of a batch against its bytes. Returns its number of rows and of decompressed
/// bytes.
fn check_block(block: &Block, schema: &Schema, bytes: &[u8]) -> Result<(u64, u64), String> {
    let outside = || {
        let (offset, header, body) = (block.offset(), block.metaDataLength(), block.bodyLength());
        format!("a batch of {header} + {body} bytes at {offset} of {}", bytes.len())
    };
    let number = |value: i64| usize::try_from(value).map_err(|_| outside());
    let (offset, body_len) = (number(block.offset())?, number(block.bodyLength())?);
    let header_len = number(block.metaDataLength().into())?;
    let end = offset.checked_add(header_len).and_then(|at| at.checked_add(body_len));
    if header_len < PREFIX_BYTES || end.is_none_or(|end| end > bytes.len()) {
        return Err(outside());
    }
    let (header, body) = bytes[offset..offset + header_len + body_len].split_at(header_len);
    let skip = if header.starts_with(&[0xff; 4]) { PREFIX_BYTES } else { PREFIX_BYTES / 2 };
    let header = Buffer::from_slice_ref(&header[skip..]);
    let message = root_as_message(&header).map_err(|e| format!("a damaged batch ({e})"))?;
    let batch = message.header_as_record_batch().ok_or("a message that is no batch of rows")?;
    let rows = u64::try_from(batch.length()).map_err(|_| format!("a batch of {} rows", batch.length()))?;
    for node in batch.nodes().into_iter().flatten() {
        if u64::try_from(node.length()) != Ok(rows) || !(0..=node.length()).contains(&node.null_count()) {
            let (found, empty) = (node.length(), node.null_count());
            return Err(format!("a column of {found} rows ({empty} empty) in a batch of {rows}"));
        }
    }
    let mut sizes = Vec::new();
    for buffer in batch.buffers().into_iter().flatten() {
        sizes.push(check_buffer(buffer, body, batch.compression().is_some())?);
    }
    check_rows(rows, schema, &sizes)?;
    Ok((rows, sizes.iter().fold(0, |sum, size| sum.saturating_add(*size))))
}

/// Validates the number of rows against the decompressed sizes of the column buffers.
fn check_rows(rows: u64, schema: &Schema, sizes: &[u64]) -> Result<(), String> {
    // A row takes at least one bit.
    let bits = sizes.iter().map(|size| size.saturating_mul(8)).max().unwrap_or(0);
    if rows > bits {
        return Err(format!("a batch of {rows} rows in columns of at most {} bytes", bits / 8));
    }
    let mut sizes = sizes.iter();
    // The buffer count of other types is not known here, so numbers after such a column are not checked.
    let mut unknown = None;
    for field in schema.fields() {
        let (name, kind) = (field.name(), field.data_type());
        // Bytes of an offset to the text of a row.
        let offset = match kind {
            DataType::Utf8 | DataType::Binary => Some(4),
            DataType::LargeUtf8 | DataType::LargeBinary => Some(8),
            _ => None,
        };
        // Minimum bytes of the buffer after the validity bitmap.
        let least = match (kind, kind.primitive_width(), offset) {
            (_, Some(width), _) => rows.saturating_mul(width as u64),
            (DataType::Boolean, ..) => rows.div_ceil(8),
            (_, _, Some(bytes)) => rows.saturating_mul(bytes),
            _ => {
                unknown.get_or_insert((name, kind));
                continue;
            }
        };
        if let Some((other, kind)) = unknown {
            match offset {
                Some(_) => return Err(format!("a text column {name} behind column {other} of type {kind}")),
                None => continue,
            }
        }
        let size = sizes.nth(1).copied().unwrap_or(0);
        if size < least || offset.is_some_and(|bytes| !size.is_multiple_of(bytes)) {
            return Err(format!("column {name} of {size} bytes in a batch of {rows} rows"));
        }
        sizes.by_ref().take(usize::from(offset.is_some())).for_each(drop);
    }
    Ok(())
}

/// Validates a buffer against the available bytes. Returns its decompressed size.
fn check_buffer(buffer: &arrow_ipc::Buffer, body: &[u8], compressed: bool) -> Result<u64, String> {
    let start = usize::try_from(buffer.offset()).ok();
    let end = start.zip(usize::try_from(buffer.length()).ok()).and_then(|(s, n)| s.checked_add(n));
    let content = start.zip(end).and_then(|(start, end)| body.get(start..end)).ok_or_else(|| {
        format!("a column of {} bytes at {} of {}", buffer.length(), buffer.offset(), body.len())
    })?;
    if content.is_empty() || !compressed {
        return Ok(content.len() as u64);
    }
    // Compressed data starts with the decompressed size; -1 means that the bytes are not compressed.
    let declared = content.first_chunk().map(|bytes| i64::from_le_bytes(*bytes));
    match declared {
        Some(-1) => Ok(content.len() as u64 - 8),
        Some(declared @ 0..) => Ok(declared as u64),
        Some(declared) => Err(format!("a column that declares {declared} bytes")),
        None => Err(format!("a compressed column of {} bytes", content.len())),
    }
}
