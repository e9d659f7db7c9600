use std::io::Cursor;
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageError, ImageReader};
use point_skeleton::dataset::undecodable;
use point_skeleton::error::FileError;
use point_skeleton::files::input::{IMAGE_BYTES, read_file};
use point_skeleton::geometry::ImageSize;
use point_skeleton::memory::{Need, reserve};

/// Memory of a pixel to which masks are converted.
const RGB16_BYTES: u64 = 6;

/// Pixels in row-major order, and the image size.
pub(super) type Read<T> = (Vec<T>, ImageSize);

/// Reads and decodes an image file of any pixel format.
fn read(path: &Path) -> Result<DynamicImage, FileError> {
    let bytes = read_file(path, IMAGE_BYTES)?;
    let reader = ImageReader::new(Cursor::new(&bytes));
    let reader = reader.with_guessed_format().map_err(FileError::io("read", path))?;
    let wrong = |error: ImageError| undecodable(error, &bytes, "a PNG image", path);
    let decoder = reader.into_decoder().map_err(wrong)?;
    let (width, height) = decoder.dimensions();
    let taken = decoder.total_bytes() + RGB16_BYTES * u64::from(width) * u64::from(height);
    let _pixels = reserve(taken, || Need {
        what: format!("an image of {height}x{width} pixels"),
        bytes: taken,
        advice: "RAYON_NUM_THREADS=1 decodes one image at a time",
    })
    .map_err(|error| FileError::io("decode", path)(error.into()))?;
    DynamicImage::from_decoder(decoder).map_err(wrong)
}

fn size(image: &DynamicImage) -> ImageSize {
    ImageSize { height: image.height(), width: image.width() }
}

fn other(expected: &str, image: &DynamicImage, path: &Path) -> FileError {
    FileError::content(expected, format!("{:?}", image.color()), path)
}

/// Reads a class map: 8-bit grey.
pub(super) fn class(path: &Path) -> Result<Read<u8>, FileError> {
    match read(path)? {
        DynamicImage::ImageLuma8(image) => {
            let size = ImageSize { height: image.height(), width: image.width() };
            Ok((image.into_raw(), size))
        }
        image => Err(other("a class map of 8-bit grey", &image, path)),
    }
}

/// Reads an instance map: 16-bit grey.
pub(super) fn instance(path: &Path) -> Result<Read<u32>, FileError> {
    match read(path)? {
        DynamicImage::ImageLuma16(image) => {
            let size = ImageSize { height: image.height(), width: image.width() };
            Ok((image.into_raw().into_iter().map(u32::from).collect(), size))
        }
        image => Err(other("an instance map of 16-bit grey", &image, path)),
    }
}

/// Reads a mask: `true` for pixels with a non-zero value in any channel except alpha.
pub(super) fn mask(path: &Path) -> Result<Read<bool>, FileError> {
    let image = read(path)?;
    let size = size(&image);
    // 16 bits: levels below 256 of 16-bit images must not become 0.
    let mask = image.into_rgb16().as_raw().as_chunks::<3>().0.iter().map(|pixel| *pixel != [0; 3]).collect();
    Ok((mask, size))
}
