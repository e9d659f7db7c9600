//! Rows of `vertex` in the three encodings. Files have rows that the parser of the library refuses (`nan` in
//! text), and the meaning of a property depends on all others, so only the header is left to the library.

use std::io::BufRead;
use std::path::Path;

use ply_rs_bw::ply::{ElementDef, Encoding, PropertyType, ScalarType};

use super::columns::{Column, Columns, harmonic_level};
use crate::cloud::not_finite;
use crate::cloud::rows::Row;
use crate::error::FileError;

/// Default color of points in a file without colors.
const GREY: f64 = 128.0;

/// Reader of one element after the other.
pub(super) struct Payload<'a, R> {
    pub(super) reader: R,
    pub(super) encoding: Encoding,
    pub(super) path: &'a Path,
    /// Current line of a text.
    line: Vec<u8>,
    /// Position in that line.
    at: usize,
}

/// Element that is being read, for messages.
#[derive(Clone, Copy)]
struct Place<'a> {
    element: &'a str,
    row: usize,
}

/// Value of a scalar.
#[derive(Clone, Copy)]
struct Value {
    number: f64,
    /// Bits of a packed color: a 4-byte number has four. A double holds such a float or a whole number, and
    /// so does text.
    bits: u32,
}

impl<'a, R: BufRead> Payload<'a, R> {
    pub(super) fn new(reader: R, encoding: Encoding, path: &'a Path) -> Self {
        Self { reader, encoding, path, line: Vec::new(), at: 0 }
    }

    /// Skips all rows of an element.
    pub(super) fn skip(&mut self, element: &ElementDef) -> Result<(), FileError> {
        (0..element.count).try_for_each(|row| self.row(element, row, |_, _| ()))
    }

    /// Reads a row of `vertex`.
    pub(super) fn vertex(
        &mut self,
        element: &ElementDef,
        columns: &Columns,
        row: usize,
    ) -> Result<Row, FileError> {
        let mut read = Row { position: [f64::NAN; 3], rgb: [GREY; 3], class: 0.0 };
        self.row(element, row, |property, Value { number, bits }| match columns.of[property] {
            Some(Column::Position(axis)) => read.position[axis] = number,
            Some(Column::Color(channel)) => read.rgb[channel] = number,
            Some(Column::Harmonic(channel)) => read.rgb[channel] = harmonic_level(number),
            Some(Column::Packed) => read.rgb = [16, 8, 0].map(|shift| f64::from(bits >> shift & 255)),
            Some(Column::Class) => read.class = number,
            None => {}
        })?;
        Ok(read)
    }

    /// Reads a row and passes the index and the value of each scalar property.
    fn row(
        &mut self,
        element: &ElementDef,
        row: usize,
        mut take: impl FnMut(usize, Value),
    ) -> Result<(), FileError> {
        let place = Place { element: &element.name, row };
        if self.encoding == Encoding::Ascii {
            self.next_line(place)?;
        }
        for (index, (name, property)) in element.properties.iter().enumerate() {
            match &property.data_type {
                PropertyType::Scalar(scalar) => take(index, self.value(scalar, name, place)?),
                PropertyType::List(count, scalar) => {
                    let count = self.value(count, name, place)?.number;
                    if !(count >= 0.0 && count.fract() == 0.0) {
                        let expected = format!("the length of a list as {name} of {place}");
                        return Err(FileError::content(expected, count.to_string(), self.path));
                    }
                    for _ in 0..count as u64 {
                        self.value(scalar, name, place)?;
                    }
                }
            }
        }
        Ok(())
    }

    fn value(&mut self, scalar: &ScalarType, name: &str, place: Place<'_>) -> Result<Value, FileError> {
        match self.encoding {
            Encoding::Ascii => self.word(scalar, name, place),
            Encoding::BinaryLittleEndian => self.binary(scalar, place, false),
            Encoding::BinaryBigEndian => self.binary(scalar, place, true),
        }
    }

    fn binary(&mut self, scalar: &ScalarType, place: Place<'_>, big: bool) -> Result<Value, FileError> {
        use ScalarType::{Char, Double, Float, Int, Short, UChar, UInt, UShort};
        let value = |number: f64| Value { number, bits: 0 };
        Ok(match scalar {
            Char => value(f64::from(self.bytes::<1>(place, big)?[0] as i8)),
            UChar => value(f64::from(self.bytes::<1>(place, big)?[0])),
            Short => value(f64::from(i16::from_le_bytes(self.bytes(place, big)?))),
            UShort => value(f64::from(u16::from_le_bytes(self.bytes(place, big)?))),
            Double => {
                let number = f64::from_le_bytes(self.bytes(place, big)?);
                Value { number, bits: packed_bits(number) }
            }
            Int | UInt | Float => {
                let bits = u32::from_le_bytes(self.bytes(place, big)?);
                let number = match scalar {
                    Float => f64::from(f32::from_bits(bits)),
                    Int => f64::from(bits as i32),
                    _ => f64::from(bits),
                };
                Value { number, bits }
            }
        })
    }

    /// Returns the bytes of a number in little-endian order.
    fn bytes<const N: usize>(&mut self, place: Place<'_>, big: bool) -> Result<[u8; N], FileError> {
        let mut bytes = [0; N];
        self.reader.read_exact(&mut bytes).map_err(|error| match error.kind() {
            std::io::ErrorKind::UnexpectedEof => end(place, self.path),
            _ => FileError::io("read", self.path)(error),
        })?;
        if big {
            bytes.reverse();
        }
        Ok(bytes)
    }

    /// Reads a line that is not empty.
    fn next_line(&mut self, place: Place<'_>) -> Result<(), FileError> {
        self.at = 0;
        loop {
            self.line.clear();
            let count = self.reader.read_until(b'\n', &mut self.line);
            if count.map_err(FileError::io("read", self.path))? == 0 {
                return Err(end(place, self.path));
            }
            if !self.line.trim_ascii().is_empty() {
                return Ok(());
            }
        }
    }

    /// Reads the next word of the line as a number of a type.
    fn word(&mut self, scalar: &ScalarType, name: &str, place: Place<'_>) -> Result<Value, FileError> {
        let rest = self.line[self.at..].trim_ascii_start();
        let word = rest.split(u8::is_ascii_whitespace).next().unwrap_or_default();
        self.at = self.line.len() - rest.len() + word.len();
        let text = String::from_utf8_lossy(word);
        let wrong = |found: String| {
            let expected = format!("a {} as {name} of {place}", type_name(scalar));
            Err(FileError::content(expected, found, self.path))
        };
        if word.is_empty() {
            return wrong("the end of the line".to_owned());
        }
        match parse(&text, scalar) {
            Some(value) => Ok(value),
            None => wrong(format!("{:?}", text.chars().take(40).collect::<String>())),
        }
    }
}

impl std::fmt::Display for Place<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {}", self.element, self.row)
    }
}

fn end(place: Place<'_>, path: &Path) -> FileError {
    FileError::content("a PLY file", format!("Unexpected end of file in {place}"), path)
}

/// Returns the name of a type in headers.
fn type_name(scalar: &ScalarType) -> &'static str {
    match scalar {
        ScalarType::Char => "char",
        ScalarType::UChar => "uchar",
        ScalarType::Short => "short",
        ScalarType::UShort => "ushort",
        ScalarType::Int => "int",
        ScalarType::UInt => "uint",
        ScalarType::Float => "float",
        ScalarType::Double => "double",
    }
}

/// Parses a number of a type; `None` for other text. Integers may be written as floats and may be missing
/// (NaN), as some programs write all columns alike.
fn parse(text: &str, scalar: &ScalarType) -> Option<Value> {
    if let Some(number) = not_finite(text) {
        return Some(Value { number, bits: (number as f32).to_bits() });
    }
    let range = match scalar {
        ScalarType::Float => {
            let number: f32 = text.parse().ok()?;
            let bits = packed_bits(text.parse().ok()?);
            return Some(Value { number: f64::from(number), bits });
        }
        ScalarType::Double => {
            let number = text.parse().ok()?;
            return Some(Value { number, bits: packed_bits(number) });
        }
        ScalarType::Char => -128.0..=127.0,
        ScalarType::UChar => 0.0..=255.0,
        ScalarType::Short => -32_768.0..=32_767.0,
        ScalarType::UShort => 0.0..=65_535.0,
        ScalarType::Int => f64::from(i32::MIN)..=f64::from(i32::MAX),
        ScalarType::UInt => 0.0..=f64::from(u32::MAX),
    };
    let number: f64 = text.parse().ok()?;
    (range.contains(&number) && number.fract() == 0.0).then_some(Value { number, bits: number as i64 as u32 })
}

/// Returns the bits of a packed color `0xAARRGGBB`: a whole number, or the number whose float has these bits.
fn packed_bits(number: f64) -> u32 {
    let is_whole = number.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&number);
    if is_whole { number as u32 } else { (number as f32).to_bits() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integers_may_be_missing() {
        for text in ["nan", "-nan(ind)", "1.#QNAN", "-1.#IND00"] {
            assert!(parse(text, &ScalarType::UChar).unwrap().number.is_nan(), "{text}");
        }
        assert_eq!(parse("-1.#INF", &ScalarType::Int).unwrap().number, f64::NEG_INFINITY);
    }

    #[test]
    fn integers_have_the_range_of_their_type() {
        let number = |text: &str, scalar| parse(text, &scalar).map(|value| value.number);
        assert_eq!(number("255", ScalarType::UChar), Some(255.0));
        assert_eq!(number("128.000000", ScalarType::UChar), Some(128.0));
        for text in ["256", "-1", "1.5", "1,5", "red", "1e400"] {
            assert_eq!(number(text, ScalarType::UChar), None, "{text}");
        }
        assert_eq!(number("1,5", ScalarType::Float), None);
        assert_eq!(number("1e39", ScalarType::Float), Some(f64::INFINITY));
        // As the binary file of the same number.
        assert_eq!(number("0.1", ScalarType::Float), Some(f64::from(0.1_f32)));
    }
}
