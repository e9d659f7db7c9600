//! Encoding of the images of a frame, beside the rendering of the next one.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use image::RgbImage;
use jpeg_encoder::{ColorType, Encoder as JpegEncoder};
use point_skeleton::MapOptions;
use point_skeleton::conditions::birdseye::{self, BirdseyeOptions, Trace};
use point_skeleton::conditions::view::sheet;
use point_skeleton::conditions::write::png;
use point_skeleton::conditions::{CameraConditions, ConditionSet, MapKind, reduce};
use point_skeleton::dataset::LogReader;
use point_skeleton::error::with_causes;
use point_skeleton::geometry::ImageSize;
use point_skeleton::scene::{GroundTruthImages, SceneState};
use pskel_eval::compare_filled;
use rayon::prelude::*;

use crate::frame::{Header, ImageHeader, packed};
use crate::generated::Generated;
use crate::hub::Hub;
use crate::message::ServerMessage;
use crate::view::{Codec, GENERATED, RECORDED, Shown, View};

/// JPEG quality of maps.
const QUALITY: u8 = 80;
/// Name of the bird's-eye view among the maps.
pub(crate) const BIRDSEYE: &str = "birdseye";

/// A rendered state.
pub(crate) struct Drawn {
    pub(crate) header: Header,
    pub(crate) state: SceneState,
    pub(crate) set: ConditionSet,
    pub(crate) view: View,
    pub(crate) options: MapOptions,
    pub(crate) traces: Vec<Trace>,
    /// Whether the ego, and the actors, are those of the log.
    pub(crate) ego_follows_log: bool,
    pub(crate) actors_follow_log: bool,
    /// Newest generated images.
    pub(crate) generated: Option<Arc<Generated>>,
}

/// Pixels of an image.
type Pixels = Vec<[u8; 3]>;
/// Number of recorded images that are kept.
const KEPT: usize = 16;

/// Encodes frames, and keeps the recorded images that it has read.
pub(crate) struct Encoder<'a> {
    reader: &'a dyn LogReader,
    recorded: Mutex<BTreeMap<Key, Pixels>>,
}

/// Camera, time and size of a recorded image.
type Key = (String, i64, [u32; 2]);

/// Image that is to be encoded.
enum Job<'d> {
    Map(&'d CameraConditions, MapKind),
    Recorded(&'d str, Pixels),
    Generated(&'d str, &'d RgbImage),
    Birdseye(BirdseyeOptions),
}

impl<'a> Encoder<'a> {
    pub(crate) fn new(reader: &'a dyn LogReader) -> Self {
        Self { reader, recorded: Mutex::default() }
    }

    /// Encodes a frame and publishes it; failures are told to the clients.
    pub(crate) fn publish(&self, drawn: Drawn, hub: &Hub) {
        match self.encode(drawn) {
            Ok((number, bytes)) => hub.publish(number, bytes),
            Err(text) => hub.tell(None, ServerMessage::Notice { level: "error", text: &text }.json()),
        }
    }

    /// Encodes a frame. Returns its number and bytes.
    ///
    /// # Errors
    /// Returns the error of a recorded image or of an encoder.
    pub(crate) fn encode(&self, drawn: Drawn) -> Result<(u64, Vec<u8>), String> {
        let start = Instant::now();
        let Drawn { mut header, state, set, view, options, traces, generated, .. } = drawn;
        let Drawn { ego_follows_log, actors_follow_log, .. } = drawn;
        let size = view.image_size();
        let mut recorded = self.recorded(&state, &view, size, actors_follow_log, &options)?;
        // A recorded image of another pose says nothing about the map.
        let is_truth = GroundTruthImages::new(self.reader).are_known(ego_follows_log, actors_follow_log);
        for camera in set.cameras.iter().filter(|_| is_truth) {
            if let Some((truth, color)) = recorded.get(camera.name.as_str()).zip(camera.color.as_ref()) {
                let psnr_db = compare_filled(color, truth).psnr_db;
                if psnr_db.is_finite() {
                    header.psnr_db.push((camera.name.to_string(), psnr_db));
                }
            }
        }
        let mut jobs = Vec::new();
        let generated = generated.as_ref().map_or(&[][..], |generated| &generated.images.images);
        for (index, camera) in state.cameras.iter().enumerate() {
            let name = camera.view.camera.name.as_str();
            let maps = set.cameras.iter().find(|maps| maps.name == camera.view.camera.name);
            for shown in view.shown(name) {
                match shown {
                    Shown::Map(kind) => jobs.extend(maps.map(|maps| Job::Map(maps, *kind))),
                    Shown::Recorded => {
                        jobs.extend(recorded.remove(name).map(|pixels| Job::Recorded(name, pixels)))
                    }
                    Shown::Generated => {
                        jobs.extend(generated.get(index).map(|image| Job::Generated(name, image)))
                    }
                }
            }
        }
        jobs.extend(view.birdseye_options().map(Job::Birdseye));
        let encode = |job: &Job<'_>| job.encode(&view, size, &options, &state, &traces);
        let encoded: Vec<_> = jobs.par_iter().map(encode).collect::<Result<Vec<_>, String>>()?;
        let (headers, images): (Vec<_>, Vec<_>) = encoded.into_iter().flatten().unzip();
        header.images = headers;
        header.times_ms.encode = 1e3 * start.elapsed().as_secs_f64();
        Ok((header.frame, packed(&header, &images)))
    }

    /// Returns the recorded images of the cameras that show them, without lens distortion, at the size of the
    /// maps: of the log's images those that are nearest in time.
    fn recorded(
        &self,
        state: &SceneState,
        view: &View,
        size: ImageSize,
        actors_follow_log: bool,
        options: &MapOptions,
    ) -> Result<BTreeMap<String, Pixels>, String> {
        let names = state.cameras.iter().map(|camera| camera.view.camera.name.to_string());
        let wanted: Vec<String> = names.filter(|name| view.shown(name).contains(&Shown::Recorded)).collect();
        if wanted.is_empty() {
            return Ok(BTreeMap::new());
        }
        let truth = GroundTruthImages::new(self.reader);
        if self.reader.view_renderer().is_some() {
            let drawn = |view: &_| options.conditions.drawn_view(view);
            let images = truth.of(state, drawn, size, actors_follow_log).map_err(|e| with_causes(&e))?;
            let images = state.cameras.iter().zip(images);
            let pixels = images.map(|(camera, image)| {
                (camera.view.camera.name.to_string(), image.pixels().map(|pixel| pixel.0).collect())
            });
            return Ok(pixels.filter(|(name, _)| wanted.contains(name)).collect());
        }
        let log = self.reader.recording();
        let read = |name: &String| -> Option<Result<(String, Pixels), String>> {
            let record = log.nearest_image(name, state.t_us)?;
            let key = (name.clone(), record.t_us, [size.height, size.width]);
            if let Some(known) = self.kept().get(&key) {
                return Some(Ok((name.clone(), known.clone())));
            }
            let image = match truth.of_record(record) {
                Ok(image) => image,
                Err(error) => return Some(Err(with_causes(&error))),
            };
            let from = ImageSize { height: image.height(), width: image.width() };
            let pixels: Pixels = image.pixels().map(|pixel| pixel.0).collect();
            let pixels = reduce::pil_bilinear(&pixels, from, size);
            let mut kept = self.kept();
            if kept.len() >= KEPT {
                kept.clear();
            }
            kept.insert(key, pixels.clone());
            Some(Ok((name.clone(), pixels)))
        };
        wanted.par_iter().filter_map(read).collect()
    }

    fn kept(&self) -> std::sync::MutexGuard<'_, BTreeMap<Key, Pixels>> {
        self.recorded.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

impl Job<'_> {
    fn encode(
        &self,
        view: &View,
        size: ImageSize,
        options: &MapOptions,
        state: &SceneState,
        traces: &[Trace],
    ) -> Result<Option<(ImageHeader, Vec<u8>)>, String> {
        let header =
            |camera: &str, map: &'static str, size: ImageSize, codec: Codec, bytes: &[u8]| ImageHeader {
                camera: camera.to_owned(),
                map,
                codec: if codec == Codec::Png { "png" } else { "jpeg" },
                bytes: bytes.len(),
                width: size.width,
                height: size.height,
            };
        let (camera, map, size, codec, bytes) = match self {
            Self::Map(maps, kind) => {
                let bytes = match view.codec {
                    Codec::Png => map_png(maps, *kind, options)?,
                    Codec::Jpeg => {
                        let pixels = sheet::picture(maps, *kind, &options.conditions.depth_bins);
                        pixels.map(|pixels| jpeg(&pixels, maps.size())).transpose()?
                    }
                };
                let Some(bytes) = bytes else { return Ok(None) };
                (maps.name.as_str(), kind.name(), maps.size(), view.codec, bytes)
            }
            Self::Recorded(camera, pixels) => (*camera, RECORDED, size, Codec::Jpeg, jpeg(pixels, size)?),
            Self::Generated(camera, image) => {
                let size = ImageSize { height: image.height(), width: image.width() };
                let bytes = match view.codec {
                    Codec::Png => image_png(image)?,
                    Codec::Jpeg => jpeg(image.as_raw().as_chunks().0, size)?,
                };
                (*camera, GENERATED, size, view.codec, bytes)
            }
            Self::Birdseye(birdseye) => {
                let (size, pixels) = birdseye::draw_with(state, traces, birdseye);
                ("", BIRDSEYE, size, Codec::Jpeg, jpeg(&pixels, size)?)
            }
        };
        Ok(Some((header(camera, map, size, codec, &bytes), bytes)))
    }
}

/// Returns the PNG file of a map, as `pskel render` and `pskel simulate` write it; `None` if there is none.
pub(crate) fn map_png(
    camera: &CameraConditions,
    kind: MapKind,
    options: &MapOptions,
) -> Result<Option<Vec<u8>>, String> {
    let name = format!("{}/{}.png", camera.name, kind.name());
    let bytes = png::encode_map(Path::new(&name), camera, kind, &options.conditions.depth_bins);
    bytes.map_err(|error| with_causes(&error))
}

/// Returns the PNG file of an image, as a rollout has it.
pub(crate) fn image_png(image: &RgbImage) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    let encoded = image.write_to(&mut std::io::Cursor::new(&mut bytes), image::ImageFormat::Png);
    encoded.map_err(|error| format!("an image cannot be encoded: {error}"))?;
    Ok(bytes)
}

fn jpeg(pixels: &[[u8; 3]], size: ImageSize) -> Result<Vec<u8>, String> {
    let sides = [size.width, size.height].map(u16::try_from);
    let [Ok(width), Ok(height)] = sides else {
        return Err(format!(
            "expected an image of at most 65535 pixels a side, found {}x{}",
            size.height, size.width
        ));
    };
    let mut bytes = Vec::with_capacity(pixels.len() / 4);
    let encoder = JpegEncoder::new(&mut bytes, QUALITY);
    let encoded = encoder.encode(pixels.as_flattened(), width, height, ColorType::Rgb);
    encoded.map_err(|error| format!("an image cannot be encoded: {error}"))?;
    Ok(bytes)
}
