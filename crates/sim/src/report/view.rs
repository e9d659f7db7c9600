//! Images for the page: `view/MAP.jpg`, one map of all cameras, arranged like a block of the contact sheet.

use std::path::Path;

use image::codecs::jpeg::JpegEncoder;
use image::imageops::{self, FilterType};
use image::{ExtendedColorType, ImageError, RgbImage};
use point_skeleton::conditions::view::sheet;
use point_skeleton::conditions::{CameraConditions, ConditionSet, DepthBins, MapKind};
use point_skeleton::error::FileError;
use point_skeleton::files::FileName;
use point_skeleton::files::write_whole;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Folder of the images in the folder of a step.
pub const VIEW: &str = "view";
/// Maximum width of a tile, pixels.
const TILE_WIDTH_PX: u32 = 384;
/// Maximum width of an image, pixels: rows of more than three cameras have smaller tiles.
const WIDTH_PX: u32 = 1160;
/// JPEG quality.
const QUALITY: u8 = 75;

/// Arrangement of the cameras in an image.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Layout {
    /// Width of an image, pixels.
    pub width: u32,
    /// Height of an image, pixels.
    pub height: u32,
    /// Rectangles of the cameras, in the order of the maps.
    pub cameras: Vec<Place>,
    /// Names of the maps that are shown.
    pub maps: Vec<String>,
}

/// Rectangle of a camera in an image.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Place {
    /// Channel name.
    pub name: FileName,
    /// Left edge, pixels.
    pub left: u32,
    /// Top edge, pixels.
    pub top: u32,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
}

impl Layout {
    /// Returns the arrangement for the maps of a step.
    pub fn of(set: &ConditionSet) -> Self {
        let tile = tile_width(set);
        let place = |(camera, [left, top, width, height]): (&CameraConditions, [u32; 4])| Place {
            name: camera.name.clone(),
            left,
            top,
            width,
            height,
        };
        let (size, places) = sheet::places(set, tile);
        let cameras = set.cameras.iter().zip(places).map(place).collect();
        let maps = sheet::kinds(set).iter().map(|kind| kind.name().to_owned()).collect();
        Self { width: size.width, height: size.height, cameras, maps }
    }
}

/// Writes `NAME.jpg`, with the images of all cameras at their places, into a folder; creates the folder.
///
/// # Errors
/// Fails if the folder cannot be created, or if the file cannot be written.
pub fn write_images(
    folder: &Path,
    name: &str,
    layout: &Layout,
    images: &[RgbImage],
) -> Result<(), FileError> {
    std::fs::create_dir_all(folder).map_err(FileError::io("create", folder))?;
    let mut picture = RgbImage::from_pixel(layout.width, layout.height, image::Rgb(sheet::BACKGROUND));
    for (place, image) in layout.cameras.iter().zip(images) {
        let scaled = imageops::resize(image, place.width, place.height, FilterType::CatmullRom);
        imageops::replace(&mut picture, &scaled, i64::from(place.left), i64::from(place.top));
    }
    jpeg(&folder.join(format!("{name}.jpg")), picture.as_raw(), picture.dimensions())
}

/// Writes the images of a step, one per map, into a folder; creates the folder.
///
/// # Errors
/// Fails if the folder cannot be created, or if a file cannot be written.
pub fn write(folder: &Path, set: &ConditionSet, bins: &DepthBins) -> Result<(), FileError> {
    std::fs::create_dir_all(folder).map_err(FileError::io("create", folder))?;
    let tile = tile_width(set);
    sheet::kinds(set).par_iter().try_for_each(|kind: &MapKind| {
        let (size, pixels) = sheet::draw_map(set, *kind, tile, bins);
        let path = folder.join(format!("{}.jpg", kind.name()));
        jpeg(&path, pixels.as_flattened(), (size.width, size.height))
    })
}

fn jpeg(path: &Path, pixels: &[u8], (width, height): (u32, u32)) -> Result<(), FileError> {
    write_whole(path, |out| {
        let mut encoder = JpegEncoder::new_with_quality(out, QUALITY);
        encoder.encode(pixels, width, height, ExtendedColorType::Rgb8).map_err(|error| match error {
            ImageError::IoError(source) => FileError::io("write", path)(source),
            other => FileError::io("write", path)(std::io::Error::other(other)),
        })
    })
}

fn tile_width(set: &ConditionSet) -> u32 {
    let fits = |tile: &u32| sheet::places(set, *tile).0.width <= WIDTH_PX;
    (1..=TILE_WIDTH_PX).rev().find(fits).unwrap_or(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(name: &str, [r, g, b]: [u8; 3]) -> CameraConditions {
        CameraConditions {
            name: name.parse().unwrap(),
            width: 600,
            height: 300,
            color: Some(vec![[r, g, b]; 180_000]),
            depth_m: Some(vec![20.0; 180_000]),
            ..CameraConditions::default()
        }
    }

    #[test]
    fn pictures_place_every_camera() {
        let colors = [[200, 30, 40], [30, 190, 60], [40, 50, 220]];
        let names =
            ["CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_FRONT_LEFT"];
        let cameras = names.iter().zip(colors.iter().cycle()).map(|(name, rgb)| camera(name, *rgb)).collect();
        let set = ConditionSet { cameras };
        let folder = tempfile::tempdir().unwrap();
        write(&folder.path().join(VIEW), &set, &DepthBins::default()).unwrap();
        let layout = Layout::of(&set);
        assert_eq!(layout.maps, ["color", "depth"]);
        assert_eq!((layout.width, layout.height), (3 * 384 + 8, 2 * 192 + 4));
        assert_eq!((layout.cameras[5].left, layout.cameras[0].left, layout.cameras[3].top), (0, 388, 196));
        for map in &layout.maps {
            let image = image::open(folder.path().join(VIEW).join(format!("{map}.jpg"))).unwrap().into_rgb8();
            assert_eq!(image.dimensions(), (layout.width, layout.height));
            for (place, rgb) in layout.cameras.iter().zip(colors.iter().cycle()).filter(|_| map == "color") {
                let [x, y] = [place.left + place.width / 2, place.top + place.height / 2];
                let found = image.get_pixel(x, y).0;
                assert!(
                    found.iter().zip(rgb).all(|(a, b)| a.abs_diff(*b) < 12),
                    "{found:?}, expected {rgb:?}"
                );
            }
        }
    }

    #[test]
    fn wide_rows_use_smaller_tiles() {
        let ring = ["CAM_F0", "CAM_R0", "CAM_R1", "CAM_R2", "CAM_B0", "CAM_L2", "CAM_L1", "CAM_L0"];
        let set = ConditionSet { cameras: ring.iter().map(|name| camera(name, [9; 3])).collect() };
        let layout = Layout::of(&set);
        assert!(layout.width <= WIDTH_PX && layout.width > WIDTH_PX - 20, "{layout:?}");
        let bare = CameraConditions { color: None, depth_m: None, ..camera("a", [0; 3]) };
        let layout = Layout::of(&ConditionSet { cameras: vec![bare] });
        assert_eq!((layout.cameras.len(), layout.maps.len()), (1, 0));
    }
}
