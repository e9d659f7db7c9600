use half::{bf16, f16};
use point_skeleton::conditions::tensor::{LAYOUT_CHANNELS, POINT_CHANNELS};
use point_skeleton::conditions::{DepthBins, DepthEmbedding, Prompts, TensorEncoder};
use pskel_sim::peer::ProtocolError;
use safetensors::Dtype;

use super::hello::{DenoiserOutputs, Precision};
use super::message::{Answer, Tensor, message};
use super::sent::{Numbered, SentFrames};
use crate::{
    CAMERA_NUMBERS, DenoiserError, DroppedConditions, Frame, FrameConditions, GuidedPrediction, Latent,
    LatentShape,
};

const CALL: &str = "call";
const PREDICTION: &str = "prediction";
const UNCONDITIONAL: &str = "unconditional";

/// Serializes a window as a `predict` request. All latents are of `shape`, all conditions of one size. With
/// `dropped` conditions it asks for both halves of guidance. With `sent`, the conditions are sent once.
pub(super) fn request(
    window: &[Frame<'_, FrameConditions>],
    shape: LatentShape,
    call: u64,
    dropped: Option<DroppedConditions>,
    sent: Option<&mut SentFrames>,
) -> Result<Vec<u8>, DenoiserError> {
    let [views, channels, height, width] = shape.to_array();
    let levels = |of: fn(&Frame<'_, FrameConditions>) -> f32| {
        Tensor::of_f32(vec![window.len()], window.iter().map(of))
    };
    let latents = window.iter().flat_map(|frame| frame.latent.values().iter().copied());
    let mut tensors = vec![
        ("latents", Tensor::of_f32(vec![window.len(), views, channels, height, width], latents)),
        ("timesteps", levels(|frame| frame.level.timestep)),
        ("sigmas", levels(|frame| frame.level.sigma)),
    ];
    let prompts: Vec<&Prompts> = window.iter().map(|frame| &frame.condition.prompts).collect();
    let references: Vec<bool> = window.iter().map(|frame| frame.is_reference).collect();
    let mut texts = vec![
        ("ask", "predict".to_owned()),
        (CALL, call.to_string()),
        ("references", serde_json::json!(references).to_string()),
        ("prompts", serde_json::json!(prompts).to_string()),
    ];
    texts.extend(dropped.map(|dropped| ("dropped", serde_json::json!(names(dropped)).to_string())));
    let all: Vec<&FrameConditions> = window.iter().map(|frame| frame.condition).collect();
    match sent {
        None => tensors.extend(whole(&all)),
        Some(sent) => {
            let Numbered { numbers, new } = sent.number(&all);
            let (new_numbers, new): (Vec<u64>, Vec<&FrameConditions>) =
                new.iter().map(|position| (numbers[*position], all[*position])).unzip();
            let without = all.first().map_or(DroppedConditions::default(), |frame| frame.dropped);
            texts.push(("frames", serde_json::json!(numbers).to_string()));
            texts.push(("new", serde_json::json!(new_numbers).to_string()));
            texts.push(("without", serde_json::json!(names(without)).to_string()));
            tensors.extend(compact(&new));
        }
    }
    message(texts, tensors)
}

/// Returns the conditions of frames as network inputs.
fn whole(frames: &[&FrameConditions]) -> Vec<(&'static str, Tensor)> {
    let Some(first) = frames.first() else { return Vec::new() };
    let maps = |channels: usize, of: fn(&FrameConditions) -> Vec<f32>| {
        let [height, width] = [first.size.height as usize, first.size.width as usize];
        let shape = vec![frames.len(), first.views(), channels, height, width];
        Tensor::of_f32(shape, frames.iter().flat_map(|frame| of(frame)))
    };
    let mut tensors = vec![
        ("points", maps(POINT_CHANNELS, FrameConditions::points)),
        ("layout", maps(LAYOUT_CHANNELS, FrameConditions::layout)),
    ];
    tensors.extend(motion(frames, first.views()));
    tensors
}

/// Returns the conditions of frames as bytes and depth bins, and the depth channels of each bin.
fn compact(frames: &[&FrameConditions]) -> Vec<(&'static str, Tensor)> {
    let Some(first) = frames.first() else { return Vec::new() };
    let sides = [frames.len(), first.views(), first.size.height as usize, first.size.width as usize];
    let rgb = |of: fn(&FrameConditions) -> &Vec<[u8; 3]>| {
        let bytes = frames.iter().flat_map(|frame| of(frame).as_flattened().iter().copied()).collect();
        Tensor::of_bytes([&sides[..], &[3]].concat(), bytes)
    };
    let bins = frames.iter().flat_map(|frame| frame.bins.iter().flat_map(|bin| bin.to_le_bytes()));
    let depth_channels = POINT_CHANNELS - 3;
    let values = depth_values(first.depth_bins);
    let mut tensors = vec![
        ("color", rgb(|frame| &frame.color)),
        ("bins", Tensor { dtype: Dtype::U16, shape: sides.to_vec(), bytes: bins.collect() }),
        ("boxes", rgb(|frame| &frame.boxes)),
        ("map", rgb(|frame| &frame.map)),
        (
            "depth_values",
            Tensor::of_f32(vec![depth_channels, values.len() / depth_channels], values.into_iter()),
        ),
    ];
    tensors.extend(motion(frames, first.views()));
    tensors
}

/// Returns the depth channels of every bin, `[17, count + 1]`; bin 0 is empty.
fn depth_values(bins: DepthBins) -> Vec<f32> {
    let all: Vec<u16> = (0..=bins.count).collect();
    let black = vec![[0; 3]; all.len()];
    TensorEncoder::new(bins, DepthEmbedding::Both).points_of_bins(&black, &all).split_off(3 * all.len())
}

/// Returns the motion and the cameras of frames.
fn motion(frames: &[&FrameConditions], views: usize) -> [(&'static str, Tensor); 2] {
    let action = frames.iter().flat_map(|frame| frame.action);
    let cameras = frames.iter().flat_map(|frame| frame.cameras.as_flattened().iter().copied());
    [
        ("action", Tensor::of_f32(vec![frames.len(), 3], action)),
        ("cameras", Tensor::of_f32(vec![frames.len(), views, CAMERA_NUMBERS], cameras)),
    ]
}

/// Returns the names of dropped conditions.
fn names(dropped: DroppedConditions) -> Vec<&'static str> {
    let DroppedConditions { layout, action, color, depth } = dropped;
    let all = [("layout", layout), ("action", action), ("color", color), ("depth", depth)];
    all.into_iter().filter(|(_, is_dropped)| *is_dropped).map(|(name, _)| name).collect()
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
