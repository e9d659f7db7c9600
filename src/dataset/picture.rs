use std::io::Cursor;
use std::path::Path;

use image::{ColorType, DynamicImage, ImageDecoder, ImageError, ImageReader, RgbImage};

use crate::error::FileError;
use crate::files::input::{IMAGE_BYTES, read_file};
use crate::files::sniff;
use crate::memory::{Need, reserve};

/// Images of recordings, for messages.
const IMAGE: &str = "a JPEG or PNG image";

/// Reads a JPEG or PNG file of `height × width` pixels. The size in the header is compared before pixels are
/// decoded.
///
/// # Errors
/// Fails if the file is missing, cannot be decoded, has another size, or is cut off.
pub fn read_picture(path: &Path, height: u32, width: u32) -> Result<RgbImage, FileError> {
    decode_picture(&read_file(path, IMAGE_BYTES)?, height, width, path)
}

/// Decodes a JPEG or PNG image as [`read_picture`]; `path` is for messages.
///
/// # Errors
/// Fails as [`read_picture`].
pub(super) fn decode_picture(
    bytes: &[u8],
    height: u32,
    width: u32,
    path: &Path,
) -> Result<RgbImage, FileError> {
    let undecodable = |error| undecodable(error, bytes, IMAGE, path);
    let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format();
    let reader = reader.map_err(FileError::io("read", path))?;
    let decoder = reader.into_decoder().map_err(undecodable)?;
    let (found_width, found_height) = decoder.dimensions();
    if (found_height, found_width) != (height, width) {
        let found = format!("{found_height}x{found_width}");
        return Err(FileError::content(format!("an image of {height}x{width} pixels"), found, path));
    }
    let bytes_needed =
        decoded_bytes(decoder.total_bytes(), decoder.color_type(), is_jpeg(bytes), height, width);
    let _pixels = reserve(bytes_needed, || Need {
        what: format!("an image of {height}x{width} pixels"),
        bytes: bytes_needed,
        advice: "RAYON_NUM_THREADS=1 decodes one image at a time",
    })
    .map_err(|error| FileError::io("decode", path)(error.into()))?;
    check_end(bytes, path)?;
    DynamicImage::from_decoder(decoder).map(DynamicImage::into_rgb8).map_err(undecodable)
}

/// Estimates the memory of decoding an image, bytes: the decoded pixels, their conversion to RGB, and
/// coefficients of a JPEG file.
fn decoded_bytes(decoded: u64, color: ColorType, is_jpeg: bool, height: u32, width: u32) -> u64 {
    let pixels = u64::from(height) * u64::from(width);
    let converted = if color == ColorType::Rgb8 { 0 } else { 3 * pixels };
    decoded + converted + if is_jpeg { 3 * size_of::<i16>() as u64 * pixels } else { 0 }
}

/// Describes an image file that cannot be decoded; `expected` is for the message.
pub fn undecodable(error: ImageError, bytes: &[u8], expected: &str, path: &Path) -> FileError {
    let found = match error {
        // The library's text, "The image format could not be determined", does not fit after "found".
        ImageError::Unsupported(_) => {
            sniff::described(bytes).unwrap_or_else(|| format!("another format ({} bytes)", bytes.len()))
        }
        _ if !is_whole(bytes) => cut_off(bytes),
        // Other libraries' texts hold names of their types, and end with a line break.
        error => {
            let text = error.to_string();
            let reason = text.lines().next().map(str::trim).filter(|line| !line.contains(['{', '\\']));
            let reason = reason.map_or_else(String::new, |line| format!(": {line}"));
            format!("damaged data ({} bytes{reason})", bytes.len())
        }
    };
    FileError::content(expected, found, path)
}

/// Checks that a file has its end: decoders silently fill the missing part of a JPEG file with gray.
fn check_end(bytes: &[u8], path: &Path) -> Result<(), FileError> {
    let kind = if is_jpeg(bytes) { "JPEG" } else { "PNG" };
    match is_whole(bytes) {
        true => Ok(()),
        false => Err(FileError::content(format!("a whole {kind} image"), cut_off(bytes), path)),
    }
}

/// Describes the file of an image without its end.
fn cut_off(bytes: &[u8]) -> String {
    format!("{} bytes without an end marker (cut off)", bytes.len())
}

/// Returns whether a JPEG or PNG file has its end; `true` for other files.
fn is_whole(bytes: &[u8]) -> bool {
    const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";
    if is_jpeg(bytes) {
        return has_jpeg_end(bytes);
    }
    !bytes.starts_with(PNG) || bytes.windows(4).rev().any(|name| name == b"IEND")
}

fn is_jpeg(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0xff, 0xd8])
}

/// Returns whether an end marker (`FF D9`) follows the last start of a scan (`FF DA`). Neither occurs within
/// a scan, where `FF` is followed by 0 or a restart marker. Thumbnails, which contain both, precede the scan.
fn has_jpeg_end(bytes: &[u8]) -> bool {
    let last = |code: u8| bytes.windows(2).rposition(|pair| pair == [0xff, code]);
    last(0xd9) > last(0xda)
}

/// Returns the height and width from an image header; no pixels are decoded.
///
/// # Errors
/// Fails if the file is missing, has no JPEG or PNG header, or is cut off.
pub fn picture_size(path: &Path) -> Result<(u32, u32), FileError> {
    // The JPEG decoder reads the whole file even for its header.
    encoded_size(&read_file(path, IMAGE_BYTES)?, path)
}

/// Returns the size from the header of a JPEG or PNG image as [`picture_size`]; `path` is for messages.
///
/// # Errors
/// Fails as [`picture_size`].
pub(super) fn encoded_size(bytes: &[u8], path: &Path) -> Result<(u32, u32), FileError> {
    let reader = ImageReader::new(Cursor::new(bytes));
    let reader = reader.with_guessed_format().map_err(FileError::io("read", path))?;
    let size = reader.into_dimensions();
    let (width, height) = size.map_err(|error| undecodable(error, bytes, IMAGE, path))?;
    check_end(bytes, path)?;
    Ok((height, width))
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::codecs::jpeg::JpegEncoder;

    /// Any truncation of the pixel data removes the end marker.
    #[test]
    fn rejects_truncated_files() {
        let folder = tempfile::tempdir().unwrap();
        let (jpeg, png) = (folder.path().join("a.jpg"), folder.path().join("a.png"));
        let image = RgbImage::from_fn(64, 48, |x, y| image::Rgb([4 * x as u8, 5 * y as u8, (x * y) as u8]));
        let mut bytes = Vec::new();
        JpegEncoder::new_with_quality(&mut bytes, 90).encode_image(&image).unwrap();
        std::fs::write(&jpeg, &bytes).unwrap();
        assert_eq!(read_picture(&jpeg, 48, 64).unwrap().dimensions(), (64, 48));
        // Bytes after the end, which some cameras write, are accepted.
        std::fs::write(&jpeg, [bytes.as_slice(), &[0; 9]].concat()).unwrap();
        assert!(read_picture(&jpeg, 48, 64).is_ok());
        for cut in (0..bytes.len()).step_by(41).chain(bytes.len() - 3..bytes.len()) {
            std::fs::write(&jpeg, &bytes[..cut]).unwrap();
            let errors = [read_picture(&jpeg, 48, 64).unwrap_err(), picture_size(&jpeg).unwrap_err()];
            for error in errors.map(|error| error.to_string()) {
                let found = if cut == 0 { "an empty file" } else { "(cut off)" };
                assert!(error.contains(found), "{cut} of {} bytes: {error}", bytes.len());
            }
        }
        image.save(&png).unwrap();
        let bytes = std::fs::read(&png).unwrap();
        std::fs::write(&png, &bytes[..bytes.len() - 40]).unwrap();
        for error in [read_picture(&png, 48, 64).unwrap_err(), picture_size(&png).unwrap_err()] {
            assert!(error.to_string().contains("(cut off): ") && error.to_string().ends_with("a.png"));
        }
    }

    #[test]
    fn messages_are_readable() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let zeros = [b"\x89PNG\r\n\x1a\n".as_slice(), &[0; 400]].concat();
        let ended = [zeros.as_slice(), b"IEND"].concat();
        let header = b"\xff\xd8\xff\xd9".to_vec();
        for (bytes, found) in [
            (zeros, "found 408 bytes without an end marker (cut off)"),
            (ended, "found damaged data (412 bytes"),
            (header, "found damaged data (4 bytes"),
        ] {
            std::fs::write(&path, bytes).unwrap();
            let error = picture_size(&path).unwrap_err().to_string();
            assert!(error.contains(found) && !error.contains(['{', '\\']), "{error}");
        }
    }
}
