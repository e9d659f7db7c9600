//! Validation of the sizes that a batch of rows declares.

use arrow_buffer::Buffer;
use arrow_ipc::{Block, CompressionType, RecordBatch, root_as_message};
use arrow_schema::{DataType, Field, Schema};

/// Bytes before a message: a marker and the message length.
const PREFIX_BYTES: usize = 8;

/// Maximum declared bytes of all columns per byte of a file or batch: LZ4 and zstd shrink numbers by a small
/// factor only.
const MAX_EXPANSION: u64 = 64;
/// Lower bound of this limit, for small files, bytes.
const MIN_LIMIT_BYTES: u64 = 16 << 20;

/// Limits the declared bytes of columns by the bytes that they are stored in.
///
/// # Errors
/// Returns a description of the invalid content.
pub(super) fn check_expansion(declared: u64, stored: usize) -> Result<(), String> {
    let most = MIN_LIMIT_BYTES.max(MAX_EXPANSION.saturating_mul(stored as u64));
    if declared > most {
        return Err(format!("columns that declare more than {most} bytes in {stored} bytes"));
    }
    Ok(())
}

/// Validates the declared sizes of a batch against its bytes. Returns its number of rows and of decompressed
/// bytes.
///
/// # Errors
/// Returns a description of the invalid content.
pub(super) fn check_block(block: &Block, schema: &Schema, bytes: &[u8]) -> Result<(u64, u64), String> {
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
    check_batch(&batch, schema, body)
}

/// Validates a batch against the bytes of its columns, as [`check_block`].
///
/// # Errors
/// Returns a description of the invalid content.
pub(in crate::dataset) fn check_batch(
    batch: &RecordBatch<'_>,
    schema: &Schema,
    body: &[u8],
) -> Result<(u64, u64), String> {
    let rows = u64::try_from(batch.length()).map_err(|_| format!("a batch of {} rows", batch.length()))?;
    let is_compressed = match batch.compression().map(|compression| compression.codec()) {
        None => false,
        Some(CompressionType::LZ4_FRAME | CompressionType::ZSTD) => true,
        Some(other) => return Err(format!("compression {}", other.0)),
    };
    let mut sizes = Vec::new();
    for buffer in batch.buffers().into_iter().flatten() {
        sizes.push(check_buffer(buffer, body, is_compressed)?);
    }
    let nodes = batch.nodes().into_iter().flatten();
    let nodes: Vec<[i64; 2]> = nodes.map(|node| [node.length(), node.null_count()]).collect();
    let variadic: Vec<i64> = batch.variadicBufferCounts().into_iter().flatten().collect();
    let mut columns = Columns { rows, nodes: &nodes, sizes: &sizes, variadic: &variadic };
    for field in schema.fields() {
        columns.check(field, Some(rows))?;
    }
    if rows > 0 && schema.fields().is_empty() {
        return Err(format!("a batch of {rows} rows without columns"));
    }
    let bytes = sizes.iter().fold(0, |sum: u64, size| sum.saturating_add(*size));
    check_expansion(bytes, body.len())?;
    Ok((rows, bytes))
}

/// What a batch declares and was not checked yet, in the order of the schema.
struct Columns<'a> {
    rows: u64,
    /// Number of items, and of empty ones.
    nodes: &'a [[i64; 2]],
    /// Decompressed bytes of buffers.
    sizes: &'a [u64],
    /// Number of view buffers.
    variadic: &'a [i64],
}

impl Columns<'_> {
    /// Validates a column and those below it. `expected` is its number of items; `None` in lists, where the
    /// decoder validates the offsets.
    fn check(&mut self, field: &Field, expected: Option<u64>) -> Result<(), String> {
        let (name, kind) = (field.name(), field.data_type());
        let found = *take(&mut self.nodes).ok_or_else(|| format!("no column {name}"))?;
        let [items, empty] = found;
        let is_expected = u64::try_from(items).is_ok_and(|items| expected.is_none_or(|n| n == items));
        if !is_expected || !(0..=items).contains(&empty) {
            let rows = self.rows;
            return Err(format!("column {name} of {items} rows ({empty} empty) in a batch of {rows}"));
        }
        let items = items.cast_unsigned();
        if *kind == DataType::Null {
            return Ok(());
        }
        let validity = self.size(name)?;
        // Writers omit the bitmap of columns without empty items.
        if empty > 0 && validity < items.div_ceil(8) {
            return Err(format!("column {name} with a bitmap of {validity} bytes for {items} rows"));
        }
        match (kind, kind.primitive_width()) {
            (_, Some(width)) => self.least(name, items, items.saturating_mul(width as u64)),
            (DataType::Boolean, _) => self.least(name, items, items.div_ceil(8)),
            (DataType::Dictionary(key, _), _) => {
                self.least(name, items, items.saturating_mul(key.primitive_width().unwrap_or(1) as u64))
            }
            (DataType::FixedSizeBinary(width), _) => {
                self.least(name, items, items.saturating_mul((*width).max(0).cast_unsigned().into()))
            }
            (DataType::Utf8 | DataType::Binary, _) => self.offsets(name, items, 4).and(self.any(name)),
            (DataType::LargeUtf8 | DataType::LargeBinary, _) => {
                self.offsets(name, items, 8).and(self.any(name))
            }
            (DataType::Utf8View | DataType::BinaryView, _) => self.views(name, items),
            (DataType::List(item) | DataType::Map(item, _), _) => {
                self.offsets(name, items, 4)?;
                self.check(item, None)
            }
            (DataType::LargeList(item), _) => {
                self.offsets(name, items, 8)?;
                self.check(item, None)
            }
            (DataType::FixedSizeList(item, width), _) => {
                self.check(item, Some(items.saturating_mul((*width).max(0).cast_unsigned().into())))
            }
            (DataType::Struct(fields), _) => {
                fields.iter().try_for_each(|field| self.check(field, Some(items)))
            }
            _ => Err(format!("column {name} of type {kind}, which is not supported")),
        }
    }

    /// Takes the size of the next buffer.
    fn size(&mut self, name: &str) -> Result<u64, String> {
        take(&mut self.sizes).copied().ok_or_else(|| format!("no values of column {name}"))
    }

    fn any(&mut self, name: &str) -> Result<(), String> {
        self.size(name).map(drop)
    }

    /// Validates the size of a value buffer.
    fn least(&mut self, name: &str, items: u64, least: u64) -> Result<(), String> {
        match self.size(name)? {
            size if size < least => Err(format!("column {name} of {size} bytes in a batch of {items} rows")),
            _ => Ok(()),
        }
    }

    /// Validates the size of an offset buffer; a column without rows may have none.
    fn offsets(&mut self, name: &str, items: u64, width: u64) -> Result<(), String> {
        let size = self.size(name)?;
        let least = if items == 0 { 0 } else { items.saturating_add(1).saturating_mul(width) };
        if size < least || !size.is_multiple_of(width) {
            return Err(format!("column {name} of {size} bytes in a batch of {items} rows"));
        }
        Ok(())
    }

    fn views(&mut self, name: &str, items: u64) -> Result<(), String> {
        self.least(name, items, items.saturating_mul(16))?;
        let buffers = take(&mut self.variadic).ok_or_else(|| format!("no values of column {name}"))?;
        (0..*buffers).try_for_each(|_| self.any(name))
    }
}

fn take<'a, T>(items: &mut &'a [T]) -> Option<&'a T> {
    items.split_off_first()
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
