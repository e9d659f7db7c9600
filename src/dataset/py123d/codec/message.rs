//! Validation of a batch of rows against the bytes of its message.

use arrow_ipc::{CompressionType, RecordBatch};

/// Validates the declared sizes of a batch against its body. Returns its number of rows and of decompressed
/// bytes of all columns.
///
/// # Errors
/// Returns a description of the size that is wrong.
pub(super) fn check_batch(batch: &RecordBatch<'_>, body: &[u8]) -> Result<(u64, u64), String> {
    let rows = u64::try_from(batch.length()).map_err(|_| format!("a batch of {} rows", batch.length()))?;
    let is_compressed = batch.compression().is_some();
    let sizes = batch.buffers().into_iter().flatten().map(|buffer| check_buffer(buffer, body, is_compressed));
    let sizes = sizes.collect::<Result<Vec<u64>, _>>()?;
    // A row takes at least one bit.
    let bits = sizes.iter().map(|size| size.saturating_mul(8)).max().unwrap_or(0);
    if rows > bits {
        return Err(format!("a batch of {rows} rows in columns of at most {} bytes", bits / 8));
    }
    for node in batch.nodes().into_iter().flatten() {
        let (length, empty) = (node.length(), node.null_count());
        if u64::try_from(length).is_ok_and(|n| n <= bits) && (0..=length).contains(&empty) {
            continue;
        }
        return Err(format!("a column of {length} rows ({empty} empty) in a batch of {rows}"));
    }
    Ok((rows, sizes.iter().fold(0, |sum, size| sum.saturating_add(*size))))
}

/// Validates the compression method of a batch.
///
/// # Errors
/// Returns a description of an unknown method.
pub(super) fn check_compression(batch: &RecordBatch<'_>) -> Result<(), String> {
    match batch.compression().map(|compression| compression.codec()) {
        None | Some(CompressionType::LZ4_FRAME | CompressionType::ZSTD) => Ok(()),
        Some(other) => Err(format!("compression {}", other.0)),
    }
}

/// Validates a buffer against the body. Returns its decompressed size.
fn check_buffer(buffer: &arrow_ipc::Buffer, body: &[u8], is_compressed: bool) -> Result<u64, String> {
    let start = usize::try_from(buffer.offset()).ok();
    let end = start.zip(usize::try_from(buffer.length()).ok()).and_then(|(s, n)| s.checked_add(n));
    let content = start.zip(end).and_then(|(start, end)| body.get(start..end)).ok_or_else(|| {
        format!("a column of {} bytes at {} of {}", buffer.length(), buffer.offset(), body.len())
    })?;
    if content.is_empty() || !is_compressed {
        return Ok(content.len() as u64);
    }
    // Compressed data starts with the decompressed size; -1 means that the bytes are not compressed.
    match content.first_chunk().map(|bytes| i64::from_le_bytes(*bytes)) {
        Some(-1) => Ok(content.len() as u64 - 8),
        Some(declared @ 0..) => Ok(declared as u64),
        Some(declared) => Err(format!("a column that declares {declared} bytes")),
        None => Err(format!("a compressed column of {} bytes", content.len())),
    }
}
