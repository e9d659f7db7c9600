//! Compressed points: chunks, each with one plain record and the differences of the others.
//!
//! # How it works
//! Formats 0 to 3 code the fields of a record one after the other ("pointwise"), formats 6 to 8 each field in
//! a layer of its own. The `laz` crate decompresses both, but trusts what it reads: sizes of layers exhaust
//! memory, jumps between times recurse, and the first bytes of the arithmetic code can lead it out of its
//! tables. So layers are validated before they are decoded, times are not decoded, and such bytes are
//! refused. The table of chunks is not needed, because chunks follow each other.

use std::io::{Cursor, Error, ErrorKind, Read};

use laz::decoders::ArithmeticDecoder;
use laz::las::v2;
use laz::models::{ArithmeticModel, ArithmeticModelBuilder};
use laz::record::{
    FieldDecompressor, LayeredPointRecordDecompressor, RecordDecompressor, SequentialPointRecordDecompressor,
};
use laz::{DecompressionSelection, LazItem, LazItemType, LazVlr};

use super::header::Header;

/// Bytes of the chunk table's offset, before the first chunk.
const TABLE_OFFSET_BYTES: usize = 8;

/// Layers of the standard fields of formats 6 to 8, without color.
const STANDARD_LAYERS: usize = 9;

/// Compressed items of a record.
pub(super) struct Layout {
    items: Vec<LazItem>,
    /// Points of every chunk but the last.
    chunk_points: usize,
    is_layered: bool,
}

impl Layout {
    /// Parses the compression record and compares its items with the point format.
    ///
    /// # Errors
    /// Returns a description of items that do not fit.
    pub(super) fn of(header: &Header) -> Result<Self, String> {
        let record = LazVlr::from_buffer(&header.compression);
        let record = record.map_err(|e| format!("no description of the compression ({e})"))?;
        let is_layered = header.format >= 6;
        // The compressor: 2 is pointwise, 3 is layered, both in chunks.
        let compressor = header.compression[0];
        let found: Vec<(LazItemType, u16)> =
            record.items().iter().map(|i| (i.item_type(), i.size())).collect();
        let versions = if is_layered { 3..=4 } else { 2..=2 };
        let first = record.items().first().map(|item| item.version());
        let is_version = |item: &LazItem| versions.contains(&item.version()) && Some(item.version()) == first;
        if compressor != 2 + u8::from(is_layered)
            || found != items(header)
            || !record.items().iter().all(is_version)
        {
            let (format, items) = (header.format, record.items());
            return Err(format!("compression {compressor} of items {items:?} in points of format {format}"));
        }
        if record.uses_variable_size_chunks() {
            return Err("LAZ chunks of various sizes".to_owned());
        }
        Ok(Self { items: record.items().clone(), chunk_points: record.chunk_size() as usize, is_layered })
    }
}

/// Returns the items of a point format with their sizes.
fn items(header: &Header) -> Vec<(LazItemType, u16)> {
    let extra = (header.record_bytes - header.standard_bytes) as u16;
    let (mut items, bytes) = match header.format {
        0..=5 => (vec![(LazItemType::Point10, 20)], LazItemType::Byte(extra)),
        _ => (vec![(LazItemType::Point14, 30)], LazItemType::Byte14(extra)),
    };
    if matches!(header.format, 1 | 3) {
        items.push((LazItemType::GpsTime, 8));
    }
    match header.format {
        2 | 3 => items.push((LazItemType::RGB12, 6)),
        7 => items.push((LazItemType::RGB14, 6)),
        8 => items.push((LazItemType::RGBNIR14, 8)),
        _ => {}
    }
    items.extend((extra > 0).then_some((bytes, extra)));
    items
}

/// Decompresses all records of a file.
///
/// # Errors
/// Returns a description of the damage.
pub(super) fn decompress(bytes: &[u8], header: &Header, layout: &Layout) -> Result<Vec<u8>, String> {
    let mut records = vec![0; header.points * header.record_bytes];
    let mut rest =
        bytes.get(header.start..).and_then(|rest| rest.get(TABLE_OFFSET_BYTES..)).unwrap_or_default();
    for chunk in records.chunks_mut(layout.chunk_points.saturating_mul(header.record_bytes)) {
        let left = if layout.is_layered {
            layered(rest, header, layout, chunk)
        } else {
            pointwise(rest, header, layout, chunk)
        };
        rest = left.map_err(|found| format!("{found} in {} points", header.points))?;
    }
    Ok(records)
}

/// Decompresses a chunk, and returns the bytes behind it.
fn pointwise<'a>(
    rest: &'a [u8],
    header: &Header,
    layout: &Layout,
    records: &mut [u8],
) -> Result<&'a [u8], String> {
    check_code(rest.get(header.record_bytes..).unwrap_or_default())?;
    let mut decompressor = SequentialPointRecordDecompressor::new(rest);
    for item in &layout.items {
        match item.item_type() {
            LazItemType::Point10 => decompressor.add_field_decompressor(v2::LasPoint0Decompressor::default()),
            LazItemType::GpsTime => decompressor.add_field_decompressor(ConstantTime::default()),
            LazItemType::RGB12 => decompressor.add_field_decompressor(v2::LasRGBDecompressor::default()),
            _ => decompressor.add_field_decompressor(v2::LasExtraByteDecompressor::new(item.size().into())),
        }
    }
    decompressor.decompress_many(records).map_err(|e| e.to_string())?;
    Ok(decompressor.into_inner())
}

/// Fails if an arithmetic code begins with its upper bound, which is no code.
fn check_code(code: &[u8]) -> Result<(), String> {
    match code.starts_with(&[0xff; 4]) {
        true => Err("an arithmetic code out of its range".to_owned()),
        false => Ok(()),
    }
}

/// Times that all points have in common: py123d writes none, and stores its own as features.
struct ConstantTime {
    time: [u8; 8],
    change: ArithmeticModel,
}

impl Default for ConstantTime {
    fn default() -> Self {
        // A symbol for each kind of change.
        Self { time: [0; 8], change: ArithmeticModelBuilder::new(6).build() }
    }
}

impl<R: Read> FieldDecompressor<R> for ConstantTime {
    fn size_of_field(&self) -> usize {
        self.time.len()
    }

    fn decompress_first(&mut self, src: &mut R, first_point: &mut [u8]) -> std::io::Result<()> {
        src.read_exact(&mut self.time)?;
        first_point.copy_from_slice(&self.time);
        Ok(())
    }

    fn decompress_with(&mut self, decoder: &mut ArithmeticDecoder<R>, buf: &mut [u8]) -> std::io::Result<()> {
        match decoder.decode_symbol(&mut self.change)? {
            0 => buf.copy_from_slice(&self.time),
            _ => return Err(Error::new(ErrorKind::InvalidData, "GPS times")),
        }
        Ok(())
    }
}

/// Decompresses a chunk, and returns the bytes behind it.
fn layered<'a>(
    rest: &'a [u8],
    header: &Header,
    layout: &Layout,
    records: &mut [u8],
) -> Result<&'a [u8], String> {
    let length = check_layers(rest, header, records.len() / header.record_bytes)?;
    let (chunk, rest) = rest.split_at_checked(length).ok_or_else(cut)?;
    let mut decompressor = LayeredPointRecordDecompressor::new(Cursor::new(chunk));
    decompressor.set_fields_from(&layout.items).map_err(|e| e.to_string())?;
    let positions = DecompressionSelection::base().decompress_z();
    decompressor.set_selection(positions.decompress_extra_bytes());
    decompressor.decompress_many(records).map_err(|e| e.to_string())?;
    Ok(rest)
}

/// Validates the layers of a chunk: a record, the number of points, the size of each layer, the layers.
/// Returns the bytes of the chunk.
fn check_layers(rest: &[u8], header: &Header, points: usize) -> Result<usize, String> {
    let color_layers = [0, 1, 2][usize::from(header.format.clamp(6, 8) - 6)];
    let layers = STANDARD_LAYERS + color_layers + header.record_bytes - header.standard_bytes;
    let start = header.record_bytes + 4 * (1 + layers);
    let numbers = rest.get(header.record_bytes..start).ok_or_else(cut)?.as_chunks::<4>().0;
    let mut numbers = numbers.iter().map(|bytes| u32::from_le_bytes(*bytes) as usize);
    if numbers.next() != Some(points) {
        return Err("a chunk of another number".to_owned());
    }
    let mut at = start;
    for size in numbers {
        let layer = rest.get(at..).and_then(|rest| rest.get(..size)).ok_or_else(cut)?;
        check_code(layer)?;
        at += size;
    }
    Ok(at)
}

fn cut() -> String {
    "a chunk that is cut off".to_owned()
}
