//! Maps as arrays over all cameras, the form that [`npz`](super::npz) and [`safetensors`](super::safetensors)
//! store.

use std::borrow::Cow;
use std::path::Path;

use crate::conditions::tensor::{LAYOUT_CHANNELS, POINT_CHANNELS};
use crate::conditions::{CameraConditions, ConditionError, ConditionSet, EMPTY_DEPTH_M, MapKind, MapPixels};
use crate::raster::PixelType;

/// Number type of an array.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) enum Scalar {
    F32,
    U32,
    U8,
}

/// One map of all cameras; little-endian, the byte order of all supported machines.
pub(in super::super) struct Array<'a> {
    pub(in super::super) name: &'static str,
    pub(in super::super) scalar: Scalar,
    /// Cameras are the first axis.
    pub(in super::super) shape: Vec<usize>,
    /// Bytes of each camera, in camera order.
    pub(in super::super) parts: Vec<Cow<'a, [u8]>>,
}

impl Array<'_> {
    /// Returns the length of all parts, bytes.
    pub(in super::super) fn bytes(&self) -> usize {
        self.parts.iter().map(|part| part.len()).sum()
    }
}

/// Returns all arrays of a set, in the order of [`MapKind::ALL`]; `path` is the file that errors name.
///
/// # Errors
/// Returns an error if the cameras differ in size.
pub(in super::super) fn arrays<'a>(
    set: &'a ConditionSet,
    path: &Path,
) -> Result<Vec<Array<'a>>, ConditionError> {
    check_sizes(set, path)?;
    Ok(MapKind::ALL.into_iter().flat_map(|kind| arrays_of(set, kind)).collect())
}

fn check_sizes(set: &ConditionSet, path: &Path) -> Result<(), ConditionError> {
    let Some(first) = set.cameras.first() else { return Ok(()) };
    let described = |camera: &CameraConditions| format!("{} at {}", camera.name, camera.size());
    match set.cameras.iter().find(|camera| camera.size() != first.size()) {
        None => Ok(()),
        Some(other) => Err(ConditionError::Sizes {
            first: described(first),
            other: described(other),
            path: path.to_owned(),
        }),
    }
}

/// Position of the channels in an array's shape (cameras not counted): none, before, or after height and
/// width.
#[derive(Clone, Copy)]
enum Channels {
    None,
    First(usize),
    Last(usize),
}

fn arrays_of(set: &ConditionSet, kind: MapKind) -> Vec<Array<'_>> {
    let array = |name, scalar, channels, bytes: fn(MapPixels<'_>) -> Option<Cow<'_, [u8]>>| {
        // All cameras of a set have the same maps.
        let parts =
            set.cameras.iter().map(|camera| bytes(camera.pixels(kind)?)).collect::<Option<Vec<_>>>()?;
        Some(Array { name, scalar, shape: shape(set, channels), parts })
    };
    let (name, gray) = (kind.name(), Channels::None);
    let found = match kind.description().pixels {
        PixelType::Rgb => array(name, Scalar::U8, Channels::Last(3), bytes),
        PixelType::Depth => array(name, Scalar::F32, gray, bytes),
        PixelType::Class => array(name, Scalar::U8, gray, bytes),
        PixelType::Number => array(name, Scalar::U32, gray, bytes),
        PixelType::Channels => {
            let points = array("points", Scalar::F32, Channels::First(POINT_CHANNELS), bytes);
            let layout = array("layout", Scalar::F32, Channels::First(LAYOUT_CHANNELS), layout_bytes);
            return points.into_iter().chain(layout).collect();
        }
    };
    found.into_iter().collect()
}

/// Returns the samples of a map; for the network input, its point channels.
fn bytes(pixels: MapPixels<'_>) -> Option<Cow<'_, [u8]>> {
    Some(match pixels {
        MapPixels::Rgb(map) => Cow::Borrowed(map.as_flattened()),
        MapPixels::Depth(map) => meters(map),
        MapPixels::Class(map) => Cow::Borrowed(map),
        MapPixels::Number(map) => Cow::Borrowed(bytemuck::cast_slice(map)),
        MapPixels::Channels(tensor) => Cow::Borrowed(bytemuck::cast_slice(&tensor.points)),
    })
}

/// Returns the layout channels of the network input.
fn layout_bytes(pixels: MapPixels<'_>) -> Option<Cow<'_, [u8]>> {
    let MapPixels::Channels(tensor) = pixels else { return None };
    Some(Cow::Borrowed(bytemuck::cast_slice(&tensor.layout)))
}

fn shape(set: &ConditionSet, channels: Channels) -> Vec<usize> {
    let [height, width] = set.cameras.first().map_or([0, 0], |c| [c.height as usize, c.width as usize]);
    let count = set.cameras.len();
    match channels {
        Channels::None => vec![count, height, width],
        Channels::First(channels) => vec![count, channels, height, width],
        Channels::Last(channels) => vec![count, height, width, channels],
    }
}

fn meters(depth_m: &[f32]) -> Cow<'_, [u8]> {
    let meters = |d: &f32| if d.is_finite() { *d } else { EMPTY_DEPTH_M };
    Cow::Owned(depth_m.iter().flat_map(|d| meters(d).to_le_bytes()).collect())
}
