//! NPY point clouds `P.npy`: floats `[N, 6]` (x y z r g b) or `[N, 7]` (class last), C order.
//!
//! # How it works
//! The declared size of the header is validated against the file, and its text against the syntax of a plain
//! array, before parsing (`npy_header`). The data size is validated against the file before anything is
//! allocated. Rows are read in blocks.

use std::io::{BufReader, Read, Seek, SeekFrom, Write};
use std::path::Path;

use npyz::{NpyHeader, Order, WriterBuilder};

use super::colors::ColorValues;
use super::npy_header::{check_order, read_header};
use super::rows::{Row, RowFormat, collect};
use super::{Point, PointFile};
use crate::error::FileError;
use crate::files::input::open_regular;
use crate::files::write_whole;

/// Rows per block.
const BLOCK_ROWS: usize = 1 << 16;

/// Reads a cloud of `f16`, `f32` or `f64` (little-endian). Rounds colors to the nearest level; colors of 0 to
/// 1 are scaled if some are fractions. The class is 0 without column 7.
///
/// # Errors
/// Fails if the file cannot be read, its dtype, shape or order is unsupported, it has no points, or data is
/// missing. Fails if a color is outside 0–255 or a class is not an integer of 0–255.
pub fn read(path: &Path) -> Result<PointFile, FileError> {
    let (file, file_bytes) = open_regular(path)?;
    decode(BufReader::with_capacity(1 << 20, file), file_bytes, path)
}

/// Parses an array `[N, COLUMNS]` of `f16`, `f32` or `f64` in either order.
///
/// # Errors
/// Fails if the bytes are no NPY file of such an array; `path` is the file in messages.
pub fn rows<const COLUMNS: usize>(bytes: &[u8], path: &Path) -> Result<Vec<[f64; COLUMNS]>, FileError> {
    let wrong = |found: String| {
        FileError::content(format!("an array of <f2, <f4 or <f8 [N, {COLUMNS}]"), found, path)
    };
    let mut data = bytes;
    let (header, _) = read_header(&mut data, bytes.len() as u64, path)?;
    let (kind, shape) = (header.dtype().descr(), header.shape());
    let (Some(scalar), &[count, columns]) = (Scalar::from_descr(&kind), shape) else {
        return Err(wrong(format!("{kind} {shape:?}")));
    };
    if columns != COLUMNS as u64 {
        return Err(wrong(format!("{kind} {shape:?}")));
    }
    let needed = count.saturating_mul((COLUMNS * scalar.bytes()) as u64);
    if needed != data.len() as u64 {
        return Err(FileError::content(format!("{needed} bytes of data"), data.len().to_string(), path));
    }
    let mut numbers = Vec::new();
    scalar.widen(data, &mut numbers);
    let count = numbers.len() / COLUMNS;
    let number = |row: usize, column: usize| match header.order() {
        Order::C => numbers[COLUMNS * row + column],
        Order::Fortran => numbers[column * count + row],
    };
    Ok((0..count).map(|row| std::array::from_fn(|column| number(row, column))).collect())
}

/// Number type of the array.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Scalar {
    F16,
    F32,
    F64,
}

impl Scalar {
    fn from_descr(descr: &str) -> Option<Self> {
        match descr {
            "'<f2'" => Some(Self::F16),
            "'<f4'" => Some(Self::F32),
            "'<f8'" => Some(Self::F64),
            _ => None,
        }
    }

    fn bytes(self) -> usize {
        match self {
            Self::F16 => 2,
            Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Converts all numbers of a block to `f64`.
    fn widen(self, block: &[u8], into: &mut Vec<f64>) {
        into.clear();
        match self {
            Self::F16 => into.extend(chunks(block).map(|b| half::f16::from_le_bytes(b).to_f64())),
            Self::F32 => into.extend(chunks(block).map(|b| f64::from(f32::from_le_bytes(b)))),
            Self::F64 => into.extend(chunks(block).map(f64::from_le_bytes)),
        }
    }
}

fn chunks<const N: usize>(block: &[u8]) -> impl Iterator<Item = [u8; N]> {
    block.as_chunks::<N>().0.iter().copied()
}

fn decode(mut reader: impl Read + Seek, file_bytes: u64, path: &Path) -> Result<PointFile, FileError> {
    let (header, header_bytes) = read_header(&mut reader, file_bytes, path)?;
    let (scalar, rows, columns) = check_header(&header, path)?;
    let row_bytes = columns * scalar.bytes();
    let data_bytes = file_bytes.saturating_sub(header_bytes);
    if rows.checked_mul(row_bytes as u64).is_none_or(|needed| needed > data_bytes) {
        let expected = format!("{rows} rows of {row_bytes} bytes");
        return Err(FileError::content(expected, format!("{data_bytes} bytes of data"), path));
    }
    let rows = rows as usize;
    let format = RowFormat { rows, double: scalar == Scalar::F64, colors: ColorValues::Levels, path };
    let mut block = vec![0; BLOCK_ROWS.min(rows) * row_bytes];
    let mut numbers = Vec::new();
    collect(&format, |visit| {
        reader.seek(SeekFrom::Start(header_bytes)).map_err(FileError::io("read", path))?;
        let mut left = rows;
        while left > 0 {
            let take = left.min(BLOCK_ROWS);
            let bytes = &mut block[..take * row_bytes];
            reader.read_exact(bytes).map_err(FileError::io("read", path))?;
            scalar.widen(bytes, &mut numbers);
            for n in numbers.chunks_exact(columns) {
                let class = n.get(6).copied().unwrap_or(0.0);
                if !visit(&Row { position: [n[0], n[1], n[2]], rgb: [n[3], n[4], n[5]], class })? {
                    return Ok(());
                }
            }
            left -= take;
        }
        Ok(())
    })
}

/// Validates the header and returns the number type, rows and columns.
fn check_header(header: &NpyHeader, path: &Path) -> Result<(Scalar, u64, usize), FileError> {
    let descr = header.dtype().descr();
    let scalar = Scalar::from_descr(&descr)
        .ok_or_else(|| FileError::content("dtype <f2, <f4 or <f8", format!("dtype {descr}"), path))?;
    let (rows, columns) = match *header.shape() {
        [rows, columns @ (6 | 7)] => (rows, columns as usize),
        _ => {
            let found = format!("shape {:?}", header.shape());
            return Err(FileError::content("shape [N, 6] or [N, 7]", found, path));
        }
    };
    check_order(header, path)?;
    if rows == 0 || rows > u64::from(u32::MAX) - 1 {
        return Err(FileError::content("1 to 4294967294 points", rows.to_string(), path));
    }
    Ok((scalar, rows, columns))
}

/// Writes points as `f32` `[N, 6]`, or `[N, 7]` with the class last.
///
/// # Errors
/// Fails if the file cannot be written.
pub fn write(path: &Path, points: &[Point], with_class: bool) -> Result<(), FileError> {
    let columns = if with_class { 7 } else { 6 };
    write_whole(path, |out| {
        let shape = [points.len() as u64, columns as u64];
        write_header::<f32>(out, &shape).map_err(FileError::io("write", path))?;
        for point in points {
            let [x, y, z] = point.position;
            let [r, g, b] = point.rgb().map(f32::from);
            let row = [x, y, z, r, g, b, f32::from(point.class())].map(f32::to_le_bytes);
            out.write_all(row[..columns].as_flattened()).map_err(FileError::io("write", path))?;
        }
        Ok(())
    })
}

/// Encodes an array `[height, width]` of `u16`, C order.
///
/// # Errors
/// Never fails in practice: the header is written to memory.
pub fn encode_u16(samples: &[u16], [height, width]: [u32; 2]) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    write_header::<u16>(&mut bytes, &[height.into(), width.into()])?;
    samples.iter().for_each(|sample| bytes.extend(sample.to_le_bytes()));
    Ok(bytes)
}

/// Writes the header of a C-order array; the caller writes the data.
pub(crate) fn write_header<T: npyz::AutoSerialize>(
    out: &mut impl Write,
    shape: &[u64],
) -> std::io::Result<()> {
    let options = npyz::WriteOptions::new_header_only().dtype(T::default_dtype()).shape(shape);
    options.writer(out).write_header_only().map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Returns an array in NumPy's format.
    fn array(descr: &str, fortran: bool, shape: &str, data: &[u8]) -> Vec<u8> {
        let order = if fortran { "True" } else { "False" };
        let mut text = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}");
        while (10 + text.len() + 1) % 64 != 0 {
            text.push(' ');
        }
        text.push('\n');
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((text.len() as u16).to_le_bytes());
        bytes.extend(text.as_bytes());
        bytes.extend(data);
        bytes
    }

    fn parse(bytes: &[u8]) -> Result<PointFile, FileError> {
        decode(std::io::Cursor::new(bytes), bytes.len() as u64, Path::new("p.npy"))
    }

    fn f32s(values: &[f32]) -> Vec<u8> {
        values.iter().flat_map(|v| v.to_le_bytes()).collect()
    }

    const ROW: [f32; 7] = [1.5, -2.5, 3.0, 10.0, 20.0, 30.0, 2.0];

    #[test]
    fn all_float_types_read_the_same() {
        let f16: Vec<u8> = ROW.iter().flat_map(|v| half::f16::from_f32(*v).to_le_bytes()).collect();
        let f64: Vec<u8> = ROW.iter().flat_map(|v| f64::from(*v).to_le_bytes()).collect();
        let expected = [Point::new([1.5, -2.5, 3.0], [10, 20, 30], 2)];
        for (descr, data) in [("<f2", f16), ("<f4", f32s(&ROW)), ("<f8", f64)] {
            assert_eq!(parse(&array(descr, false, "(1, 7)", &data)).unwrap().points, expected, "{descr}");
        }
        let six = parse(&array("<f4", false, "(1, 6)", &f32s(&ROW[..6]))).unwrap();
        assert_eq!(six.points[0].class(), 0);
    }

    #[test]
    fn errors_state_the_expected_content() {
        let data = f32s(&ROW);
        for (bytes, message) in [
            (array("<i4", false, "(1, 7)", &data), "dtype <f2, <f4 or <f8, found dtype '<i4'"),
            (array(">f4", false, "(1, 7)", &data), "found dtype '>f4'"),
            (array("<f4", false, "(1, 5)", &data), "shape [N, 6] or [N, 7], found shape [1, 5]"),
            (array("<f4", false, "(7,)", &data), "found shape [7]"),
            (array("<f4", true, "(1, 7)", &data), "C order, found Fortran order"),
            (array("<f4", false, "(0, 7)", &data), "1 to 4294967294 points, found 0"),
            (array("<f4", false, "(2, 7)", &data), "2 rows of 28 bytes, found 28 bytes of data"),
            (array("<f4", false, "(4000000000, 7)", &data), "found 28 bytes of data"),
            (array("<f4", false, "(99999999999999999999999, 7)", &data), "a plain array"),
            (array("<f4", false, &"(".repeat(5000), &data), "a plain array"),
            (array("<f4", false, &"{".repeat(14), &data), "a plain array"),
            (b"PK\x03\x04 and so on".to_vec(), "an NPY file, found a ZIP archive (unpack it)"),
            (b"404: Not Found".to_vec(), "an NPY file, found text that begins with \"404: Not Found\""),
            (vec![1, 2, 3], "an NPY file, found other content"),
            (b"\x93NUMPY\x01".to_vec(), "an NPY file, found 7 bytes (cut off)"),
            (Vec::new(), "an NPY file, found an empty file"),
            (b"\x93NUMPY\x02\x00\xff\xff\xff\xff{}".to_vec(), "header of at most 2 bytes, found 4294967295"),
        ] {
            let found = parse(&bytes).unwrap_err().to_string();
            assert!(found.contains(message) && found.ends_with("p.npy"), "{found}, expected {message}");
        }
    }

    #[test]
    fn written_points_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.npy");
        let points: Vec<Point> =
            (0..100).map(|i: u8| Point::new([f32::from(i), 0.5, -1.0], [i, 2 * i, 255 - i], i % 5)).collect();
        write(&path, &points, true).unwrap();
        assert_eq!(read(&path).unwrap().points, points);
        write(&path, &points, false).unwrap();
        let without: Vec<Point> = points.iter().map(|p| Point::new(p.position, p.rgb(), 0)).collect();
        assert_eq!(read(&path).unwrap().points, without);
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300),
        npy in any::<bool>()) {
            let mut file = if npy { b"\x93NUMPY\x01\x00".to_vec() } else { Vec::new() };
            file.extend(bytes);
            let _ = parse(&file);
        }

        #[test]
        fn damaged_files_never_panic(at in 0..156_usize, byte in any::<u8>(), cut in 0..157_usize) {
            let mut file = array("<f4", false, "(1, 7)", &f32s(&ROW));
            file[at] = byte;
            file.truncate(cut);
            let _ = parse(&file);
        }

        #[test]
        fn arbitrary_headers_never_panic(shape in "[(]?[-0-9a-z,.()'\\[\\]{}: \
            ]{0,40}", descr in "[<>|=a-zA-Z0-9]{0,8}") {
            let _ = parse(&array(&descr, false, &shape, &f32s(&ROW)));
        }
    }
}
