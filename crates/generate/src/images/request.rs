use std::collections::VecDeque;

use glam::DMat4;
use image::RgbImage;
use point_skeleton::conditions::{CameraConditions, ConditionSet, MapKind, Prompts};
use point_skeleton::geometry::{ImageSize, Pose};
use point_skeleton::scene::{ActorState, SceneCamera, SceneState};
use pskel_sim::peer::ProtocolError;
use safetensors::tensor::{Dtype, SafeTensorError};
use serde_json::{Value, json};

use super::hello::{Wanted, refuse_error};
use crate::process::message::{Answer, Tensor, serialized};

/// Depth of empty pixels in messages, meters.
const EMPTY_DEPTH_M: f32 = -300.0;
const FRAME: &str = "frame";
pub(super) const IMAGES: &str = "images";

/// Frame of a request: the committed planning step, or a forecast.
pub(super) struct RequestFrame<'a> {
    pub(super) state: SceneState,
    pub(super) set: ConditionSet,
    pub(super) prompts: &'a Prompts,
}

/// Serializes the request for the images of a planning step. `size`: of the maps.
pub(super) fn request(
    wanted: &Wanted,
    frame: usize,
    frames: &[RequestFrame<'_>],
    size: ImageSize,
    earlier: &VecDeque<Vec<RgbImage>>,
) -> Result<Vec<u8>, SafeTensorError> {
    let states = || frames.iter().map(|frame| &frame.state);
    let cameras = || states().flat_map(|state| &state.cameras);
    let views = frames.first().map_or(0, |frame| frame.state.cameras.len());
    let each = frames.len();
    let t_us: Vec<i64> = states().map(|state| state.t_us).collect();
    let prompts: Vec<&Prompts> = frames.iter().map(|frame| frame.prompts).collect();
    let actors: Vec<Vec<Value>> = states().map(|state| state.actors.iter().map(actor).collect()).collect();
    let texts = [
        ("ask", "generate".to_owned()),
        (FRAME, frame.to_string()),
        ("t_us", json!(t_us).to_string()),
        ("prompts", json!(prompts).to_string()),
        ("actors", Value::from(actors).to_string()),
    ];
    let mut tensors: Vec<(&'static str, Tensor)> =
        wanted.maps.iter().map(|map| (map.name(), map_tensor(*map, frames, views, size))).collect();
    let mounts = cameras().map(|camera| camera.ego_from_camera.unwrap_or(Pose::IDENTITY));
    let intrinsics = cameras().flat_map(|camera| intrinsics(camera, size));
    tensors.push((
        "global_from_ego",
        Tensor::of_f64(vec![each, 4, 4], states().flat_map(|state| rows(&state.global_from_ego))),
    ));
    tensors.push((
        "ego_from_camera",
        Tensor::of_f64(vec![each, views, 4, 4], mounts.flat_map(|pose| rows(&pose))),
    ));
    tensors.push(("intrinsics", Tensor::of_f64(vec![each, views, 3, 3], intrinsics)));
    if !earlier.is_empty() {
        tensors.push((IMAGES, images_tensor(earlier, views, wanted.size)));
    }
    serialized(texts, tensors)
}

/// Returns a tensor of images `[P, V, h, w, 3]`, oldest first.
pub(super) fn images_tensor(earlier: &VecDeque<Vec<RgbImage>>, views: usize, size: ImageSize) -> Tensor {
    let bytes = earlier.iter().flatten().flat_map(|image| image.as_raw().iter().copied()).collect();
    Tensor {
        dtype: Dtype::U8,
        shape: vec![earlier.len(), views, size.height as usize, size.width as usize, 3],
        bytes,
    }
}

/// Returns the elements of a pose's matrix, row by row.
fn rows(pose: &Pose) -> [f64; 16] {
    DMat4::from(pose.affine()).transpose().to_cols_array()
}

/// Returns the intrinsics in pixels of maps, row by row.
fn intrinsics(camera: &SceneCamera, size: ImageSize) -> [f64; 9] {
    camera.view.camera.resized(size.height, size.width).intrinsics.transpose().to_cols_array()
}

fn actor(actor: &ActorState) -> Value {
    json!({
        "track": actor.track,
        "category": actor.category,
        "class": actor.class,
        "size": actor.cuboid.size.to_array(),
        "global_from_box": rows(&actor.cuboid.pose),
    })
}

/// Returns a map of all frames and cameras; pixels of a map that was not rendered are missing.
fn map_tensor(map: MapKind, frames: &[RequestFrame<'_>], views: usize, size: ImageSize) -> Tensor {
    let sides = [frames.len(), views, size.height as usize, size.width as usize];
    let channels = matches!(map, MapKind::Color | MapKind::Boxes | MapKind::Map).then_some(3);
    let dtype = match map {
        MapKind::Depth => Dtype::F32,
        MapKind::Instance => Dtype::U16,
        _ => Dtype::U8,
    };
    let mut bytes = Vec::new();
    for camera in frames.iter().flat_map(|frame| &frame.set.cameras) {
        add_pixels(map, camera, &mut bytes);
    }
    Tensor { dtype, shape: sides.into_iter().chain(channels).collect(), bytes }
}

fn add_pixels(map: MapKind, camera: &CameraConditions, bytes: &mut Vec<u8>) {
    let rgb = |pixels: &Option<Vec<[u8; 3]>>| pixels.iter().flatten().flatten().copied().collect::<Vec<u8>>();
    match map {
        MapKind::Color => bytes.extend(rgb(&camera.color)),
        MapKind::Boxes => bytes.extend(rgb(&camera.boxes)),
        MapKind::Map => bytes.extend(rgb(&camera.map)),
        MapKind::Class => bytes.extend(camera.class.iter().flatten()),
        MapKind::Instance => {
            // No state has as many actors as 16 bits count.
            let numbers = camera.instance.iter().flatten().map(|number| *number as u16);
            bytes.extend(numbers.flat_map(u16::to_le_bytes));
        }
        MapKind::Depth => {
            let depth_m = camera.depth_m.iter().flatten();
            let depth_m = depth_m.map(|depth_m| if depth_m.is_finite() { *depth_m } else { EMPTY_DEPTH_M });
            bytes.extend(depth_m.flat_map(f32::to_le_bytes));
        }
        MapKind::Point | MapKind::Tensor => {} // never offered
    }
}

/// Reads the images of an answer, one per camera.
pub(super) fn read_images(
    answer: &[u8],
    frame: usize,
    views: usize,
    size: ImageSize,
) -> Result<Vec<RgbImage>, ProtocolError> {
    let answer = Answer::read(answer)?;
    refuse_error(&answer)?;
    if answer.texts.get(FRAME).is_some_and(|answered| *answered != frame.to_string()) {
        return Err(ProtocolError::new(format!("images of `frame` \"{frame}\""), answer.quoted(FRAME)));
    }
    let ImageSize { height, width } = size;
    let sizes = [views, height as usize, width as usize, 3];
    let tensor = answer.tensor(IMAGES, (Dtype::U8, ""), &sizes)?;
    let images = tensor.data().chunks(3 * size.pixels());
    Ok(images.filter_map(|image| RgbImage::from_raw(width, height, image.to_vec())).collect())
}
