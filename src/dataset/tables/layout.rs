//! Footer of an Arrow IPC file.
//!
//! The `arrow-ipc` crate decodes batches, but trusts their declared offsets and sizes: a wrong offset would
//! panic, and a wrong size would exhaust memory. So every offset and size is validated against the file
//! before a batch is decoded.

use std::sync::Arc;

use arrow_buffer::Buffer;
use arrow_ipc::convert::try_fb_to_schema;
use arrow_ipc::reader::read_footer_length;
use arrow_ipc::{Block, MetadataVersion, root_as_footer};
use arrow_schema::SchemaRef;

use super::check::{check_block, check_expansion};
use super::metadata;
use crate::files::sniff;

const MAGIC: &[u8] = b"ARROW1";

/// Bytes of the footer length and the magic at the end of a file.
const TAIL_BYTES: usize = 10;

/// Content of the footer, validated against the file.
pub(super) struct Layout {
    pub(super) schema: SchemaRef,
    pub(super) version: MetadataVersion,
    /// Batches with their number of rows.
    pub(super) blocks: Vec<(Block, u64)>,
    /// Number of rows in all batches.
    pub(super) rows: u64,
    /// Metadata of the schema, as stored.
    pub(super) metadata: Vec<(String, Vec<u8>)>,
}

impl Layout {
    /// Parses and validates the footer.
    ///
    /// # Errors
    /// Returns a description of the invalid content.
    pub(super) fn of(bytes: &[u8]) -> Result<Self, String> {
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
        let mut footer = body[start..].to_vec();
        let metadata = metadata::take(&mut footer)?;
        // The flatbuffer verifier requires aligned bytes.
        let footer = Buffer::from_slice_ref(&footer);
        let footer = root_as_footer(&footer).map_err(|e| format!("a damaged footer ({e})"))?;
        let schema = footer.schema().ok_or("no columns")?;
        if !schema.endianness().equals_to_target_endianness() {
            return Err("numbers of the other byte order".to_owned());
        }
        let schema = Arc::new(try_fb_to_schema(schema).map_err(|e| e.to_string())?);
        if footer.dictionaries().is_some_and(|d| !d.is_empty()) {
            return Err("columns encoded by dictionaries (write them plain)".to_owned());
        }
        let (mut blocks, mut all_rows, mut all_bytes) = (Vec::new(), 0_u64, 0_u64);
        for block in footer.recordBatches().into_iter().flatten() {
            let (rows, size) = check_block(block, &schema, &body[..start])?;
            all_rows = all_rows.checked_add(rows).ok_or("more rows than can be counted")?;
            all_bytes = all_bytes.saturating_add(size);
            blocks.push((*block, rows));
        }
        check_expansion(all_bytes, bytes.len())?;
        Ok(Self { schema, version: footer.version(), blocks, rows: all_rows, metadata })
    }
}

/// Returns the byte offset and length of a validated block.
pub(super) fn span(block: &Block) -> (usize, usize) {
    (block.offset() as usize, block.metaDataLength() as usize + block.bodyLength() as usize)
}
