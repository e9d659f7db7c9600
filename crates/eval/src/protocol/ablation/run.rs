//! Generation and scoring of one variant in a scene.

use std::collections::BTreeMap;
use std::path::Path;

use image::RgbImage;
use image::imageops::{self, FilterType};
use point_skeleton::error::FileError;
use point_skeleton::files::json;
use point_skeleton::files::write_whole;
use pskel_generate::{Codec, Condition, FrameConditions, GaussianNoise, Generator};
use pskel_sim::{Committed, Forecast};
use serde::{Deserialize, Serialize};

use super::error::AblationError;
use super::options::{AblationOptions, Networks, Origin};
use super::rows::Row;
use super::scene::{Scene, SceneFrame};
use crate::{RolloutScores, ScoredFrame};

/// Result of a variant in a scene, `SCENE/ROW.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunResult {
    /// Name of the scene.
    pub scene: String,
    /// Stem of the variant's file names.
    pub row: String,
    /// Provenance.
    pub origin: Origin,
    /// Scores by metric name; `None` if the metric is undefined in the scene.
    pub numbers: BTreeMap<String, Option<f64>>,
    /// Time since the first reference, seconds.
    pub t_s: Vec<f64>,
    /// PSNR by step, dB.
    pub psnr_db: Vec<Option<f64>>,
}

/// Image strip of a variant, for visual inspection.
pub(super) struct Strip(RgbImage);

/// Number of images in a strip, and their magnification.
const SHOWN: usize = 8;
const ENLARGED: u32 = 3;

impl RunResult {
    /// Reads the result of an earlier run, which must have the same network and settings.
    pub(super) fn read(path: &Path, origin: &Origin) -> Result<Self, FileError> {
        let damaged =
            |error: serde_json::Error| FileError::content("scores of a scene", error.to_string(), path);
        let result: Self = json::read(path, "scores of a scene")?;
        if result.origin == *origin {
            return Ok(result);
        }
        let [now, before] = [origin, &result.origin].map(serde_json::to_string);
        let expected = format!("scores of {}", now.map_err(damaged)?);
        Err(FileError::content(expected, before.map_err(damaged)?, path))
    }
}

/// Generates and scores all frames of a scene.
pub(super) fn run(
    scene: &Scene,
    row: &Row,
    networks: &Networks,
    study: &AblationOptions,
) -> Result<(RunResult, Strip), AblationError> {
    let network = networks.get(row.network);
    let given = |conditions: &Committed<FrameConditions>| conditions.clone().map(|c| c.without(row.dropped));
    let options = row.options(networks);
    let (before, frames) = scene.frames.split_at(options.references());
    let reference = |frame: &SceneFrame| Ok((network.encode(&frame.truth)?, given(&frame.conditions)));
    let references = before.iter().map(reference).collect::<Result<Vec<_>, AblationError>>()?;
    let noise = GaussianNoise { seed: study.seed };
    let mut generator = Generator::new(network.clone(), noise, options, references)?;
    let mut scores = RolloutScores::default();
    let mut strip = Strip::new(frames);
    for (number, frame) in frames.iter().enumerate() {
        let expected = |forecast: &Forecast<FrameConditions>| match row.expects_standstill {
            true => frame.conditions.get().without(row.dropped),
            false => forecast.get().without(row.dropped),
        };
        let forecasts: Vec<_> = frame.forecasts.iter().map(expected).map(Forecast::new).collect();
        let conditions = given(&frame.conditions);
        let latent = generator.step(conditions.clone(), &forecasts)?;
        let images = network.decode(&latent, conditions.get())?;
        strip.add(number, frames.len(), &images, &frame.truth);
        scores.push(&ScoredFrame {
            t_s: frame.t_s,
            generated: &images,
            truth: Some(&frame.truth),
            class: None,
            moving: Some(&frame.moving),
            masks: None,
        })?;
    }
    let scores = scores.finish();
    let result = RunResult {
        scene: scene.name.clone(),
        row: row.name.clone(),
        origin: row.origin(networks, study),
        numbers: scores.numbers(),
        t_s: scores.t_s,
        psnr_db: scores.psnr_db.steps,
    };
    Ok((result, strip))
}

impl Strip {
    /// Creates a strip of two rows: generated images above, ground truth below.
    fn new(frames: &[SceneFrame]) -> Self {
        let (width, height) =
            frames.first().and_then(|f| f.truth.first()).map_or((1, 1), RgbImage::dimensions);
        Self(RgbImage::new(SHOWN as u32 * width * ENLARGED, 2 * height * ENLARGED))
    }

    /// Adds the first camera's images if the frame is one of those shown.
    fn add(&mut self, number: usize, all: usize, images: &[RgbImage], truth: &[RgbImage]) {
        let Some(place) = (0..SHOWN).find(|place| (place + 1) * all / SHOWN == number + 1) else { return };
        for (row, image) in [images, truth].into_iter().enumerate() {
            let Some(image) = image.first() else { continue };
            let (width, height) = (image.width() * ENLARGED, image.height() * ENLARGED);
            let large = imageops::resize(image, width, height, FilterType::Nearest);
            imageops::replace(
                &mut self.0,
                &large,
                i64::from(width) * place as i64,
                i64::from(height) * row as i64,
            );
        }
    }

    pub(super) fn save(&self, path: &Path) -> Result<(), FileError> {
        write_whole(path, |out| {
            let written = self.0.write_with_encoder(image::codecs::png::PngEncoder::new(out));
            written.map_err(|error| FileError::io("write", path)(std::io::Error::other(error)))
        })
    }
}
