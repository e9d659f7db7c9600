//! Header of PCD files.

use std::path::Path;

use super::format::is_pcd;
use crate::error::FileError;
use crate::files::sniff;

/// Names of the fields that may be missing.
const INTENSITY: &str = "intensity";
const DEVICE: &str = "lidar_info";
const RING: &str = "ring";

/// Parsed header.
#[derive(Debug)]
pub(super) struct Header {
    /// Byte offset of the points.
    pub(super) start: usize,
    pub(super) encoding: Encoding,
    pub(super) points: usize,
    /// Bytes per point.
    pub(super) stride: usize,
    /// Numbers per point.
    pub(super) numbers: usize,
    pub(super) position: [Field; 3],
    pub(super) intensity: Option<Field>,
    pub(super) device: Option<Field>,
    pub(super) ring: Option<Field>,
    /// Names of the last three that are fields, but not single numbers of a known type.
    pub(super) unread: Vec<&'static str>,
}

/// Encoding of the points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    /// Rows of little-endian numbers.
    Binary,
    /// Columns of little-endian numbers, compressed by LZF.
    Compressed,
    /// Lines of text.
    Ascii,
}

/// Numeric field of a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Field {
    /// Byte offset in a row.
    pub(super) offset: usize,
    /// Index among the numbers of a row.
    pub(super) index: usize,
    kind: Kind,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    F32,
    F64,
    U8,
    U16,
    U32,
    U64,
    I8,
    I16,
    I32,
    I64,
}

impl Encoding {
    fn parse(name: &str) -> Option<Self> {
        match name.to_ascii_lowercase().as_str() {
            "binary" => Some(Self::Binary),
            "binary_compressed" => Some(Self::Compressed),
            "ascii" => Some(Self::Ascii),
            _ => None,
        }
    }
}

impl Kind {
    /// Returns the number of bytes.
    fn size(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::F32 | Self::U32 | Self::I32 => 4,
            Self::F64 | Self::U64 | Self::I64 => 8,
        }
    }

    fn parse(kind: &str, size: usize) -> Option<Self> {
        Some(match (kind.to_ascii_uppercase().as_str(), size) {
            ("F", 4) => Self::F32,
            ("F", 8) => Self::F64,
            ("U", 1) => Self::U8,
            ("U", 2) => Self::U16,
            ("U", 4) => Self::U32,
            ("U", 8) => Self::U64,
            ("I", 1) => Self::I8,
            ("I", 2) => Self::I16,
            ("I", 4) => Self::I32,
            ("I", 8) => Self::I64,
            _ => return None,
        })
    }
}

impl Field {
    /// Returns the number of bytes.
    pub(super) fn size(self) -> usize {
        self.kind.size()
    }

    /// Returns the field's value from its place in the points.
    pub(super) fn number(self, bytes: &[u8], offset: usize) -> f64 {
        let rest = bytes.get(offset..).unwrap_or_default();
        let number = match self.kind {
            Kind::F32 => rest.first_chunk().map(|b| f64::from(f32::from_le_bytes(*b))),
            Kind::F64 => rest.first_chunk().map(|b| f64::from_le_bytes(*b)),
            Kind::U8 => rest.first_chunk().map(|b| f64::from(u8::from_le_bytes(*b))),
            Kind::U16 => rest.first_chunk().map(|b| f64::from(u16::from_le_bytes(*b))),
            Kind::U32 => rest.first_chunk().map(|b| f64::from(u32::from_le_bytes(*b))),
            Kind::U64 => rest.first_chunk().map(|b| u64::from_le_bytes(*b) as f64),
            Kind::I8 => rest.first_chunk().map(|b| f64::from(i8::from_le_bytes(*b))),
            Kind::I16 => rest.first_chunk().map(|b| f64::from(i16::from_le_bytes(*b))),
            Kind::I32 => rest.first_chunk().map(|b| f64::from(i32::from_le_bytes(*b))),
            Kind::I64 => rest.first_chunk().map(|b| i64::from_le_bytes(*b) as f64),
        };
        // Every field was validated to lie within the points.
        number.unwrap_or(f64::NAN)
    }
}

/// Name and layout of a field; no layout for arrays and unknown types.
type Column<'a> = (&'a str, Option<Field>);

/// Header values by key.
#[derive(Default)]
struct Lines<'a> {
    fields: Vec<&'a str>,
    sizes: Vec<&'a str>,
    types: Vec<&'a str>,
    counts: Vec<&'a str>,
    width: &'a str,
    height: &'a str,
    points: &'a str,
}

impl Header {
    /// Parses the start of a file; `path` is for messages.
    ///
    /// # Errors
    /// Fails if it is no header, lacks `x y z` as floats, or contradicts itself.
    pub(super) fn parse(head: &[u8], path: &Path) -> Result<Self, FileError> {
        let wrong = |expected: &str, found: String| FileError::content(expected, found, path);
        let (lines, encoding, start) = Lines::split(head, path)?;
        let number = |key: &str, text: &str| {
            let found = || wrong(&format!("a whole number as {key}"), format!("{text:?}"));
            text.parse::<usize>().map_err(|_| found())
        };
        let (width, height) = (number("WIDTH", lines.width)?, number("HEIGHT", lines.height)?);
        let points = width
            .checked_mul(height)
            .ok_or_else(|| wrong("fewer points", format!("WIDTH {width} and HEIGHT {height}")))?;
        if !lines.points.is_empty() && number("POINTS", lines.points)? != points {
            let found = format!("POINTS {}", lines.points);
            return Err(wrong(&format!("WIDTH times HEIGHT, {points} points"), found));
        }
        let (columns, stride, numbers) = lines.columns(path)?;
        let column = |name: &str| columns.iter().find(|(n, _)| n.eq_ignore_ascii_case(name));
        let field = |name: &str| column(name).and_then(|(_, field)| *field);
        let coordinate = |name: &str| {
            let found = || wrong(&format!("{name} as a single float of 4 or 8 bytes (F)"), lines.layout());
            field(name).filter(|f| matches!(f.kind, Kind::F32 | Kind::F64)).ok_or_else(found)
        };
        let position = [coordinate("x")?, coordinate("y")?, coordinate("z")?];
        let (intensity, device, ring) = (field(INTENSITY), field(DEVICE), field(RING));
        let unread = [INTENSITY, DEVICE, RING].into_iter();
        let unread = unread.filter(|name| column(name).is_some_and(|(_, field)| field.is_none())).collect();
        if points == 0 {
            return Err(wrong("at least one point", "none".to_owned()));
        }
        Ok(Self { start, encoding, points, stride, numbers, position, intensity, device, ring, unread })
    }
}

impl<'a> Lines<'a> {
    /// Parses the lines up to `DATA`. Also returns the encoding and the byte offset of the points.
    fn split(head: &'a [u8], path: &Path) -> Result<(Self, Encoding, usize), FileError> {
        let mut lines = Self::default();
        let mut at = 0;
        while let Some(length) = head[at..].iter().position(|b| *b == b'\n') {
            let line = str::from_utf8(&head[at..at + length]).unwrap_or_default().trim_end();
            at += length + 1;
            let mut words = line.split_ascii_whitespace();
            let (key, values) = (words.next().unwrap_or(""), words);
            let first = || values.clone().next().unwrap_or_default();
            match key {
                "FIELDS" | "COLUMNS" => lines.fields = values.collect(),
                "SIZE" => lines.sizes = values.collect(),
                "TYPE" => lines.types = values.collect(),
                "COUNT" => lines.counts = values.collect(),
                "WIDTH" => lines.width = first(),
                "HEIGHT" => lines.height = first(),
                "POINTS" => lines.points = first(),
                "DATA" => {
                    let expected = "DATA binary, binary_compressed or ascii";
                    let found = || FileError::content(expected, format!("{line:?}"), path);
                    return Ok((lines, Encoding::parse(first()).ok_or_else(found)?, at));
                }
                "VERSION" | "VIEWPOINT" | "" => {}
                _ if key.starts_with('#') => {}
                _ => break,
            }
        }
        Err(FileError::content("a PCD header that ends with DATA", found_instead(head, at), path))
    }

    /// Returns all fields, and the bytes and the numbers per point.
    fn columns(&self, path: &Path) -> Result<(Vec<Column<'a>>, usize, usize), FileError> {
        let wrong = || FileError::content("SIZE, TYPE and COUNT for every field", self.layout(), path);
        let ones = vec!["1"; self.fields.len()];
        let counts = if self.counts.is_empty() { &ones } else { &self.counts };
        if [self.sizes.len(), self.types.len(), counts.len()] != [self.fields.len(); 3] {
            return Err(wrong());
        }
        let (mut columns, mut offset, mut index) = (Vec::new(), 0_usize, 0_usize);
        for (i, name) in self.fields.iter().enumerate() {
            let (size, count): (u16, u16) =
                self.sizes[i].parse().ok().zip(counts[i].parse().ok()).ok_or_else(wrong)?;
            let kind = Kind::parse(self.types[i], size.into()).filter(|_| count == 1);
            columns.push((*name, kind.map(|kind| Field { offset, index, kind })));
            offset += usize::from(size) * usize::from(count);
            index += usize::from(count);
        }
        Ok((columns, offset, index))
    }

    /// Formats the layout for messages.
    fn layout(&self) -> String {
        let part = |key: &str, values: &[&str]| format!("{key} {}", values.join(" "));
        let parts = [
            part("FIELDS", &self.fields),
            part("SIZE", &self.sizes),
            part("TYPE", &self.types),
            part("COUNT", &self.counts),
        ];
        parts.join(", ")
    }
}

/// Returns the start of the unexpected content, for messages.
fn found_instead(head: &[u8], at: usize) -> String {
    if head.is_empty() {
        return "an empty file".to_owned();
    }
    // Text without a mark may be a damaged header; its first wrong line then says more.
    if let Some(name) = sniff::marked(head).filter(|_| !is_pcd(head)) {
        return name.to_owned();
    }
    match head.get(at..).filter(|rest| !rest.is_empty()) {
        None => format!("none in {} bytes", head.len()),
        Some(rest) => format!("{:?} at byte {at}", String::from_utf8_lossy(&rest[..rest.len().min(40)])),
    }
}
