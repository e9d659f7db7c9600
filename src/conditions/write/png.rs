//! PNG writer, `FRAME/CAM/MAP.png`: color, boxes and map as RGB, depth as 16-bit bins, class as 8-bit gray,
//! instance and point as 16-bit gray.
//!
//! Rows are filtered by the difference to the left pixel. A filter chosen for each row takes twice the time
//! for files that are 2 % smaller (4 % for sheets).

use std::io::Write;
use std::path::Path;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use rayon::prelude::*;

use crate::conditions::{
    CameraConditions, ConditionError, ConditionSet, DepthBins, ImageSize, MapKind, MapPixels,
};
use crate::error::FileError;
use crate::files::write_whole;

/// Writes all maps of a step except the model tensor below `folder`, which is created if it does not exist.
///
/// # Errors
/// Returns an error if an instance or point number exceeds 65535, or if a folder or a file cannot be written.
pub fn write(folder: &Path, set: &ConditionSet, bins: &DepthBins) -> Result<(), ConditionError> {
    set.cameras.par_iter().try_for_each(|camera| {
        let folder = folder.join(&camera.name);
        std::fs::create_dir_all(&folder).map_err(FileError::io("create", &folder))?;
        let mut kinds = MapKind::ALL.into_iter();
        kinds.try_for_each(|kind| write_map(&folder.join(format!("{}.png", kind.name())), camera, kind, bins))
    })
}

/// Writes one map; does nothing if the camera has no such map.
fn write_map(
    path: &Path,
    camera: &CameraConditions,
    kind: MapKind,
    bins: &DepthBins,
) -> Result<(), ConditionError> {
    let Some(bytes) = encode_map(path, camera, kind, bins)? else { return Ok(()) };
    Ok(write_whole(path, |out| out.write_all(&bytes).map_err(FileError::io("write", path)))?)
}

/// Encodes one map; `None` if the camera has no such map, or if it is the model tensor, which is not an
/// image. `path` is the file that errors name.
///
/// # Errors
/// Returns an error if an instance or point number exceeds 65535.
pub fn encode_map(
    path: &Path,
    camera: &CameraConditions,
    kind: MapKind,
    bins: &DepthBins,
) -> Result<Option<Vec<u8>>, ConditionError> {
    let encoded = match camera.pixels(kind) {
        Some(MapPixels::Rgb(rgb)) => encode_rgb(path, rgb, camera.size())?,
        Some(MapPixels::Class(class)) => encode_gray(path, class, camera.size())?,
        _ => match gray_16(path, camera, kind, bins)? {
            Some(map) => encode(path, bytemuck::cast_slice(&map), camera.size(), ExtendedColorType::L16)?,
            None => return Ok(None),
        },
    };
    Ok(Some(encoded))
}

/// Returns the 16-bit samples of a map: depth as bins over the whole range, instance and point numbers.
/// `None` if the camera has no such map, or if it has other samples. `path` is the file that errors name.
///
/// # Errors
/// Returns an error if an instance or point number exceeds 65535.
pub fn gray_16(
    path: &Path,
    camera: &CameraConditions,
    kind: MapKind,
    bins: &DepthBins,
) -> Result<Option<Vec<u16>>, ConditionError> {
    match camera.pixels(kind) {
        Some(MapPixels::Depth(map)) => {
            Ok(Some(bins.bins(map).into_iter().map(|bin| bins.png_value(bin)).collect()))
        }
        Some(MapPixels::Number(map)) => to_u16(map, kind, path).map(Some),
        Some(MapPixels::Rgb(_) | MapPixels::Class(_) | MapPixels::Channels(_)) | None => Ok(None),
    }
}

fn to_u16(numbers: &[u32], kind: MapKind, path: &Path) -> Result<Vec<u16>, ConditionError> {
    let found = numbers.iter().copied().max().unwrap_or(0);
    let max = u32::from(u16::MAX);
    if found > max {
        return Err(ConditionError::PngRange { map: kind.name(), max, found, path: path.to_owned() });
    }
    Ok(numbers.iter().map(|n| *n as u16).collect())
}

/// Writes one RGB image.
///
/// # Errors
/// Fails if the file cannot be written.
pub fn write_rgb(path: &Path, rgb: &[[u8; 3]], size: ImageSize) -> Result<(), FileError> {
    let bytes = encode_rgb(path, rgb, size)?;
    write_whole(path, |out| out.write_all(&bytes).map_err(FileError::io("write", path)))
}

/// Encodes one RGB image. `path` is the file that errors name.
///
/// # Errors
/// Fails if `rgb` has another size.
pub fn encode_rgb(path: &Path, rgb: &[[u8; 3]], size: ImageSize) -> Result<Vec<u8>, FileError> {
    encode(path, rgb.as_flattened(), size, ExtendedColorType::Rgb8)
}

/// Encodes one gray image of 8 bits. `path` is the file that errors name.
///
/// # Errors
/// Fails if `gray` has another size.
pub fn encode_gray(path: &Path, gray: &[u8], size: ImageSize) -> Result<Vec<u8>, FileError> {
    encode(path, gray, size, ExtendedColorType::L8)
}

/// Encodes samples as PNG; 16-bit samples are in native byte order, as the encoder expects.
fn encode(
    path: &Path,
    samples: &[u8],
    size: ImageSize,
    color: ExtendedColorType,
) -> Result<Vec<u8>, FileError> {
    let mut bytes = Vec::new();
    let encoder = PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Sub);
    let encoded = encoder.write_image(samples, size.width, size.height, color);
    encoded.map_err(|error| FileError::io("write", path)(std::io::Error::other(error)))?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conditions::write::test_set::test_set;

    #[test]
    fn written_maps_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let set = test_set();
        let bins = DepthBins { far_m: 50.0, ..DepthBins::default() };
        write(folder.path(), &set, &bins).unwrap();
        let camera = &set.cameras[1];
        let open = |map: &str| image::open(folder.path().join("right").join(map)).unwrap();
        let rgb = |image: image::DynamicImage| image.as_rgb8().unwrap().as_chunks::<3>().0.to_vec();
        assert_eq!(Some(rgb(open("color.png"))), camera.color);
        assert_eq!(Some(rgb(open("boxes.png"))), camera.boxes);
        assert_eq!(Some(rgb(open("map.png"))), camera.map);
        assert_eq!(open("class.png").as_luma8().unwrap().as_raw(), camera.class.as_ref().unwrap());
        let numbers = |image: image::DynamicImage| -> Vec<u32> {
            image.as_luma16().unwrap().iter().map(|v| u32::from(*v)).collect()
        };
        assert_eq!(Some(numbers(open("instance.png"))), camera.instance);
        let depth = camera.depth_m.as_ref().unwrap();
        let expected: Vec<u32> = depth.iter().map(|d| u32::from(bins.bin(*d)) * 255).collect();
        assert_eq!(numbers(open("depth.png")), expected);
        assert!(expected.contains(&0) && expected.iter().max() > Some(&256));
    }

    #[test]
    fn rejects_instances_over_16_bits() {
        let folder = tempfile::tempdir().unwrap();
        let mut set = test_set();
        set.cameras[0].instance.as_mut().unwrap()[3] = 70_000;
        let message = write(folder.path(), &set, &DepthBins::default()).unwrap_err().to_string();
        assert!(
            message.contains("instance numbers of at most 65535") && message.contains("70000"),
            "{message}"
        );
        assert!(!folder.path().join("left/instance.png").exists());
    }

    #[test]
    fn a_full_disk_names_the_file() {
        let message = write_rgb(Path::new("/proc/none.png"), &[[0; 3]], ImageSize { height: 1, width: 1 });
        assert!(message.unwrap_err().to_string().ends_with("/proc/none.png"));
    }
}
