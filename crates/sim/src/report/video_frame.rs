//! Frames of `rollout.mp4`: the first map large above the next two, with the bird's-eye view beside them.
//!
//! Frames are composed from the files of a step, so a rollout that was interrupted gives the same video.

use std::path::Path;

use image::imageops::{self, FilterType};
use image::{Rgb, RgbImage};
use point_skeleton::conditions::view::canvas::Canvas;
use point_skeleton::error::FileError;
use point_skeleton::files::input::{IMAGE_BYTES, read_file};
use point_skeleton::geometry::ImageSize;

use super::BIRDSEYE;
use super::video::MAX_SIDE_PX;
use super::view::VIEW;

const BACKGROUND: [u8; 3] = [17, 19, 24];
const TEXT: [u8; 3] = [232, 234, 237];
/// Gap between the images, pixels.
const GAP: u32 = 4;
/// Height of the caption, pixels.
const CAPTION: u32 = 28;
/// Maximum side of the bird's-eye view, and maximum width of the first map, pixels.
const LARGEST: [u32; 2] = [720, 1160];

/// Composes the frame of a step's folder. `maps` are names of maps, the first three of them shown; `caption`
/// is at the top.
///
/// # Errors
/// Returns an error if an image is missing or damaged.
pub fn compose(
    folder: &Path,
    maps: &[String],
    caption: &str,
) -> Result<(ImageSize, Vec<[u8; 3]>), FileError> {
    let map = |name: &String| open(&folder.join(VIEW).join(format!("{name}.jpg")));
    let mut shown = maps.iter().take(3).map(map);
    let large = shown.next().transpose()?.map(|image| fitted(image, [LARGEST[1], LARGEST[0]]));
    let birdseye = open(&folder.join(BIRDSEYE))?;
    let Some(large) = large else {
        let side = birdseye.width().min(LARGEST[0]);
        return Ok(composed(&[(scaled(&birdseye, side, side), [0, 0])], caption));
    };
    let (width, height) = large.dimensions();
    let half = [(width - GAP.min(width)) / 2, height / 2];
    let mut parts = Vec::new();
    for (place, small) in (0..).zip(shown) {
        let small = scaled(&small?, half[0], half[1]);
        parts.push((small, [place * (half[0] + GAP), height + GAP]));
    }
    let bottom = if parts.is_empty() { height } else { height + GAP + half[1] };
    let side = bottom.min(LARGEST[0]);
    parts.push((large, [0, 0]));
    parts.push((scaled(&birdseye, side, side), [width + GAP, 0]));
    Ok(composed(&parts, caption))
}

/// Places images below a caption, on a canvas that fits them and has even sides.
fn composed(parts: &[(RgbImage, [u32; 2])], caption: &str) -> (ImageSize, Vec<[u8; 3]>) {
    let end = |axis: usize| {
        let end = |(image, at): &(RgbImage, [u32; 2])| at[axis] + [image.width(), image.height()][axis];
        parts.iter().map(end).max().unwrap_or(0)
    };
    let even = |side: u32| side.next_multiple_of(2).clamp(16, MAX_SIDE_PX);
    let size = ImageSize { height: even(end(1) + CAPTION), width: even(end(0)) };
    let mut canvas = Canvas::new(size, BACKGROUND);
    canvas.text([8, 6], 2, TEXT, caption);
    for (image, [left, top]) in parts {
        canvas.map(
            [*left, CAPTION + top],
            ImageSize { height: image.height(), width: image.width() },
            |_, [x, y]| image.get_pixel(x, y).0,
        );
    }
    (size, canvas.pixels)
}

fn open(path: &Path) -> Result<RgbImage, FileError> {
    let bytes = read_file(path, IMAGE_BYTES)?;
    let image = image::load_from_memory(&bytes)
        .map_err(|error| FileError::content("a picture", error.to_string(), path))?;
    Ok(image.into_rgb8())
}

fn scaled(image: &RgbImage, width: u32, height: u32) -> RgbImage {
    if image.dimensions() == (width, height) {
        return image.clone();
    }
    match (image.width(), image.height()) {
        (0, _) | (_, 0) => RgbImage::from_pixel(width, height, Rgb(BACKGROUND)),
        _ => imageops::resize(image, width.max(1), height.max(1), FilterType::Triangle),
    }
}

/// Shrinks an image to a maximum width and height.
fn fitted(image: RgbImage, [width, height]: [u32; 2]) -> RgbImage {
    let ratio = |most: u32, side: u32| f64::from(most) / f64::from(side.max(1));
    let scale = ratio(width, image.width()).min(ratio(height, image.height()));
    if scale >= 1.0 {
        return image;
    }
    let side = |side: u32| (f64::from(side) * scale).round().max(1.0) as u32;
    scaled(&image, side(image.width()), side(image.height()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn composes_maps_beside_birdseye_view() {
        let folder = tempfile::tempdir().unwrap();
        let view = folder.path().join(VIEW);
        std::fs::create_dir(&view).unwrap();
        let save = |name: &str, size: [u32; 2], rgb: [u8; 3]| {
            RgbImage::from_pixel(size[0], size[1], Rgb(rgb)).save(folder.path().join(name)).unwrap();
        };
        save(BIRDSEYE, [800, 800], [9, 99, 9]);
        let names = ["color", "depth", "class", "boxes"].map(str::to_owned);
        for (name, rgb) in names.iter().zip([[200, 0, 0], [0, 0, 200], [200, 200, 0], [1, 2, 3]]) {
            save(&format!("{VIEW}/{name}.jpg"), [400, 201], rgb);
        }
        let (size, pixels) = compose(folder.path(), &names, "x").unwrap();
        // The lower maps have half the 201 rows; the bird's-eye view is as high as both rows of maps.
        assert_eq!((size.width, size.height), (400 + 4 + 306 - 1 + 1, 28 + 201 + 4 + 100 + 1));
        let at = |x: u32, y: u32| pixels[((y + CAPTION) * size.width + x) as usize];
        let close = |found: [u8; 3], rgb: [u8; 3]| found.iter().zip(rgb).all(|(a, b)| a.abs_diff(b) < 5);
        for (x, y, rgb) in [
            (200, 100, [200, 0, 0]),
            (100, 250, [0, 0, 200]),
            (300, 250, [200, 200, 0]),
            (550, 150, [9, 99, 9]),
            (402, 100, BACKGROUND),
        ] {
            assert!(close(at(x, y), rgb), "{x} {y}: {:?}", at(x, y));
        }
        let (alone, _) = compose(folder.path(), &[], "x").unwrap();
        assert_eq!((alone.width, alone.height), (720, 748));
        std::fs::write(view.join("depth.jpg"), "no").unwrap();
        let message = compose(folder.path(), &names, "x").unwrap_err().to_string();
        assert!(message.contains("expected a picture") && message.ends_with("depth.jpg"), "{message}");
    }
}
