use half::{bf16, f16};
use point_skeleton::conditions::Prompts;
use point_skeleton::conditions::tensor::{LAYOUT_CHANNELS, POINT_CHANNELS};
use point_skeleton::geometry::ImageSize;
use pskel_sim::peer::ProtocolError;
use safetensors::Dtype;

use super::hello::{DenoiserOutputs, Precision};
use super::message::{Answer, Values, message};
use crate::{
    CAMERA_NUMBERS, DenoiserError, DroppedConditions, Frame, FrameConditions, GuidedPrediction, Latent,
    LatentShape,
};

const CALL: &str = "call";
const PREDICTION: &str = "prediction";
const UNCONDITIONAL: &str = "unconditional";

/// Serializes a window as a `predict` request. All latents are of `shape`, all conditions of one size. With
/// `dropped` conditions it asks for both halves of guidance.
pub(super) fn request(
    window: &[Frame<'_, FrameConditions>],
    shape: LatentShape,
    call: u64,
    dropped: Option<DroppedConditions>,
) -> Result<Vec<u8>, DenoiserError> {
    let frames = window.len();
    let [views, channels, height, width] = shape.to_array();
    let size = window.first().map_or(ImageSize { height: 0, width: 0 }, |frame| frame.condition.size);
    let maps = |channels: usize| vec![frames, views, channels, size.height as usize, size.width as usize];
    let timesteps: Vec<f32> = window.iter().map(|frame| frame.level.timestep).collect();
    let sigmas: Vec<f32> = window.iter().map(|frame| frame.level.sigma).collect();
    let owned = |of: fn(&FrameConditions) -> Vec<f32>| -> Vec<Vec<f32>> {
        window.iter().map(|frame| of(frame.condition)).collect()
    };
    let (points, layout) = (owned(FrameConditions::points), owned(FrameConditions::layout));
    let tensors = [
        ("latents", vec![frames, views, channels, height, width], parts(window, |f| f.latent.values())),
        ("timesteps", vec![frames], vec![timesteps.as_slice()]),
        ("sigmas", vec![frames], vec![sigmas.as_slice()]),
        ("points", maps(POINT_CHANNELS), slices(&points)),
        ("layout", maps(LAYOUT_CHANNELS), slices(&layout)),
        ("action", vec![frames, 3], parts(window, |f| &f.condition.action)),
        (
            "cameras",
            vec![frames, views, CAMERA_NUMBERS],
            parts(window, |f| f.condition.cameras.as_flattened()),
        ),
    ];
    let prompts: Vec<&Prompts> = window.iter().map(|frame| &frame.condition.prompts).collect();
    let references: Vec<bool> = window.iter().map(|frame| frame.is_reference).collect();
    let texts = [
        ("ask", "predict".to_owned()),
        (CALL, call.to_string()),
        ("references", serde_json::json!(references).to_string()),
        ("prompts", serde_json::json!(prompts).to_string()),
    ];
    let dropped = dropped.map(|dropped| ("dropped", serde_json::json!(names(dropped)).to_string()));
    message(
        texts.into_iter().chain(dropped),
        tensors.map(|(name, shape, parts)| (name, Values { shape, parts })),
    )
}

fn slices(all: &[Vec<f32>]) -> Vec<&[f32]> {
    all.iter().map(Vec::as_slice).collect()
}

/// Returns the names of dropped conditions.
fn names(dropped: DroppedConditions) -> Vec<&'static str> {
    let DroppedConditions { layout, action, color, depth } = dropped;
    let all = [("layout", layout), ("action", action), ("color", color), ("depth", depth)];
    all.into_iter().filter(|(_, is_dropped)| *is_dropped).map(|(name, _)| name).collect()
}

fn parts<'a>(
    window: &[Frame<'a, FrameConditions>],
    of: impl Fn(Frame<'a, FrameConditions>) -> &'a [f32],
) -> Vec<&'a [f32]> {
    window.iter().map(|frame| of(*frame)).collect()
}

/// Parses the predictions for a window of `frames` frames.
pub(super) fn read_prediction(
    answer: &[u8],
    given: DenoiserOutputs,
    frames: usize,
    call: u64,
) -> Result<Vec<Latent>, ProtocolError> {
    latents(&numbered(answer, call)?, PREDICTION, given, frames)
}

/// Parses both predictions for a window of `frames` frames.
pub(super) fn read_guided(
    answer: &[u8],
    given: DenoiserOutputs,
    frames: usize,
    call: u64,
) -> Result<GuidedPrediction, ProtocolError> {
    let answer = numbered(answer, call)?;
    Ok(GuidedPrediction {
        conditional: latents(&answer, PREDICTION, given, frames)?,
        unconditional: latents(&answer, UNCONDITIONAL, given, frames)?,
    })
}

/// Reads an answer and checks its number.
fn numbered(answer: &[u8], call: u64) -> Result<Answer<'_>, ProtocolError> {
    let answer = Answer::read(answer)?;
    if answer.texts.get(CALL).is_some_and(|answered| *answered != call.to_string()) {
        return Err(ProtocolError::new(format!("an answer to `call` \"{call}\""), answer.quoted(CALL)));
    }
    Ok(answer)
}

/// Reads the latents of `frames` frames.
fn latents(
    answer: &Answer<'_>,
    name: &str,
    given: DenoiserOutputs,
    frames: usize,
) -> Result<Vec<Latent>, ProtocolError> {
    let shape = given.shape;
    let [views, channels, height, width] = shape.to_array();
    let values = read_values(answer, name, given.precision, &[frames, views, channels, height, width])?;
    if let Some((index, value)) = values.iter().enumerate().find(|(_, value)| !value.is_finite()) {
        let position = index / shape.len();
        return Err(ProtocolError::new(
            format!("finite values for frame {position} of the window"),
            value.to_string(),
        ));
    }
    Ok(values.chunks(shape.len()).filter_map(|frame| Latent::new(shape, frame.to_vec())).collect())
}

/// Reads a tensor of the given name, sizes and precision, as `f32`.
pub(super) fn read_values(
    answer: &Answer<'_>,
    name: &str,
    precision: Precision,
    sizes: &[usize],
) -> Result<Vec<f32>, ProtocolError> {
    let dtype = match precision {
        Precision::F32 => Dtype::F32,
        Precision::F16 => Dtype::F16,
        Precision::Bf16 => Dtype::BF16,
    };
    let tensor = answer.tensor(name, (dtype, ", which its hello says,"), sizes)?;
    Ok(values(tensor.data(), precision))
}

fn values(bytes: &[u8], precision: Precision) -> Vec<f32> {
    let halves = || bytes.chunks_exact(2).map(|b| [b[0], b[1]]);
    match precision {
        Precision::F32 => {
            bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
        }
        Precision::F16 => halves().map(|b| f16::from_le_bytes(b).to_f32()).collect(),
        Precision::Bf16 => halves().map(|b| bf16::from_le_bytes(b).to_f32()).collect(),
    }
}
