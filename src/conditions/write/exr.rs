//! EXR writer, `FRAME/CAM/MAP.exr`: color, boxes and map as `R G B` f32 (level / 255), depth as `Z` f32
//! meters (−300 where empty), class, instance and point as one u32 channel with the map's name.
//!
//! All but RGB have the same samples in a second channel `Y`: OpenCV reads a lone `Z` as zeros, and no file
//! without `Y` or RGB. It converts numbers to f32, so a map with larger numbers than f32 can hold has no `Y`:
//! OpenCV then refuses the file instead of returning other numbers.

use std::path::Path;

use exr::image::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image};
use exr::prelude::{SmallVec, WritableImage};
use rayon::prelude::*;

use crate::conditions::{CameraConditions, ConditionSet, EMPTY_DEPTH_M, ImageSize, MapKind, MapPixels};
use crate::error::FileError;
use crate::files::write_whole;

/// Largest integer up to which `f32` holds all.
const MAX_F32_INTEGER: u32 = 1 << f32::MANTISSA_DIGITS;

type Channels = SmallVec<[AnyChannel<FlatSamples>; 4]>;

/// Writes all maps of a step except the model tensor below `folder`, which is created if it does not exist.
///
/// # Errors
/// Fails if a folder or a file cannot be written.
pub fn write(folder: &Path, set: &ConditionSet) -> Result<(), FileError> {
    set.cameras.par_iter().try_for_each(|camera| {
        let folder = folder.join(&camera.name);
        std::fs::create_dir_all(&folder).map_err(FileError::io("create", &folder))?;
        for kind in MapKind::ALL {
            if let Some(channels) = channels(camera, kind) {
                encode(&folder.join(format!("{}.exr", kind.name())), channels, camera.size())?;
            }
        }
        Ok(())
    })
}

/// Returns `None` if the camera has no such map.
fn channels(camera: &CameraConditions, kind: MapKind) -> Option<Channels> {
    let numbers = |map: Vec<u32>| {
        let exact = map.iter().all(|number| *number <= MAX_F32_INTEGER);
        gray(kind.name(), FlatSamples::U32(map), exact)
    };
    Some(match camera.pixels(kind)? {
        MapPixels::Rgb(map) => rgb(map),
        MapPixels::Depth(map) => {
            let meters = |d: &f32| if d.is_finite() { *d } else { EMPTY_DEPTH_M };
            gray("Z", FlatSamples::F32(map.iter().map(meters).collect()), true)
        }
        MapPixels::Class(map) => numbers(map.iter().map(|c| u32::from(*c)).collect()),
        MapPixels::Number(map) => numbers(map.to_vec()),
        // The model tensor is not an image.
        MapPixels::Channels(_) => return None,
    })
}

/// Returns a channel, with a copy named `Y` if `readable`.
fn gray(name: &str, samples: FlatSamples, readable: bool) -> Channels {
    let copy = readable.then(|| AnyChannel::new("Y", samples.clone()));
    copy.into_iter().chain([AnyChannel::new(name, samples)]).collect()
}

fn rgb(map: &[[u8; 3]]) -> Channels {
    let channel = |(index, name): (usize, &str)| {
        let samples = map.iter().map(|pixel| f32::from(pixel[index]) / 255.0).collect();
        AnyChannel::new(name, FlatSamples::F32(samples))
    };
    ["R", "G", "B"].into_iter().enumerate().map(channel).collect()
}

fn encode(path: &Path, channels: Channels, size: ImageSize) -> Result<(), FileError> {
    let dimensions = (size.width as usize, size.height as usize);
    let image =
        Image::from_encoded_channels(dimensions, Encoding::SMALL_LOSSLESS, AnyChannels::sort(channels));
    write_whole(path, |out| {
        image.write().non_parallel().to_buffered(out).map_err(|error| match error {
            exr::error::Error::Io(source) => FileError::io("write", path)(source),
            other => FileError::io("write", path)(std::io::Error::other(other)),
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conditions::write::test_set::test_set;

    #[test]
    fn written_maps_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let set = test_set();
        write(folder.path(), &set).unwrap();
        let camera = &set.cameras[1];
        let read = |map: &str| {
            let path = folder.path().join("right").join(map);
            let image = exr::prelude::read_first_flat_layer_from_file(path).unwrap();
            assert_eq!(image.layer_data.size, exr::math::Vec2(camera.width as usize, camera.height as usize));
            image.layer_data.channel_data.list
        };
        let rgb = [("color.exr", &camera.color), ("boxes.exr", &camera.boxes), ("map.exr", &camera.map)];
        for (map, expected) in rgb {
            let channels = read(map);
            // EXR stores channels in alphabetical order.
            for (channel, (name, index)) in channels.iter().zip([("B", 2), ("G", 1), ("R", 0)]) {
                let levels: Vec<u8> =
                    channel.sample_data.values_as_f32().map(|v| (v * 255.0).round() as u8).collect();
                let expected: Vec<u8> = expected.as_ref().unwrap().iter().map(|p| p[index]).collect();
                assert_eq!((channel.name.to_string().as_str(), levels), (name, expected));
            }
        }
        let depth = read("depth.exr");
        let expected = camera.depth_m.as_ref().unwrap();
        let names: Vec<String> = depth.iter().map(|channel| channel.name.to_string()).collect();
        assert_eq!(names, ["Y", "Z"]);
        for channel in &depth {
            let meters: Vec<f32> = channel.sample_data.values_as_f32().collect();
            assert!(meters.iter().zip(expected).all(|(m, d)| m == d || (*m == -300.0 && d.is_infinite())));
        }
        let class = camera.class.as_ref().unwrap().iter().map(|c| u32::from(*c)).collect();
        let instance = camera.instance.clone().unwrap();
        for (map, expected) in [("class", class), ("instance", instance)] {
            let channels = read(&format!("{map}.exr"));
            let found =
                channels.iter().map(|channel| (channel.name.to_string(), channel.sample_data.clone()));
            let samples = FlatSamples::U32(expected);
            assert!(found.eq([("Y".to_owned(), samples.clone()), (map.to_owned(), samples)]), "{map}");
        }
    }

    #[test]
    fn numbers_beyond_f32_have_no_readable_copy() {
        let camera =
            |number| CameraConditions { point: Some(vec![0, number]), ..CameraConditions::default() };
        let count = |number| channels(&camera(number), MapKind::Point).unwrap().len();
        assert_eq!((count(1 << 24), count((1 << 24) + 1)), (2, 1));
    }
}
