//! Polygon files (PLY) with a `vertex` element: written as binary little-endian, read in all three encodings.
//!
//! # How it works
//! The header is parsed first. Element counts are validated against the file length before any element is
//! read. The names of all properties decide which are colors (`columns`). Vertices are then read row by row
//! (`payload`); properties other than position, color and class are skipped.

mod columns;
mod payload;

use std::io::{BufRead, BufReader, Seek, SeekFrom, Write};
use std::path::Path;

use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{DefaultElement, ElementDef, Encoding, Header, PropertyType, ScalarType};

use super::rows::{RowFormat, collect};
use super::{Point, PointFile};
use crate::error::FileError;
use crate::files::input::open_regular;
use crate::files::{sniff, write_whole};
use columns::Columns;
use payload::Payload;

/// Maximum length of a header, bytes.
const MAX_HEADER_BYTES: u64 = 1 << 20;

/// Writes points: `x y z` float, `red green blue class` uchar, binary little-endian.
///
/// # Errors
/// Fails if the file cannot be written.
pub fn write(path: &Path, points: &[Point]) -> Result<(), FileError> {
    let header = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\n\
         property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
         property uchar class\nend_header\n",
        points.len()
    );
    write_whole(path, |out| {
        out.write_all(header.as_bytes()).map_err(FileError::io("write", path))?;
        // The 16 bytes of a point are these seven properties in this order.
        out.write_all(bytemuck::cast_slice(points)).map_err(FileError::io("write", path))
    })
}

/// Reads the element `vertex`: `x y z` float or double, optional colors and `class`. Colors are `red green
/// blue` of 0 to 255, or of other names and ranges, which [`PointFile::notes`] says. Defaults are gray 128
/// and class 0.
///
/// # Errors
/// Fails if the file cannot be read, has no vertices or missing data, or its coordinates have another type.
/// Fails if a color is out of range or a class is not an integer of 0–255.
pub fn read(path: &Path) -> Result<PointFile, FileError> {
    let (file, file_bytes) = open_regular(path)?;
    decode(BufReader::with_capacity(1 << 20, file), file_bytes, path)
}

fn decode(mut reader: impl BufRead + Seek, file_bytes: u64, path: &Path) -> Result<PointFile, FileError> {
    let head = reader.fill_buf().map_err(FileError::io("read", path))?;
    if let Some(found) = other_content(head) {
        return Err(FileError::content("a PLY file", found, path));
    }
    // A header without line ends must not fill the memory.
    let mut limited = Reader::new(reader.take(file_bytes.min(MAX_HEADER_BYTES)));
    let header = Parser::<DefaultElement>::new().read_header(&mut limited);
    let header =
        header.map_err(|error| FileError::content("a PLY file", in_words(&error.to_string()), path))?;
    let mut reader = limited.into_inner().into_inner();
    let start = reader.stream_position().map_err(FileError::io("read", path))?;
    let vertex = check_header(&header, file_bytes, path)?;
    let columns = Columns::of(vertex, path)?;
    let format = RowFormat { rows: vertex.count, double: columns.double, colors: columns.colors, path };
    let mut payload = Payload::new(reader, header.encoding, path);
    let mut cloud = collect(&format, |visit| {
        payload.reader.seek(SeekFrom::Start(start)).map_err(FileError::io("read", path))?;
        let before = header.elements.iter().map(|(_, element)| element).take_while(|e| e.name != vertex.name);
        before.into_iter().try_for_each(|element| payload.skip(element))?;
        for row in 0..vertex.count {
            if !visit(&payload.vertex(vertex, &columns, row)?)? {
                break;
            }
        }
        Ok(())
    })?;
    cloud.notes.splice(0..0, columns.note);
    Ok(cloud)
}

/// Describes a file by its beginning, unless it begins like a PLY file.
fn other_content(head: &[u8]) -> Option<String> {
    match head {
        [b'p', b'l', b'y', b'\r', next, ..] if *next != b'\n' => {
            Some("lines that end in CR alone (write LF)".to_owned())
        }
        [b'p', b'l', b'y', end, ..] if end.is_ascii_whitespace() => None,
        [0xef, 0xbb, 0xbf, b'p', b'l', b'y', ..] => {
            Some("a byte order mark before the header (save it without one)".to_owned())
        }
        _ => Some(sniff::described(head).unwrap_or_else(|| "other content".to_owned())),
    }
}

/// Returns a message of the header's parser in one sentence. It has a line number, a reason, then on lines of
/// their own the line of the file and the parser's own data.
fn in_words(message: &str) -> String {
    let lines: Vec<&str> = message.lines().map(str::trim).collect();
    let number = message.strip_prefix("Line ").and_then(|rest| rest.split(':').next());
    let line = lines.iter().find_map(|line| line.strip_prefix("String: "));
    match (line, number) {
        (Some(line), Some(number)) => format!("{:?} in line {number}", line.trim_matches('\'')),
        (Some(line), None) => format!("the line {:?}", line.trim_matches('\'')),
        (None, _) if message.contains("end_header") => "a header without end_header (cut off?)".to_owned(),
        (None, _) => {
            let first = lines.first().copied().unwrap_or_default();
            first.split_once(": ").map_or(first, |(_, reason)| reason).to_owned()
        }
    }
}

/// Validates the header. Returns the element `vertex`.
fn check_header<'h>(header: &'h Header, file_bytes: u64, path: &Path) -> Result<&'h ElementDef, FileError> {
    let vertex =
        header.elements.get("vertex").ok_or_else(|| FileError::content("an element vertex", "none", path))?;
    if vertex.count == 0 || vertex.count as u64 > u64::from(u32::MAX) - 1 {
        return Err(FileError::content("1 to 4294967294 points", vertex.count.to_string(), path));
    }
    for element in header.elements.values() {
        let each: u64 = element.properties.values().map(|p| least_bytes(&p.data_type, header.encoding)).sum();
        let needed = (element.count as u64).checked_mul(each);
        let empty = each == 0 && element.count > 0;
        if empty || needed.is_none_or(|needed| needed > file_bytes) {
            let expected =
                format!("{} times {each} bytes or more of element {}", element.count, element.name);
            return Err(FileError::content(expected, format!("a file of {file_bytes} bytes"), path));
        }
    }
    Ok(vertex)
}

/// Minimum size of a property in the file, bytes.
fn least_bytes(data_type: &PropertyType, encoding: Encoding) -> u64 {
    let (PropertyType::Scalar(scalar) | PropertyType::List(scalar, _)) = data_type;
    match (encoding, scalar) {
        (Encoding::Ascii, _) | (_, ScalarType::Char | ScalarType::UChar) => 1,
        (_, ScalarType::Short | ScalarType::UShort) => 2,
        (_, ScalarType::Int | ScalarType::UInt | ScalarType::Float) => 4,
        (_, ScalarType::Double) => 8,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parse(bytes: &[u8]) -> Result<PointFile, FileError> {
        decode(std::io::Cursor::new(bytes), bytes.len() as u64, Path::new("p.ply"))
    }

    #[test]
    fn written_points_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.ply");
        let points: Vec<Point> =
            (0..50).map(|i: u8| Point::new([f32::from(i), -0.25, 7.0], [i, 3, 255 - i], i % 5)).collect();
        write(&path, &points).unwrap();
        let cloud = read(&path).unwrap();
        assert_eq!((cloud.points, cloud.non_finite), (points, 0));
    }

    #[test]
    fn colors_and_class_are_optional() {
        let text = "ply\nformat ascii 1.0\nelement vertex 2\nproperty double x\nproperty double y\n\
                    property double z\nproperty list uchar int neighbours\nend_header\n\
                    500000.25 1 2 2 0 1\n500001.5 1e999 3 0\n";
        let cloud = parse(text.as_bytes()).unwrap();
        assert_eq!(cloud.points[0], Point::new([0.25, 0.0, 0.0], [128; 3], 0));
        assert_eq!((cloud.points.len(), cloud.non_finite, cloud.origin.x), (2, 1, 500_000.0));
    }

    #[test]
    fn errors_state_the_expected_content() {
        let header = |format: &str, body: &str| format!("ply\nformat {format} 1.0\n{body}end_header\n");
        let xyz = "property float x\nproperty float y\nproperty float z\n";
        for (text, message) in [
            (header("ascii", ""), "an element vertex, found none"),
            (header("ascii", "element vertex 1\nproperty int x\n"), "float or double property x"),
            (header("ascii", &format!("element vertex 0\n{xyz}")), "found 0"),
            (header("binary_little_endian", &format!("element vertex 4000000000\n{xyz}")), "a file of"),
            (
                header("binary_little_endian", &format!("element a 9000000000\nelement vertex 1\n{xyz}")),
                "a file of",
            ),
            (header("binary_big_endian", &format!("element vertex 2\n{xyz}")), "Unexpected end of file"),
            (
                header("ascii", &format!("element vertex 1\n{xyz}property float red\n")) + "1 2 3 300\n",
                "found 300",
            ),
            ("hello".to_owned(), "a PLY file, found text that begins with \"hello\": "),
            (String::new(), "found an empty file: "),
            ("\u{feff}ply\nformat ascii 1.0\n".to_owned(), "found a byte order mark before the header"),
            ("ply\rformat ascii 1.0\r".to_owned(), "found lines that end in CR alone"),
            ("\0".repeat(500), "found zero bytes"),
            ("\u{1}\u{2}\u{3}".to_owned(), "found other content: "),
            (header("ascii", "element vertex 1\nproperty half x\n"), "found \"property half x\" in line 4: "),
            ("ply\nformat ascii 1.0\nelement vertex 5\n".to_owned(), "found a header without end_header"),
        ] {
            let found = parse(text.as_bytes()).unwrap_err().to_string();
            assert!(found.contains(message) && found.ends_with("p.ply"), "{found}, expected {message}");
            assert!(!found.contains('{') && !found.contains("Error"), "{found}");
        }
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = parse(&bytes);
        }

        #[test]
        fn arbitrary_headers_never_panic(
            lines in prop::collection::vec(
                prop_oneof![
                    "element (vertex|face) [0-9]{1,20}",
                    "property (float|double|uchar|list uchar int|list int float) (x|y|z|red|class|other)",
                    "comment .{0,10}",
                    ".{0,20}",
                ],
                0..12,
            ),
            encoding in "(ascii|binary_little_endian|binary_big_endian)",
            data in prop::collection::vec(any::<u8>(), 0..100),
        ) {
            let mut file = format!("ply\nformat {encoding} \
                1.0\n{}\nend_header\n", lines.join("\n")).into_bytes();
            file.extend(data);
            let _ = parse(&file);
        }
    }
}
