//! Arrow IPC streams: a schema, then batches of rows, each a message with a header and a body.
//!
//! # How it works
//! The `arrow-ipc` crate decodes batches, but trusts their declared offsets and sizes. So the stream is cut
//! into messages here, and every offset and size of a header is validated against the message's body before
//! the batch is decoded. Format:
//! <https://arrow.apache.org/docs/format/Columnar.html#ipc-streaming-format>.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::{Array, RecordBatch};
use arrow_buffer::Buffer;
use arrow_ipc::convert::try_fb_to_schema;
use arrow_ipc::reader::RecordBatchDecoder;
use arrow_ipc::{MessageHeader, MetadataVersion, root_as_message};
use arrow_schema::{DataType, Schema, SchemaRef};

use super::feature::{Column, Kind};
use super::{FEATURES, Points, is_read, most_decoded};
use crate::dataset::tables::check_batch;

/// First bytes of a message, and thus of a stream.
pub(super) const MARKER: &[u8] = &[0xff; 4];

/// Bytes before the header of a message: the marker and the header's length.
const PREFIX_BYTES: usize = 8;

const AXES: [&str; 3] = ["x", "y", "z"];

/// Decodes the points of a stream.
///
/// # Errors
/// Returns a description of the invalid content.
pub(super) fn decode(bytes: &[u8]) -> Result<Points, String> {
    let stream = Stream::of(bytes)?;
    let columns = stream.columns()?;
    let mut points = Points::default();
    for batch in &stream.batches {
        let rows = batch.decode(&stream, &columns)?;
        append(&mut points, &rows)?;
    }
    let names = stream.schema.fields().iter().map(|field| field.name());
    points.skipped = names.filter(|name| !AXES.contains(&name.as_str()) && !is_read(name)).cloned().collect();
    Ok(points)
}

/// Returns the number of points that a stream declares, after validating its headers.
///
/// # Errors
/// Fails as [`decode`], except for damage within columns.
pub(super) fn declared_points(bytes: &[u8]) -> Result<u64, String> {
    let stream = Stream::of(bytes)?;
    stream.columns()?;
    let sum = stream.batches.iter().try_fold(0_u64, |sum, batch| sum.checked_add(batch.rows));
    sum.ok_or_else(|| "more points than can be counted".to_owned())
}

/// Messages of a stream, validated against its bytes.
struct Stream<'a> {
    schema: SchemaRef,
    batches: Vec<Batch<'a>>,
}

/// Batch of rows.
struct Batch<'a> {
    /// The flatbuffer verifier requires aligned bytes.
    header: Buffer,
    body: &'a [u8],
    rows: u64,
}

impl<'a> Stream<'a> {
    fn of(bytes: &'a [u8]) -> Result<Self, String> {
        let (first, mut rest) = cut(bytes)?.ok_or("an empty stream")?;
        let schema = schema(&first)?;
        let mut batches = Vec::new();
        let most = most_decoded(bytes);
        let mut left = most;
        while let Some((message, behind)) = cut(rest)? {
            rest = behind;
            let Some((batch, size)) = message.batch(&schema)? else { continue };
            left = left.checked_sub(size).ok_or_else(|| {
                format!("columns that declare more than {most} bytes in {} bytes", bytes.len())
            })?;
            batches.push(batch);
        }
        if batches.is_empty() {
            return Err("a stream without rows".to_owned());
        }
        Ok(Self { schema, batches })
    }

    /// Returns the indices of the columns that are read: the axes, then features.
    fn columns(&self) -> Result<Vec<usize>, String> {
        let mut columns = Vec::new();
        for name in AXES.iter().chain(&FEATURES) {
            let fields = self.schema.fields().iter().enumerate();
            let places: Vec<usize> =
                fields.filter(|(_, field)| field.name() == name).map(|(at, _)| at).collect();
            match places[..] {
                [] if AXES.contains(name) => return Err(format!("no column {name}")),
                [] => {}
                [place] => columns.push(place),
                _ => return Err(format!("two columns {name}")),
            }
        }
        Ok(columns)
    }
}

/// Message of a stream.
struct Message<'a> {
    header: Buffer,
    body: &'a [u8],
}

impl<'a> Message<'a> {
    /// Returns a batch and its decompressed bytes; `None` for dictionaries, which no column that is read has.
    fn batch(self, schema: &Schema) -> Result<Option<(Batch<'a>, u64)>, String> {
        let message = root_as_message(&self.header).map_err(|e| format!("a damaged message ({e})"))?;
        if message.header_type() == MessageHeader::DictionaryBatch {
            return Ok(None);
        }
        let batch = message.header_as_record_batch().ok_or("a message that is no batch of rows")?;
        let (rows, size) = check_batch(&batch, schema, self.body)?;
        Ok(Some((Batch { header: self.header.clone(), body: self.body, rows }, size)))
    }
}

/// Returns the first message of a stream and the bytes after it; `None` at the end of the stream.
///
/// # Errors
/// Returns a description of a message that exceeds the bytes.
fn cut(bytes: &[u8]) -> Result<Option<(Message<'_>, &[u8])>, String> {
    if bytes.is_empty() {
        return Ok(None);
    }
    let short = || format!("a message that is cut off after {} bytes", bytes.len());
    let (prefix, rest) = bytes.split_first_chunk::<PREFIX_BYTES>().ok_or_else(short)?;
    let length = prefix.strip_prefix(MARKER).and_then(|length| length.first_chunk());
    let length = i32::from_le_bytes(*length.ok_or("a message without its marker")?);
    if length == 0 {
        return Ok(None);
    }
    let length = usize::try_from(length).map_err(|_| format!("a message of {length} bytes"))?;
    let (header, rest) = rest.split_at_checked(length).ok_or_else(short)?;
    let header = Buffer::from_slice_ref(header);
    let message = root_as_message(&header).map_err(|e| format!("a damaged message ({e})"))?;
    let length = message.bodyLength();
    let length = usize::try_from(length).map_err(|_| format!("a message of {length} bytes"))?;
    let (body, rest) = rest.split_at_checked(length).ok_or_else(short)?;
    Ok(Some((Message { header, body }, rest)))
}

/// Returns the schema of a stream's first message.
fn schema(message: &Message<'_>) -> Result<SchemaRef, String> {
    let message = root_as_message(&message.header).map_err(|e| format!("a damaged schema ({e})"))?;
    let schema = message.header_as_schema().ok_or("a stream that does not begin with a schema")?;
    if !schema.endianness().equals_to_target_endianness() {
        return Err("numbers of the other byte order".to_owned());
    }
    Ok(Arc::new(try_fb_to_schema(schema).map_err(|e| e.to_string())?))
}

impl Batch<'_> {
    /// Decodes columns in the given order.
    fn decode(&self, stream: &Stream<'_>, columns: &[usize]) -> Result<RecordBatch, String> {
        let message = root_as_message(&self.header).map_err(|e| e.to_string())?;
        let batch = message.header_as_record_batch().ok_or("a message that is no batch of rows")?;
        let body = Buffer::from_slice_ref(self.body);
        let (version, dictionaries): (MetadataVersion, _) = (message.version(), HashMap::new());
        let schema = stream.schema.clone();
        let decoder = RecordBatchDecoder::try_new(&body, batch, schema, &dictionaries, &version);
        let rows = decoder.and_then(|decoder| decoder.with_projection(Some(columns)).read_record_batch());
        rows.map_err(|e| e.to_string())
    }
}

/// Appends the rows of a batch: three axes, then features.
fn append(points: &mut Points, batch: &RecordBatch) -> Result<(), String> {
    let column = |at: usize| {
        let field = batch.schema_ref().field(at);
        let bytes = plain_bytes(batch.column(at).as_ref());
        bytes.map_err(|found| format!("a column {} {found}", field.name()))
    };
    let axes = [column(0)?, column(1)?, column(2)?];
    // Usually f32; py123d keeps the f16 of Argoverse 2.
    let is_float = |kind: &Kind| matches!(kind, Kind::F16 | Kind::F32 | Kind::F64);
    if let Some((name, (kind, _))) = AXES.iter().zip(&axes).find(|(_, (kind, _))| !is_float(kind)) {
        return Err(format!("a column {name} of type {kind:?}"));
    }
    let [x, y, z] = axes.each_ref().map(|(kind, bytes)| Column::new(*kind, bytes).numbers());
    points.xyz.extend(x.zip(y).zip(z).map(|((x, y), z)| [x, y, z].map(|value| value as f32)));
    for at in AXES.len()..batch.num_columns() {
        let (kind, bytes) = column(at)?;
        points.extend_feature(batch.schema_ref().field(at).name(), &Column::new(kind, &bytes))?;
    }
    Ok(())
}

/// Returns the type and the bytes of an array without nulls.
///
/// # Errors
/// Returns a description of other arrays.
fn plain_bytes(array: &dyn Array) -> Result<(Kind, Buffer), String> {
    let other = || format!("of type {}", array.data_type());
    let kind = kind(array.data_type()).ok_or_else(other)?;
    if array.null_count() > 0 {
        return Err(format!("with {} empty values", array.null_count()));
    }
    let data = array.to_data();
    let buffer = data.buffers().first().ok_or_else(other)?;
    Ok((kind, buffer.slice_with_length(data.offset() * kind.bytes(), data.len() * kind.bytes())))
}

fn kind(data_type: &DataType) -> Option<Kind> {
    Some(match data_type {
        DataType::UInt8 => Kind::U8,
        DataType::Int8 => Kind::I8,
        DataType::UInt16 => Kind::U16,
        DataType::Int16 => Kind::I16,
        DataType::UInt32 => Kind::U32,
        DataType::Int32 => Kind::I32,
        DataType::UInt64 => Kind::U64,
        DataType::Int64 => Kind::I64,
        DataType::Float16 => Kind::F16,
        DataType::Float32 => Kind::F32,
        DataType::Float64 => Kind::F64,
        _ => return None,
    })
}

#[cfg(test)]
mod tests;
