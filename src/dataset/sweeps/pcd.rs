//! PCD files: sweeps with a text header that names the fields.
//!
//! Fields other than coordinates, intensity, ring and `lidar_info` (device of a merged sweep) are skipped by
//! their sizes. Bytes after the last point are ignored: in nuPlan's files they are garbage, mostly zeros.
//! Format: <https://pointclouds.org/documentation/tutorials/pcd_file_format.html>.

use std::io::Read;
use std::path::Path;

use super::format::MAX_HEADER_BYTES;
use super::lzf::decompress;
use super::pcd_header::{Encoding, Field, Header};
use super::{SweepRow, SweepRows};
use crate::cloud::not_finite;
use crate::dataset::{RingMeaning, Sweep};
use crate::error::FileError;
use crate::files::input::{SWEEP_BYTES, open_regular, read_file};

/// Bytes before compressed points: their length, and the length that they expand to.
const LENGTHS: usize = 8;

/// Bytes at the start of a file that [`check_pcd`] reads: the longest header, and the lengths of compressed
/// points.
pub(in crate::dataset) const HEAD_BYTES: u64 = MAX_HEADER_BYTES + LENGTHS as u64;

/// Returns the point count of a PCD file from its header, after checking its length.
///
/// # Errors
/// Fails as [`read_pcd_file`], except for errors in the points themselves.
pub fn check_pcd_file(path: &Path) -> Result<u64, FileError> {
    let (file, length) = open_regular(path)?;
    let mut head = Vec::new();
    file.take(HEAD_BYTES).read_to_end(&mut head).map_err(FileError::io("read", path))?;
    check_pcd(&head, length, path)
}

/// Returns the point count of a PCD file with `length` bytes from its first [`HEAD_BYTES`].
///
/// # Errors
/// Fails as [`check_pcd_file`].
pub(in crate::dataset) fn check_pcd(head: &[u8], length: u64, path: &Path) -> Result<u64, FileError> {
    let header = parse_header(head, path)?;
    header.end(head, length, path)?;
    Ok(header.points as u64)
}

/// Reads a PCD file of any encoding. Drops and counts points with a NaN or infinite coordinate.
///
/// # Errors
/// Fails if the file is missing or truncated, its header lacks `x y z` as floats, or sizes in the header
/// contradict each other. Fails if no point has finite coordinates, or all are at the origin.
pub fn read_pcd_file(path: &Path) -> Result<Sweep, FileError> {
    let bytes = read_file(path, SWEEP_BYTES)?;
    parse_pcd(&bytes, path)
}

/// Parses the bytes of a PCD file; `path` is for messages.
///
/// # Errors
/// Fails as [`read_pcd_file`].
pub fn parse_pcd(bytes: &[u8], path: &Path) -> Result<Sweep, FileError> {
    pcd_rows(bytes, |_| None, path)?.finish(RingMeaning::Auto, path)
}

/// Returns the points of a PCD file. `source` returns the LiDAR of a row if it is known from elsewhere.
///
/// # Errors
/// Fails as [`read_pcd_file`], except that points may be missing.
pub(in crate::dataset) fn pcd_rows(
    bytes: &[u8],
    source: impl Fn(usize) -> Option<u16>,
    path: &Path,
) -> Result<SweepRows, FileError> {
    let header = parse_header(bytes, path)?;
    let end = header.end(bytes, bytes.len() as u64, path)?;
    let points = header.points(bytes, end, path)?;
    let mut sweep = SweepRows::with_capacity(header.points);
    for row in 0..header.points {
        let number = |field: Field| points.number(field, row);
        let or_zero = |field: Option<Field>| field.map_or(0.0, number);
        let values = SweepRow {
            position: header.position.map(|field| number(field) as f32),
            intensity: or_zero(header.intensity) as f32,
            ring: or_zero(header.ring),
            device: header.device.map(number),
        };
        sweep.push_of(values, source(row));
    }
    for name in header.unread {
        sweep.note(&format!("sweeps whose {name} is not a single number of a known type (not read)"));
    }
    Ok(sweep)
}

fn parse_header(bytes: &[u8], path: &Path) -> Result<Header, FileError> {
    Header::parse(&bytes[..bytes.len().min(MAX_HEADER_BYTES as usize)], path)
}

/// Decoded points.
enum Points<'a> {
    /// Rows of a stride in bytes.
    Rows(&'a [u8], usize),
    /// Columns for this many points.
    Columns(Vec<u8>, usize),
    /// Rows of this many numbers.
    Numbers(Vec<f64>, usize),
}

impl Points<'_> {
    /// Returns the value of a point's field.
    fn number(&self, field: Field, row: usize) -> f64 {
        match self {
            Self::Rows(bytes, stride) => field.number(bytes, row * stride + field.offset),
            Self::Columns(bytes, points) => field.number(bytes, field.offset * points + row * field.size()),
            Self::Numbers(numbers, width) => numbers[row * width + field.index],
        }
    }
}

impl Header {
    /// Returns the end of the points in a file of `length` bytes, or an error if it is shorter. `head` holds
    /// the header and the lengths of compressed points.
    fn end(&self, head: &[u8], length: u64, path: &Path) -> Result<usize, FileError> {
        let (points, stride) = (self.points, self.stride);
        let (bytes, expected) = match self.encoding {
            Encoding::Binary => (points.checked_mul(stride), format!("{points} points of {stride} bytes")),
            Encoding::Compressed => {
                let lengths = head.get(self.start..).and_then(|rest| rest.first_chunk::<LENGTHS>());
                let [packed, plain] = lengths.map_or([0, 0], |bytes| {
                    let (words, _) = bytes.as_chunks::<4>();
                    [words[0], words[1]].map(|word| u32::from_le_bytes(word) as usize)
                });
                if plain as u64 > SWEEP_BYTES {
                    let expected = format!("at most {SWEEP_BYTES} bytes in compressed data");
                    return Err(FileError::content(expected, format!("{plain} bytes"), path));
                }
                if lengths.is_some() && points.checked_mul(stride) != Some(plain) {
                    let expected = format!("{points} points of {stride} bytes in compressed data");
                    return Err(FileError::content(expected, format!("{plain} bytes"), path));
                }
                (packed.checked_add(LENGTHS), format!("{packed} bytes of compressed points"))
            }
            // A digit and a separator each; the last separator may be missing.
            Encoding::Ascii => {
                let bytes = points.checked_mul(2 * self.numbers).map(|bytes| bytes.saturating_sub(1));
                (bytes, format!("{points} lines of {} numbers", self.numbers))
            }
        };
        let end = bytes.and_then(|bytes| bytes.checked_add(self.start));
        end.filter(|end| *end as u64 <= length).ok_or_else(|| {
            let found = format!("{} bytes (truncated)", length.saturating_sub(self.start as u64));
            FileError::content(format!("{expected} after the header"), found, path)
        })
    }

    /// Decodes the points, which end at `end` unless they are text.
    fn points<'a>(&self, bytes: &'a [u8], end: usize, path: &Path) -> Result<Points<'a>, FileError> {
        match self.encoding {
            Encoding::Binary => Ok(Points::Rows(&bytes[self.start..end], self.stride)),
            Encoding::Compressed => {
                let plain = decompress(&bytes[self.start + LENGTHS..end], self.points * self.stride);
                let damaged = || FileError::content("points compressed by LZF", "damaged data", path);
                Ok(Points::Columns(plain.ok_or_else(damaged)?, self.points))
            }
            Encoding::Ascii => Ok(Points::Numbers(self.text(&bytes[self.start..], path)?, self.numbers)),
        }
    }

    /// Parses lines of numbers.
    fn text(&self, bytes: &[u8], path: &Path) -> Result<Vec<f64>, FileError> {
        let mut numbers = Vec::with_capacity(self.points * self.numbers);
        let mut lines = bytes.split(|byte| *byte == b'\n').map(<[u8]>::trim_ascii).filter(|l| !l.is_empty());
        for row in 0..self.points {
            let line = str::from_utf8(lines.next().unwrap_or_default()).unwrap_or_default();
            let before = numbers.len();
            let number = |word: &str| not_finite(word).or_else(|| word.parse().ok());
            numbers.extend(line.split_ascii_whitespace().map_while(number));
            if numbers.len() != before + self.numbers || line.split_ascii_whitespace().count() != self.numbers
            {
                let expected = format!("{} numbers as point {row}", self.numbers);
                let shown: String = line.chars().take(60).collect();
                return Err(FileError::content(expected, format!("{shown:?}"), path));
            }
        }
        Ok(numbers)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::SweepPoint;
    use proptest::prelude::*;

    const HEADER: &str = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity lidar_info ring\nSIZE 4 4 4 1 1 \
        1\n\
        TYPE F F F U U U\nCOUNT 1 1 1 1 1 1\nWIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA \
        binary\n";

    /// Two points in the layout above.
    fn file() -> Vec<u8> {
        let mut bytes = HEADER.as_bytes().to_vec();
        for (position, rest) in [([1.5_f32, -2.0, 0.25], [200, 0, 63]), ([3.0, 4.0, 5.0], [7, 4, 0])] {
            bytes.extend(position.map(f32::to_le_bytes).as_flattened());
            bytes.extend(rest);
        }
        bytes
    }

    fn parse(bytes: &[u8]) -> Result<Sweep, FileError> {
        parse_pcd(bytes, Path::new("a.pcd"))
    }

    /// The file with some header text replaced.
    fn changed(from: &str, to: &str) -> Vec<u8> {
        assert!(HEADER.contains(from));
        [HEADER.replace(from, to).as_bytes(), &file()[HEADER.len()..]].concat()
    }

    #[track_caller]
    fn refused(bytes: &[u8], expected: &str, found: &str) {
        let message = parse(bytes).unwrap_err().to_string();
        assert_eq!(message, format!("expected {expected}, found {found}: a.pcd"));
    }

    #[test]
    fn merged_points_are_numbered_by_device() {
        let sweep = parse(&file()).unwrap();
        let point = |position, intensity, ring| SweepPoint { position, intensity, ring };
        assert_eq!(sweep.points, [point([1.5, -2.0, 0.25], 200.0, 0), point([3.0, 4.0, 5.0], 7.0, 4)]);
        assert!(sweep.devices);
    }

    #[test]
    fn a_single_device_keeps_its_rings() {
        let mut bytes = file();
        let device = HEADER.len() + 2 * 15 - 2;
        assert_eq!(std::mem::replace(&mut bytes[device], 0), 4);
        let sweep = parse(&bytes).unwrap();
        assert_eq!((sweep.devices, sweep.points[0].ring, sweep.points[1].ring), (false, 63, 0));
    }

    #[test]
    fn other_fields_are_skipped_and_counts_are_optional() {
        let header = "FIELDS pad z y x time\nSIZE 2 4 4 4 8\nTYPE U F F F F\nCOUNT 3 1 1 1 1\nWIDTH \
            1\nHEIGHT 1\nDATA binary\n";
        let values = [&[9; 6], [3.0_f32, 2.0, 1.0].map(f32::to_le_bytes).as_flattened(), &[9; 8]].concat();
        let sweep = parse(&[header.as_bytes(), &values].concat()).unwrap();
        assert_eq!(sweep.points, [SweepPoint { position: [1.0, 2.0, 3.0], ..SweepPoint::default() }]);
        assert_eq!(parse(&changed("COUNT 1 1 1 1 1 1\n", "")).unwrap().points.len(), 2);
    }

    #[test]
    fn bytes_after_the_points_are_ignored() {
        for behind in [vec![0; 4000], vec![0, 8], vec![0xff; 15], file()] {
            assert_eq!(parse(&[file(), behind].concat()).unwrap(), parse(&file()).unwrap());
        }
    }

    #[test]
    fn non_finite_points_are_dropped_and_counted() {
        let mut bytes = file();
        bytes[HEADER.len()..HEADER.len() + 4].copy_from_slice(&f32::NAN.to_le_bytes());
        let sweep = parse(&bytes).unwrap();
        assert_eq!((sweep.points.len(), sweep.dropped_non_finite), (1, 1));
    }

    #[test]
    fn rejects_truncated_files() {
        let whole = file();
        for cut in 0..whole.len() {
            assert!(parse(&whole[..cut]).is_err(), "{cut}");
        }
        refused(&whole[..whole.len() - 1], "2 points of 15 bytes after the header", "29 bytes (truncated)");
        refused(&[], "a PCD header that ends with DATA", "an empty file");
        let huge = usize::MAX.to_string();
        let huge = changed("WIDTH 2", &format!("WIDTH {huge}"));
        refused(&huge, &format!("WIDTH times HEIGHT, {} points", usize::MAX), "POINTS 2");
    }

    #[test]
    fn rejects_other_layouts() {
        let layout =
            "FIELDS x y z intensity lidar_info ring, SIZE 4 4 4 1 1 1, TYPE F F F U U U, COUNT 1 1 1 1 1 1";
        let bytes = changed("TYPE F F F", "TYPE F U F");
        refused(
            &bytes,
            "y as a single float of 4 or 8 bytes (F)",
            &layout.replace("TYPE F F F", "TYPE F U F"),
        );
        let bytes = changed("FIELDS x", "FIELDS u");
        refused(&bytes, "x as a single float of 4 or 8 bytes (F)", &layout.replace("FIELDS x", "FIELDS u"));
        let bytes = changed("SIZE 4 4 4 1 1 1", "SIZE 4 4 4 1 1");
        let found = layout.replace("SIZE 4 4 4 1 1 1", "SIZE 4 4 4 1 1");
        refused(&bytes, "SIZE, TYPE and COUNT for every field", &found);
        let other = changed("DATA binary", "DATA zipped");
        refused(&other, "DATA binary, binary_compressed or ascii", "\"DATA zipped\"");
        refused(&changed("WIDTH 2", "WIDTH -2"), "a whole number as WIDTH", "\"-2\"");
        refused(&changed("POINTS 2", "POINTS 3"), "WIDTH times HEIGHT, 2 points", "POINTS 3");
        refused(b"\x89PNG\r\n\x1a\n", "a PCD header that ends with DATA", "a PNG image");
    }

    /// The file with its points as text.
    fn ascii() -> String {
        HEADER.replace("DATA binary", "DATA ascii") + "1.5 -2 0.25 200 0 63\n3 4 5e0 7 4 0"
    }

    /// The file with its points compressed: columns, as literals of LZF.
    fn compressed() -> Vec<u8> {
        let file = file();
        let rows: Vec<&[u8]> = file[HEADER.len()..].chunks_exact(15).collect();
        let fields = [(0, 4), (4, 4), (8, 4), (12, 1), (13, 1), (14, 1)];
        let columns =
            fields.iter().flat_map(|(at, size)| rows.iter().flat_map(move |row| &row[*at..at + size]));
        let mut packed = vec![29];
        packed.extend(columns);
        let lengths = [packed.len() as u32, 30].map(u32::to_le_bytes);
        let head = HEADER.replace("DATA binary", "DATA binary_compressed");
        [head.as_bytes(), lengths.as_flattened(), &packed].concat()
    }

    #[test]
    fn all_encodings_have_the_same_points() {
        assert_eq!(parse(ascii().as_bytes()).unwrap(), parse(&file()).unwrap());
        assert_eq!(parse(ascii().replace('\n', "\r\n").as_bytes()).unwrap(), parse(&file()).unwrap());
        assert_eq!(parse(&compressed()).unwrap(), parse(&file()).unwrap());
        for word in ["nan", "-nan", "NaN", "-nan(ind)", "nan(snan)", "-1.#IND", "1.#QNAN", "1.#INF00", "-inf"]
        {
            let nan = ascii().replace("1.5 -2", &format!("{word} -2"));
            assert_eq!(parse(nan.as_bytes()).unwrap().dropped_non_finite, 1, "{word}");
        }
    }

    /// Letters of names and encodings are upper or lower case, and coordinates have 4 or 8 bytes.
    #[test]
    fn names_and_widths_vary() {
        let text = ascii().replace("x y z intensity lidar_info ring", "X Y Z Intensity LIDAR_INFO Ring");
        let text = text.replace("DATA ascii", "DATA ASCII");
        assert_eq!(parse(text.as_bytes()).unwrap(), parse(&file()).unwrap());
        let wide = HEADER.replace("SIZE 4 4 4", "SIZE 8 8 8");
        let points = file()[HEADER.len()..].to_vec();
        let row = |row: &[u8]| {
            let position = row[..12].as_chunks::<4>().0.iter().map(|b| f64::from(f32::from_le_bytes(*b)));
            [position.flat_map(f64::to_le_bytes).collect::<Vec<u8>>(), row[12..].to_vec()].concat()
        };
        let rows: Vec<u8> = points.chunks_exact(15).flat_map(row).collect();
        assert_eq!(parse(&[wide.as_bytes(), &rows].concat()).unwrap(), parse(&file()).unwrap());
    }

    #[test]
    fn types_are_upper_or_lower_case() {
        let changed = changed("TYPE F F F U U U", "TYPE f f f u u u");
        assert_eq!(parse(&changed).unwrap(), parse(&file()).unwrap());
    }

    #[test]
    fn fields_that_cannot_be_read_are_noted() {
        let note =
            |name: &str| format!("sweeps whose {name} is not a single number of a known type (not read)");
        assert!(parse(&file()).unwrap().notes.keys().all(|note| !note.contains("not read")));
        let sweep = parse(&changed("TYPE F F F U U U", "TYPE F F F X U F")).unwrap();
        assert_eq!((sweep.notes[&note("intensity")], sweep.notes[&note("ring")]), (1, 1));
        assert!(sweep.points.iter().all(|point| point.intensity == 0.0) && sweep.devices);
        // An array takes the place of several numbers.
        let header = "FIELDS x y z lidar_info\nSIZE 4 4 4 1\nTYPE F F F U\nCOUNT 1 1 1 2\nWIDTH 1\nHEIGHT \
            1\nDATA ascii\n";
        let sweep = parse(format!("{header}1 2 3 4 5\n").as_bytes()).unwrap();
        assert_eq!((sweep.points[0].position, sweep.notes[&note("lidar_info")]), ([1.0, 2.0, 3.0], 1));
    }

    #[test]
    fn damaged_encodings_are_refused() {
        refused(ascii().replace("7 4 0", "7 4").as_bytes(), "6 numbers as point 1", "\"3 4 5e0 7 4\"");
        refused(ascii().replace("5e0", "five").as_bytes(), "6 numbers as point 1", "\"3 4 five 7 4 0\"");
        let whole = compressed();
        for cut in 0..whole.len() {
            assert!(parse(&whole[..cut]).is_err(), "{cut}");
        }
        let huge = ascii().replace("WIDTH 2", "WIDTH 9000000").replace("POINTS 2", "POINTS 9000000");
        assert!(parse(huge.as_bytes()).unwrap_err().to_string().contains("(truncated)"));
        let mut bytes = whole;
        let start = bytes.len() - 31;
        bytes[start] = 255;
        refused(&bytes, "points compressed by LZF", "damaged data");
    }

    /// Fields of truck LiDARs: times of 8 bytes, and padding.
    #[test]
    fn times_and_padding_are_skipped() {
        let header = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z _ intensity timestamp\nSIZE 4 4 4 1 4 8\nTYPE F \
            F F U F U\n\
            COUNT 1 1 1 4 1 1\nWIDTH 1\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 1\nDATA binary\n";
        let position = [1.0_f32, 2.0, 3.0].map(f32::to_le_bytes);
        let rest = [&[9; 4], &0.5_f32.to_le_bytes()[..], &1_692_868_171_700_983_u64.to_le_bytes()].concat();
        let sweep = parse(&[header.as_bytes(), position.as_flattened(), &rest].concat()).unwrap();
        assert_eq!(sweep.points, [SweepPoint { position: [1.0, 2.0, 3.0], intensity: 0.5, ring: 0 }]);
    }

    /// Python's libraries write integers of 8 bytes.
    #[test]
    fn integers_have_up_to_8_bytes() {
        for kind in ["U", "I"] {
            let header = format!(
                "FIELDS x y z intensity ring\nSIZE 4 4 4 8 8\nTYPE F F F {kind} {kind}\nWIDTH 1\nHEIGHT \
                    1\nDATA binary\n"
            );
            let values = [200_u64, 31].map(u64::to_le_bytes);
            let position = [1.0_f32, 2.0, 3.0].map(f32::to_le_bytes);
            let bytes = [header.as_bytes(), position.as_flattened(), values.as_flattened()].concat();
            let point = SweepPoint { position: [1.0, 2.0, 3.0], intensity: 200.0, ring: 31 };
            assert_eq!(parse(&bytes).unwrap().points, [point], "{kind}");
        }
    }

    #[test]
    fn a_check_counts_without_reading_points() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.pcd");
        std::fs::write(&path, file()).unwrap();
        assert_eq!(check_pcd_file(&path).unwrap(), 2);
        std::fs::write(&path, &file()[..HEADER.len() + 20]).unwrap();
        assert!(check_pcd_file(&path).unwrap_err().to_string().contains("20 bytes (truncated)"));
        std::fs::write(&path, compressed()).unwrap();
        assert_eq!(check_pcd_file(&path).unwrap(), 2);
        std::fs::write(&path, ascii()).unwrap();
        assert_eq!(check_pcd_file(&path).unwrap(), 2);
    }

    proptest! {
        #[test]
        fn any_bytes_are_points_or_an_error(
            places in proptest::collection::vec((0..HEADER.len() + 30, any::<u8>()), 0..6)
        ) {
            let mut bytes = file();
            places.into_iter().for_each(|(at, to)| bytes[at] = to);
            match parse(&bytes) {
                Ok(sweep) => prop_assert!(sweep.points.len() + sweep.dropped_non_finite <= 30),
                Err(e) => prop_assert!(e.to_string().ends_with(": a.pcd")),
            }
        }
    }
}
