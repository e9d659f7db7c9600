//! Images: JPEG and PNG.

use std::cell::RefCell;
use std::io::Cursor;

use image::codecs::jpeg::JpegEncoder;
use image::{DynamicImage, ImageFormat, Rgb, RgbImage};
use point_skeleton::dataset::{picture_size, read_picture};

use super::{Scratch, seed};
use crate::check::assert_names_file;
use crate::{Memory, Seed, Target};

/// An image of 256 x 256 pixels with four 16-bit channels, and its converted copy; JPEG also holds planes.
const PICTURE: Memory = Memory { fixed: 16 << 20, factor: 100 };

pub(super) const TARGETS: [Target; 1] =
    [Target { name: "picture", run: picture, seeds: picture_seeds, max_len: 4096, memory: PICTURE }];

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::new(Scratch::new());
}

/// Maximum side of images that are decoded here. In use, the camera's size sets the limit, not the file.
const MAX_SIDE: u32 = 256;

fn picture(data: &[u8]) {
    let path = SCRATCH.with_borrow(|scratch| scratch.put("a.jpg", data));
    let (height, width) = match picture_size(&path) {
        Err(error) => return assert_names_file(error, &path, data),
        Ok(size) => size,
    };
    // If the size differs from the camera's, nothing is decoded.
    let other = read_picture(&path, height.wrapping_add(1), width).expect_err("a picture of another size");
    assert_names_file(other, &path, data);
    if height <= MAX_SIDE && width <= MAX_SIDE {
        match read_picture(&path, height, width) {
            Err(error) => assert_names_file(error, &path, data),
            Ok(image) => assert_eq!(image.dimensions(), (width, height)),
        }
    }
}

fn picture_seeds() -> Vec<Seed> {
    let rgb = RgbImage::from_fn(24, 16, |x, y| Rgb([10 * x as u8, 15 * y as u8, (x * y) as u8]));
    let jpeg = |quality: u8, image: &DynamicImage| {
        let mut bytes = Vec::new();
        JpegEncoder::new_with_quality(&mut bytes, quality).encode_image(image).expect("a picture");
        bytes
    };
    let png = |image: &DynamicImage| {
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, ImageFormat::Png).expect("a picture");
        bytes.into_inner()
    };
    let all = DynamicImage::from(rgb);
    vec![
        seed("color.jpg", jpeg(90, &all)),
        seed("grey.jpg", jpeg(30, &all.to_luma8().into())),
        seed("color.png", png(&all)),
        seed("grey16.png", png(&all.to_luma16().into())),
        seed("alpha.png", png(&all.to_rgba8().into())),
    ]
}
