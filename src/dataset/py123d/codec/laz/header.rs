//! Header of a LAS file and the variable-length records behind it.

use crate::dataset::py123d::codec::feature::Kind;

/// Header bytes of LAS 1.2 and 1.4.
const OLD_HEADER_BYTES: usize = 227;
const HEADER_BYTES: usize = 375;

/// Bytes before the data of a variable-length record.
const RECORD_HEADER_BYTES: usize = 54;

/// Bytes that describe a feature.
const EXTRA_BYTES: usize = 192;

/// Maximum bytes of features per point. The decoder takes 10 kB of memory for each.
const MAX_EXTRA_BYTES: usize = 512;

/// Bit of a point format that marks compressed points.
const COMPRESSED: u8 = 0x80;

/// Prefix of features whose name is one of a standard field.
const PREFIX: &str = "extra_";

/// Contents of a header.
#[derive(Debug)]
pub(super) struct Header {
    pub(super) points: usize,
    /// Point format of the ASPRS.
    pub(super) format: u8,
    /// Bytes of a record: the standard fields, then features.
    pub(super) record_bytes: usize,
    /// Bytes of the standard fields.
    pub(super) standard_bytes: usize,
    /// Offset of the compressed points in the file.
    pub(super) start: usize,
    pub(super) scale: [f64; 3],
    pub(super) offset: [f64; 3],
    pub(super) extras: Vec<Extra>,
    /// Data of the record that describes the compression.
    pub(super) compression: Vec<u8>,
}

/// Feature in the extra bytes of a record.
#[derive(Debug)]
pub(super) struct Extra {
    pub(super) name: String,
    /// Type; `None` for several numbers, scaled ones, and bytes without a type.
    pub(super) kind: Option<Kind>,
    /// Offset in the record.
    pub(super) place: usize,
}

impl Header {
    /// Parses the header and the records behind it.
    ///
    /// # Errors
    /// Returns a description of the invalid content.
    pub(super) fn of(bytes: &[u8]) -> Result<Self, String> {
        let version: [u8; 2] = at(bytes, 24)?;
        let least = match version {
            [1, 2 | 3] => OLD_HEADER_BYTES,
            [1, 4] => HEADER_BYTES,
            [major, minor] => return Err(format!("LAS {major}.{minor}")),
        };
        let header_bytes = usize::from(u16::from_le_bytes(at(bytes, 94)?));
        if header_bytes < least || header_bytes > bytes.len() {
            return Err(format!("a header of {header_bytes} bytes"));
        }
        let [format] = at(bytes, 104)?;
        let format = format.checked_sub(COMPRESSED).ok_or("LAS points that are not compressed")?;
        let standard_bytes =
            standard_bytes(format).ok_or_else(|| format!("LAS points of format {format}"))?;
        let record_bytes = usize::from(u16::from_le_bytes(at(bytes, 105)?));
        if !(standard_bytes..=standard_bytes + MAX_EXTRA_BYTES).contains(&record_bytes) {
            return Err(format!("LAS points of format {format} and {record_bytes} bytes"));
        }
        let points = match version[1] {
            4 => u64::from_le_bytes(at(bytes, 247)?),
            _ => u32::from_le_bytes(at(bytes, 107)?).into(),
        };
        let start = u32::from_le_bytes(at(bytes, 96)?) as usize;
        let mut header = Self {
            points: usize::try_from(points).map_err(|_| format!("{points} points"))?,
            format,
            record_bytes,
            standard_bytes,
            start,
            scale: floats(bytes, 131)?,
            offset: floats(bytes, 155)?,
            extras: Vec::new(),
            compression: Vec::new(),
        };
        let records = bytes.get(header_bytes..start);
        let records = records.ok_or_else(|| format!("points at {start} of {} bytes", bytes.len()))?;
        header.read_records(records, u32::from_le_bytes(at(bytes, 100)?))?;
        Ok(header)
    }

    /// Reads the records of features and of the compression, and skips others.
    fn read_records(&mut self, mut bytes: &[u8], count: u32) -> Result<(), String> {
        for _ in 0..count {
            let user: [u8; 16] = at(bytes, 2)?;
            let (id, length) = (u16::from_le_bytes(at(bytes, 18)?), u16::from_le_bytes(at(bytes, 20)?));
            let rest = bytes.get(RECORD_HEADER_BYTES..).unwrap_or_default();
            let (data, rest) = rest.split_at_checked(length.into()).ok_or("a header that is cut off")?;
            match (text(&user).as_str(), id) {
                ("laszip encoded", 22_204) => self.compression = data.to_vec(),
                ("LASF_Spec", 4) => self.extras = extras(data, self.standard_bytes, self.record_bytes)?,
                _ => {}
            }
            bytes = rest;
        }
        Ok(())
    }
}

/// Returns the bytes of the standard fields of a point format.
fn standard_bytes(format: u8) -> Option<usize> {
    Some(match format {
        0 => 20,
        1 => 28,
        2 => 26,
        3 => 34,
        6 => 30,
        7 => 36,
        8 => 38,
        _ => return None,
    })
}

/// Parses the descriptions of features.
fn extras(data: &[u8], standard_bytes: usize, record_bytes: usize) -> Result<Vec<Extra>, String> {
    let mut place = standard_bytes;
    let mut extras = Vec::new();
    for record in data.as_chunks::<EXTRA_BYTES>().0 {
        let ([kind, options], name) = (at(record, 2)?, at::<32>(record, 4)?);
        let name = text(&name);
        let (kind, length) =
            extra_kind(kind, options).ok_or_else(|| format!("a feature {name} of type {kind}"))?;
        let name = name.strip_prefix(PREFIX).map_or_else(|| name.clone(), str::to_owned);
        extras.push(Extra { name, kind, place });
        place += length;
    }
    if place > record_bytes {
        return Err(format!("features of {place} bytes in points of {record_bytes}"));
    }
    Ok(extras)
}

/// Returns the type and the bytes of a feature; no type for several numbers, scaled ones and plain bytes.
fn extra_kind(kind: u8, options: u8) -> Option<(Option<Kind>, usize)> {
    const KINDS: [Kind; 10] = [
        Kind::U8,
        Kind::I8,
        Kind::U16,
        Kind::I16,
        Kind::U32,
        Kind::I32,
        Kind::U64,
        Kind::I64,
        Kind::F32,
        Kind::F64,
    ];
    /// Bits of the options that say that numbers are scaled or shifted.
    const SCALED: u8 = 0b11000;
    let Some(index) = usize::from(kind).checked_sub(1) else { return Some((None, options.into())) };
    let number = KINDS[index % KINDS.len()];
    match index / KINDS.len() {
        0 => Some(((options & SCALED == 0).then_some(number), number.bytes())),
        more @ 1..=2 => Some((None, number.bytes() * (more + 1))),
        _ => None,
    }
}

/// Returns bytes at a place.
fn at<const N: usize>(bytes: &[u8], place: usize) -> Result<[u8; N], String> {
    let found = bytes.get(place..).and_then(|rest| rest.first_chunk());
    found.copied().ok_or_else(|| "a header that is cut off".to_owned())
}

fn floats(bytes: &[u8], place: usize) -> Result<[f64; 3], String> {
    let float = |axis: usize| Ok::<_, String>(f64::from_le_bytes(at(bytes, place + 8 * axis)?));
    Ok([float(0)?, float(1)?, float(2)?])
}

/// Returns text that ends at the first zero byte.
fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).into_owned()
}
