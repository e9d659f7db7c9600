//! Color maps of a log against its recorded images.

use point_skeleton::conditions::{ConditionOptions, ImageSize, reduce};
use point_skeleton::dataset::EgoTrack;
use point_skeleton::scene::{GroundTruthImages, SelectionOptions, state_of_images};
use point_skeleton::{Log, MapOptions, Renderer};
use serde::Serialize;

use super::error::FidelityError;
use super::measure::mean;
use crate::{FilledError, compare_filled};

/// Row of the table: color maps of a camera, or of `all`.
#[derive(Clone, Debug, Serialize)]
pub struct CameraRow {
    /// Name of the camera.
    pub camera: String,
    /// Number of compared images.
    pub images: usize,
    /// Means over images; the PSNR is over images with filled pixels.
    pub color: FilledError,
}

/// Renders each image of frames at its own time, since actors move between the images of a frame, and
/// compares it without lens distortion.
pub(super) fn measure(
    log: &Log,
    renderer: &mut Renderer<'_>,
    frames: impl Iterator<Item = usize>,
    options: &ConditionOptions,
    on_step: &mut dyn FnMut(&str),
) -> Result<Vec<CameraRow>, FidelityError> {
    let (recording, recorded) = (log.recording(), GroundTruthImages::new(log.reader()));
    let ego = EgoTrack::new(recording);
    let ends_us = ego.poses().first().zip(ego.poses().last()).map(|((first, _), (last, _))| (*first, *last));
    let maps = MapOptions::new(options.clone(), SelectionOptions::default());
    let mut errors: Vec<(usize, FilledError)> = Vec::new();
    for frame in frames {
        for record in recording.frames.get(frame).map_or(&[][..], |frame| &frame.images) {
            // The first and the last images may be outside of the recorded poses.
            let t_us = ends_us.map(|(first, last)| record.t_us.clamp(first, last));
            let state = t_us.and_then(|t_us| state_of_images(recording, &ego, t_us, &[record]));
            let none = || FidelityError::NoFrame { frame, log: recording.shown_name().into_owned() };
            let state = state.ok_or_else(none)?;
            let set = renderer.render_with(&state, &maps)?.set;
            let image = recorded.of_record(record)?;
            let from = ImageSize { height: image.height(), width: image.width() };
            let pixels: Vec<[u8; 3]> = image.pixels().map(|pixel| pixel.0).collect();
            for (camera, maps) in state.cameras.iter().zip(&set.cameras) {
                let truth = reduce::pil_bilinear(&pixels, from, options.written_size(&camera.view));
                errors.extend(maps.color.as_ref().map(|map| (record.channel, compare_filled(map, &truth))));
            }
        }
        on_step(&format!("frame {frame:06}"));
    }
    let row = |camera: &str, channel: Option<usize>| {
        let of = errors.iter().filter(|(other, _)| channel.is_none_or(|channel| channel == *other));
        let errors: Vec<FilledError> = of.map(|(_, error)| *error).collect();
        CameraRow { camera: camera.to_owned(), images: errors.len(), color: mean(&errors) }
    };
    let cameras = recording.cameras.iter().enumerate().map(|(channel, name)| row(name, Some(channel)));
    Ok(cameras.chain([row("all", None)]).collect())
}
