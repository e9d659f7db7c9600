//! Encoded files of a sample.

use std::path::Path;

use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;
use image::imageops::{FilterType, resize};
use point_skeleton::Log;
use point_skeleton::cloud::npy;
use point_skeleton::conditions::write::png;
use point_skeleton::conditions::{CameraConditions, DepthBins, MapKind};
use point_skeleton::dataset::ImageRecord;
use point_skeleton::error::FileError;
use point_skeleton::geometry::ImageSize;
use point_skeleton::scene::GroundTruthImages;
use rayon::prelude::*;

use crate::ExportError;
use crate::samples::Sample;
use crate::shard::Shard;

/// JPEG quality of recorded images, so high that artifacts come from the recording.
const QUALITY: u8 = 95;

/// A file in memory.
pub(crate) struct Encoded {
    pub(crate) name: String,
    pub(crate) bytes: Vec<u8>,
}

/// Encodes the maps of all cameras as PNG. `name` returns the name of a file by camera and map; `None` for
/// maps that are not wanted.
///
/// # Errors
/// Fails if a number does not fit into a PNG.
pub(crate) fn maps_as_png(
    cameras: &[CameraConditions],
    bins: &DepthBins,
    name: impl Fn(usize, MapKind) -> Option<String> + Sync,
) -> Result<Vec<Encoded>, ExportError> {
    let all: Vec<(usize, MapKind)> =
        (0..cameras.len()).flat_map(|camera| MapKind::ALL.map(|kind| (camera, kind))).collect();
    let encode = |&(camera, kind): &(usize, MapKind)| {
        let Some(name) = name(camera, kind) else { return Ok(None) };
        let bytes = png::encode_map(Path::new(&name), &cameras[camera], kind, bins)?;
        Ok(bytes.map(|bytes| Encoded { name, bytes }))
    };
    let files: Vec<Option<Encoded>> = all.par_iter().map(encode).collect::<Result<_, ExportError>>()?;
    Ok(files.into_iter().flatten().collect())
}

/// Encodes the maps of all cameras for readers that decode every image to 8 bits: as PNG, but maps of 16 bits
/// as arrays `[H, W]` of `u16` in NPY, with the samples that their PNG would have. `name` returns the name of
/// a file without its extension, by camera and map.
///
/// # Errors
/// Fails if a number does not fit into 16 bits.
pub(crate) fn maps_for_8_bits(
    cameras: &[CameraConditions],
    bins: &DepthBins,
    name: impl Fn(usize, MapKind) -> String + Sync,
) -> Result<Vec<Encoded>, ExportError> {
    let all: Vec<(usize, MapKind)> =
        (0..cameras.len()).flat_map(|camera| MapKind::ALL.map(|kind| (camera, kind))).collect();
    let encode = |&(index, kind): &(usize, MapKind)| {
        let (camera, name) = (&cameras[index], name(index, kind));
        let npy = format!("{name}.npy");
        if let Some(samples) = png::gray_16(Path::new(&npy), camera, kind, bins)? {
            let bytes = npy::encode_u16(&samples, [camera.height, camera.width])
                .map_err(FileError::io("write", Path::new(&npy)))?;
            return Ok(Some(Encoded { name: npy, bytes }));
        }
        let name = format!("{name}.png");
        let bytes = png::encode_map(Path::new(&name), camera, kind, bins)?;
        Ok(bytes.map(|bytes| Encoded { name, bytes }))
    };
    let files: Vec<Option<Encoded>> = all.par_iter().map(encode).collect::<Result<_, ExportError>>()?;
    Ok(files.into_iter().flatten().collect())
}

/// Reads recorded images, removes their lens distortion, and resizes them to the size of each camera's maps.
/// Damaged images are skipped and counted in the shard's notes.
///
/// # Errors
/// Fails if an image cannot be read, or if it is damaged and the log was opened with
/// [`MissingData::Error`](point_skeleton::dataset::MissingData::Error).
pub(crate) fn recorded_images(
    shard: &mut Shard,
    log: &Log,
    records: &[Option<&ImageRecord>],
    sizes: &[ImageSize],
) -> Result<Vec<Option<RgbImage>>, ExportError> {
    let truth = GroundTruthImages::new(log.reader());
    let read = |(record, size): (&Option<&ImageRecord>, &ImageSize)| {
        let Some(record) = record else { return Ok(None) };
        let image = log.recording().unless_damaged(truth.of_record(record))?;
        Ok(image.map(|image| resize(&image, size.width, size.height, FilterType::Triangle)))
    };
    let images: Vec<Option<RgbImage>> =
        records.par_iter().zip(sizes).map(read).collect::<Result<_, ExportError>>()?;
    let count = |images: usize| records.iter().flatten().count() - images;
    shard.note("damaged image files", count(images.iter().flatten().count()));
    Ok(images)
}

/// Encodes an image as JPEG. `path` is the file that errors name.
///
/// # Errors
/// Fails if it cannot be encoded.
pub(crate) fn jpeg(path: &Path, image: &RgbImage) -> Result<Vec<u8>, FileError> {
    let mut bytes = Vec::new();
    let encoded = JpegEncoder::new_with_quality(&mut bytes, QUALITY).encode_image(image);
    encoded.map_err(|error| FileError::io("write", path)(std::io::Error::other(error)))?;
    Ok(bytes)
}

/// Encodes the recorded images of a sample as JPEG. `name` returns the name of a file by camera.
///
/// # Errors
/// Fails as [`recorded_images`].
pub(crate) fn images_as_jpeg(
    shard: &mut Shard,
    log: &Log,
    sample: &Sample<'_>,
    sizes: &[ImageSize],
    name: impl Fn(usize) -> String + Sync,
) -> Result<Vec<Encoded>, ExportError> {
    let images = recorded_images(shard, log, &sample.images, sizes)?;
    let encode = |(camera, image): (usize, &Option<RgbImage>)| {
        let (image, name) = (image.as_ref()?, name(camera));
        Some(jpeg(Path::new(&name), image).map(|bytes| Encoded { name, bytes }))
    };
    Ok(images.par_iter().enumerate().filter_map(encode).collect::<Result<_, FileError>>()?)
}
