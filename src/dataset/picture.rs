use std::io::Cursor;
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageReader, RgbImage};

use crate::error::FileError;

/// Reads a JPEG or PNG file of `height × width` pixels. The size in the header is compared before any pixel is
/// decoded.
///
/// # Errors
/// A file that is missing, does not decode, or has another size.
pub fn read_picture(path: &Path, height: u32, width: u32) -> Result<RgbImage, FileError> {
    let bytes = std::fs::read(path).map_err(FileError::io("read", path))?;
    let undecodable = |e: image::ImageError| FileError::content("a JPEG or PNG image", e.to_string(), path);
    let reader = ImageReader::new(Cursor::new(&bytes)).with_guessed_format();
    let reader = reader.map_err(FileError::io("read", path))?;
    let decoder = reader.into_decoder().map_err(undecodable)?;
    let (found_width, found_height) = decoder.dimensions();
    if (found_height, found_width) != (height, width) {
        let found = format!("{found_height}x{found_width}");
        return Err(FileError::content(format!("an image of {height}x{width} pixels"), found, path));
    }
    DynamicImage::from_decoder(decoder).map(DynamicImage::into_rgb8).map_err(undecodable)
}

/// Height and width as an image's header tells; nothing is decoded.
///
/// # Errors
/// A file that is missing or has no header of a JPEG or PNG image.
pub fn picture_size(path: &Path) -> Result<(u32, u32), FileError> {
    let reader = ImageReader::open(path).map_err(FileError::io("read", path))?;
    let reader = reader.with_guessed_format().map_err(FileError::io("read", path))?;
    let size = reader.into_dimensions();
    let (width, height) = size.map_err(|e| FileError::content("a JPEG or PNG image", e.to_string(), path))?;
    Ok((height, width))
}
