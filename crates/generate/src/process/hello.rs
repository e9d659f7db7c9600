use point_skeleton::geometry::ImageSize;
use pskel_sim::peer::ProtocolError;

use super::connection::MAX_ANSWER_BYTES;
use super::message::{Answer, message};
use super::rig::DenoiserRig;
use crate::{DenoiserError, LatentShape, Prediction, SamplerOptions};

const PROTOCOL: &str = "pskel-denoiser";
const VERSION: &str = "1";

/// Inputs of the denoiser, announced in the hello.
#[derive(Clone, Copy, Debug)]
pub(super) struct DenoiserInputs {
    /// Number of frames in the window, L.
    pub(super) window: usize,
    /// Number of cameras, V.
    pub(super) views: usize,
    /// Size of the conditions, H x W.
    pub(super) size: ImageSize,
    /// Sampler, which determines the quantity to predict.
    pub(super) sampler: SamplerOptions,
}

/// Outputs of the denoiser, announced in its answer to the hello.
#[derive(Clone, Copy, Debug)]
pub(super) struct DenoiserOutputs {
    /// Latent shape of a frame, `[V, C, h, w]`.
    pub(super) shape: LatentShape,
    pub(super) precision: Precision,
    /// Size of the images that the process encodes and decodes itself; `None` if its latents are pixels.
    pub(super) images: Option<ImageSize>,
    /// Whether it predicts both halves of guidance in one call.
    pub(super) is_guided: bool,
    /// Whether it keeps conditions by number, which are then sent once.
    pub(super) keeps_frames: bool,
}

/// Number format of predictions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Precision {
    F32,
    F16,
    Bf16,
}

pub(super) fn hello(taken: &DenoiserInputs, rig: &DenoiserRig) -> Result<Vec<u8>, DenoiserError> {
    let sizes: Vec<[u32; 2]> = rig.image_sizes.iter().map(|size| [size.width, size.height]).collect();
    let (sampler, prediction) = match taken.sampler {
        SamplerOptions::FlowMatch { .. } => ("flow_match", "velocity"),
        SamplerOptions::Ddim { prediction: Prediction::Epsilon } => ("ddim", "epsilon"),
        SamplerOptions::Ddim { prediction: Prediction::Sample } => ("ddim", "sample"),
        SamplerOptions::Ddim { prediction: Prediction::Velocity } => ("ddim", "velocity"),
    };
    let texts = [
        ("protocol", PROTOCOL.to_owned()),
        ("version", VERSION.to_owned()),
        ("window", taken.window.to_string()),
        ("views", taken.views.to_string()),
        ("condition_size", format!("{},{}", taken.size.height, taken.size.width)),
        ("sampler", sampler.to_owned()),
        ("prediction", prediction.to_owned()),
        ("fps", rig.fps.to_string()),
        ("cameras", serde_json::json!(rig.cameras).to_string()),
        ("image_sizes", serde_json::json!(sizes).to_string()),
    ];
    message(texts, [])
}

/// Parses and validates the answer to the hello.
pub(super) fn read_hello(answer: &[u8], taken: &DenoiserInputs) -> Result<DenoiserOutputs, ProtocolError> {
    let answer = Answer::read(answer)?;
    let text = |name: &str| answer.texts.get(name).map_or("", String::as_str);
    if (text("protocol"), text("version")) != (PROTOCOL, VERSION) {
        let found =
            format!("`protocol` {} of `version` {}", answer.quoted("protocol"), answer.quoted("version"));
        return Err(ProtocolError::new(format!("`protocol` {PROTOCOL:?} of `version` {VERSION:?}"), found));
    }
    let shape = latent_shape(text("latent_shape")).filter(|shape| shape.views == taken.views);
    let shape = shape.ok_or_else(|| {
        let expected = format!("`latent_shape` \"V,C,h,w\" of positive numbers with V = {}", taken.views);
        ProtocolError::new(expected, answer.quoted("latent_shape"))
    })?;
    let precision = Precision::named(text("dtype"));
    let precision = precision
        .ok_or_else(|| ProtocolError::new("`dtype` \"F32\", \"F16\" or \"BF16\"", answer.quoted("dtype")))?;
    let is_guided = flag(&answer, "guidance")?;
    let keeps_frames = flag(&answer, "frames")?;
    // Half of the limit leaves room for the header.
    let most = (MAX_ANSWER_BYTES / 2) as usize / size_of::<f32>() / taken.window.max(1);
    let most_latents = if is_guided { most / 2 } else { most };
    if shape.len() > most_latents {
        let expected =
            format!("`latent_shape` of at most {most_latents} values in a window of {}", taken.window);
        return Err(ProtocolError::new(expected, answer.quoted("latent_shape")));
    }
    let images = answer.texts.get("image_size").map(|text| {
        let fits = |size: &ImageSize| 3 * taken.views * size.pixels() <= most;
        image_size(text).filter(fits).ok_or_else(|| {
            let expected = format!(
                "`image_size` \"H,W\" of positive numbers, {} images of at most {most} values",
                taken.views
            );
            ProtocolError::new(expected, answer.quoted("image_size"))
        })
    });
    Ok(DenoiserOutputs { shape, precision, images: images.transpose()?, is_guided, keeps_frames })
}

/// Parses an optional `true` or `false`.
fn flag(answer: &Answer<'_>, name: &str) -> Result<bool, ProtocolError> {
    match answer.texts.get(name).map(String::as_str) {
        None | Some("false") => Ok(false),
        Some("true") => Ok(true),
        Some(_) => {
            let expected = format!("`{name}` \"true\" or \"false\"");
            Err(ProtocolError::new(expected, answer.quoted(name)))
        }
    }
}

/// Parses `H,W`, two positive numbers.
pub(crate) fn image_size(text: &str) -> Option<ImageSize> {
    let (height, width) = text.split_once(',')?;
    let side = |text: &str| text.trim().parse::<u32>().ok().filter(|side| (1..=1 << 15).contains(side));
    Some(ImageSize { height: side(height)?, width: side(width)? })
}

/// Parses `V,C,h,w`, four positive numbers whose product does not overflow.
fn latent_shape(text: &str) -> Option<LatentShape> {
    let sizes: Result<Vec<usize>, _> = text.split(',').map(|size| size.trim().parse()).collect();
    let &[views, channels, height, width] = sizes.ok()?.as_slice() else { return None };
    let product = [views, channels, height, width].iter().try_fold(1usize, |all, n| all.checked_mul(*n));
    product.filter(|values| *values > 0)?;
    Some(LatentShape { views, channels, height, width })
}

impl Precision {
    /// Parses the safetensors name of a number format.
    fn named(name: &str) -> Option<Self> {
        match name {
            "F32" => Some(Self::F32),
            "F16" => Some(Self::F16),
            "BF16" => Some(Self::Bf16),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn image_sizes_are_two_positive_numbers() {
        assert_eq!(image_size("256, 448"), Some(ImageSize { height: 256, width: 448 }));
        for text in ["", "256", "0,448", "256,-1", "256,448,3", "99999999,1"] {
            assert_eq!(image_size(text), None, "{text:?}");
        }
    }

    #[test]
    fn shapes_are_four_positive_numbers() {
        let shape = LatentShape { views: 6, channels: 48, height: 14, width: 25 };
        assert_eq!([latent_shape("6,48,14,25"), latent_shape(" 6, 48,14 ,25")], [Some(shape); 2]);
        let huge = format!("6,{},2,2", usize::MAX / 4);
        for text in ["", "6,48,14", "6,48,14,25,1", "6,48,0,25", "6,48,-1,25", "6,48,14,x", &huge] {
            assert_eq!(latent_shape(text), None, "{text:?}");
        }
    }
}
