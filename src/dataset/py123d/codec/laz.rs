//! LAZ files: LAS 1.2 to 1.4, compressed in chunks of points.
//!
//! # How it works
//! A header states the number of points, their record's format and length, and how integers become meters.
//! Records before the points (VLRs) name the compressed items of a record and the extra bytes, which are the
//! features. `chunks` decompresses the records. Format: LAS 1.4 R15 of the ASPRS, and `laszip` for the
//! compressed part.

mod chunks;
mod header;

use chunks::Layout;
use header::{Extra, Header};

use super::feature::Column;
use super::{Points, is_read, most_decoded};

/// Decodes the points of a file.
///
/// # Errors
/// Returns a description of the invalid content.
pub(super) fn decode(bytes: &[u8]) -> Result<Points, String> {
    let (header, layout) = checked(bytes)?;
    let records = chunks::decompress(bytes, &header, &layout)?;
    let xyz = records.chunks_exact(header.record_bytes).map(|record| position(&header, record)).collect();
    let mut points = Points { xyz, ..Points::default() };
    for Extra { name, kind, place } in &header.extras {
        match kind {
            Some(kind) if is_read(name) => {
                let bytes = records.get(*place..).unwrap_or_default();
                points.extend_feature(name, &Column::strided(*kind, bytes, header.record_bytes))?;
            }
            None if is_read(name) => return Err(format!("a feature {name} of several or scaled numbers")),
            _ => points.skipped.push(name.clone()),
        }
    }
    Ok(points)
}

/// Returns the number of points that a file declares, after validating its header.
///
/// # Errors
/// Fails as [`decode`], except for damage within points.
pub(super) fn declared_points(bytes: &[u8]) -> Result<u64, String> {
    checked(bytes).map(|(header, _)| header.points as u64)
}

/// Parses the header and the compressed items, and limits the decompressed records.
fn checked(bytes: &[u8]) -> Result<(Header, Layout), String> {
    let header = Header::of(bytes)?;
    let layout = Layout::of(&header)?;
    let size = (header.points as u64).saturating_mul(header.record_bytes as u64);
    if size > most_decoded(bytes) {
        let (points, record) = (header.points, header.record_bytes);
        return Err(format!("{points} points of {record} bytes in a file of {} bytes", bytes.len()));
    }
    let twice = |extra: &Extra| header.extras.iter().filter(|other| other.name == extra.name).count() > 1;
    match header.extras.iter().find(|extra| is_read(&extra.name) && twice(extra)) {
        Some(extra) => Err(format!("two features {}", extra.name)),
        None => Ok((header, layout)),
    }
}

/// Returns the position of a record: three integers, scaled and shifted.
fn position(header: &Header, record: &[u8]) -> [f32; 3] {
    let integers = record.as_chunks::<4>().0;
    let meters = |axis: usize| {
        let integer = integers.get(axis).map_or(0, |bytes| i32::from_le_bytes(*bytes));
        (f64::from(integer) * header.scale[axis] + header.offset[axis]) as f32
    };
    [0, 1, 2].map(meters)
}

#[cfg(test)]
mod tests;
