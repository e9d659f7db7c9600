//! Headers of NPY files, which are validated before they are parsed.

use std::io::Read;
use std::path::Path;

use npyz::{NpyHeader, Order};

use crate::error::FileError;
use crate::files::sniff;

/// Maximum header length in bytes, as in NumPy.
const MAX_HEADER_BYTES: usize = 10_000;
/// Bytes before the text of a header: magic, version, and length.
const FIXED_BYTES: usize = 10;

/// Reads the header of a file with `file_bytes` bytes. Also returns its length in bytes.
///
/// # Errors
/// Fails if the file is no NPY file, or its header does not describe a plain array.
pub(super) fn read_header(
    reader: &mut impl Read,
    file_bytes: u64,
    path: &Path,
) -> Result<(NpyHeader, u64), FileError> {
    let bytes = read_bytes(reader, file_bytes, path)?;
    let header = NpyHeader::from_reader(bytes.as_slice())
        .map_err(|error| FileError::content("an NPY header", error.to_string(), path))?;
    Ok((header, bytes.len() as u64))
}

/// Checks that an array is stored row by row.
///
/// # Errors
/// Fails if it is not.
pub(super) fn check_order(header: &NpyHeader, path: &Path) -> Result<(), FileError> {
    match header.order() {
        Order::C => Ok(()),
        Order::Fortran => Err(FileError::content("C order", "Fortran order", path)),
    }
}

/// Reads the magic, version, length and text of the header. Rejects any text whose parsing could exhaust
/// memory or the stack.
fn read_bytes(reader: &mut impl Read, file_bytes: u64, path: &Path) -> Result<Vec<u8>, FileError> {
    let no_npy = |found: &str| FileError::content("an NPY file", found, path);
    let mut bytes = Vec::new();
    reader.by_ref().take(FIXED_BYTES as u64).read_to_end(&mut bytes).map_err(FileError::io("read", path))?;
    if !bytes.starts_with(b"\x93NUMPY") {
        let rest = reader.by_ref().take(sniff::HEAD_BYTES as u64).read_to_end(&mut bytes);
        rest.map_err(FileError::io("read", path))?;
        return Err(no_npy(&sniff::described(&bytes).unwrap_or_else(|| "other content".to_owned())));
    }
    let cut = || no_npy(&format!("{file_bytes} bytes (cut off)"));
    let fixed: [u8; FIXED_BYTES] = bytes.as_slice().try_into().map_err(|_| cut())?;
    let mut text_len = usize::from(u16::from_le_bytes([fixed[8], fixed[9]]));
    if fixed[6] > 1 {
        let mut high = [0; 2];
        reader.read_exact(&mut high).map_err(|_| cut())?;
        bytes.extend(high);
        text_len |= usize::from(u16::from_le_bytes(high)) << 16;
    }
    let most = MAX_HEADER_BYTES.min(file_bytes.saturating_sub(bytes.len() as u64) as usize);
    if text_len > most {
        let expected = format!("an NPY header of at most {most} bytes");
        return Err(FileError::content(expected, text_len.to_string(), path));
    }
    let start = bytes.len();
    bytes.resize(start + text_len, 0);
    reader.read_exact(&mut bytes[start..]).map_err(FileError::io("read", path))?;
    if !is_plain(&bytes[start..]) {
        let expected = "an NPY header that describes a plain array";
        return Err(FileError::content(expected, "something else", path));
    }
    Ok(bytes)
}

/// Returns whether a header text is a plain one, as numeric arrays have. Nesting is limited, and the number
/// of (decimal) digits is so small that no product of the numbers can overflow 64 bits.
fn is_plain(text: &[u8]) -> bool {
    let count = |wanted: &dyn Fn(u8) -> bool| text.iter().filter(|b| wanted(**b)).count();
    let prefixed = |w: &[u8]| w[0] == b'0' && matches!(w[1].to_ascii_lowercase(), b'x' | b'o' | b'b');
    text.is_ascii()
        && !text.contains(&b'\\')
        && count(&|b| matches!(b, b'(' | b'[' | b'{')) <= 16
        && nesting(text) <= 3
        && count(&|b| b.is_ascii_digit()) <= 19
        && !text.windows(2).any(prefixed)
}

/// Maximum nesting depth of brackets. Parsing time doubles with each level.
fn nesting(text: &[u8]) -> usize {
    let (mut depth, mut deepest) = (0_usize, 0);
    for byte in text {
        match byte {
            b'(' | b'[' | b'{' => depth += 1,
            b')' | b']' | b'}' => depth = depth.saturating_sub(1),
            _ => {}
        }
        deepest = deepest.max(depth);
    }
    deepest
}
