//! Condition maps in memory.

use super::{ConditionOptions, MapKind, MapSet, ModelTensor, TensorEncoder, tensor};
use crate::files::FileName;
use crate::geometry::ImageSize;

/// Maps of one camera, row-major `height * width`; `None` for maps that were not requested.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraConditions {
    /// Channel name.
    pub name: FileName,
    /// Width of all maps, pixels.
    pub width: u32,
    /// Height of all maps, pixels.
    pub height: u32,
    /// RGB, black where empty.
    pub color: Option<Vec<[u8; 3]>>,
    /// Camera depth in meters, `f32::INFINITY` where empty.
    pub depth_m: Option<Vec<f32>>,
    /// Coarse class, 0 where empty.
    pub class: Option<Vec<u8>>,
    /// Actor number, 0 where empty and on the background.
    pub instance: Option<Vec<u32>>,
    /// RGB layout of boxes on black.
    pub boxes: Option<Vec<[u8; 3]>>,
    /// RGB layout of the HD map on black.
    pub map: Option<Vec<[u8; 3]>>,
    /// Number of the winning geometry point + 1, 0 where empty.
    pub point: Option<Vec<u32>>,
    /// Network input.
    pub tensor: Option<ModelTensor>,
}

/// Pixels of a map, row-major `height * width`, by their [`PixelType`](crate::raster::PixelType).
#[derive(Clone, Copy, Debug)]
pub enum MapPixels<'a> {
    /// RGB levels.
    Rgb(&'a [[u8; 3]]),
    /// Camera depth in meters, `f32::INFINITY` where empty.
    Depth(&'a [f32]),
    /// Coarse classes.
    Class(&'a [u8]),
    /// Numbers.
    Number(&'a [u32]),
    /// Network input.
    Channels(&'a ModelTensor),
}

impl CameraConditions {
    /// Returns the pixels of a map; `None` if it was not rendered.
    pub fn pixels(&self, kind: MapKind) -> Option<MapPixels<'_>> {
        match kind {
            MapKind::Color => self.color.as_deref().map(MapPixels::Rgb),
            MapKind::Depth => self.depth_m.as_deref().map(MapPixels::Depth),
            MapKind::Class => self.class.as_deref().map(MapPixels::Class),
            MapKind::Instance => self.instance.as_deref().map(MapPixels::Number),
            MapKind::Boxes => self.boxes.as_deref().map(MapPixels::Rgb),
            MapKind::Map => self.map.as_deref().map(MapPixels::Rgb),
            MapKind::Point => self.point.as_deref().map(MapPixels::Number),
            MapKind::Tensor => self.tensor.as_ref().map(MapPixels::Channels),
        }
    }

    /// Returns the size of all maps.
    pub fn size(&self) -> ImageSize {
        ImageSize { height: self.height, width: self.width }
    }

    /// Returns a map whose pixels are RGB; `None` if it was not rendered or the kind is not RGB.
    pub fn rgb(&self, kind: MapKind) -> Option<&[[u8; 3]]> {
        match self.pixels(kind)? {
            MapPixels::Rgb(pixels) => Some(pixels),
            _ => None,
        }
    }

    /// Drops maps that were not requested themselves.
    fn keep_only(&mut self, asked: MapSet) {
        self.color.take_if(|_| !asked.contains(MapKind::Color));
        self.depth_m.take_if(|_| !asked.contains(MapKind::Depth));
        self.boxes.take_if(|_| !asked.contains(MapKind::Boxes));
        self.map.take_if(|_| !asked.contains(MapKind::Map));
    }
}

/// Condition maps of one step, cameras in the step's order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ConditionSet {
    /// One entry per camera.
    pub cameras: Vec<CameraConditions>,
}

impl ConditionSet {
    /// Encodes the model tensors if requested, and drops maps that were rendered only for them.
    pub(super) fn make_tensors(&mut self, asked: &ConditionOptions) {
        if asked.maps.contains(MapKind::Tensor) {
            let encoder = TensorEncoder::new(asked.depth_bins, asked.depth_embedding);
            for camera in &mut self.cameras {
                camera.tensor = encoder.encode(camera);
                camera.keep_only(asked.maps);
            }
        }
    }
}

impl TensorEncoder {
    /// Encodes one camera; `None` if it lacks color, depth or boxes.
    pub fn encode(&self, camera: &CameraConditions) -> Option<ModelTensor> {
        let points = self.points(camera.color.as_ref()?, camera.depth_m.as_ref()?);
        Some(ModelTensor { points, layout: tensor::layout(camera.boxes.as_ref()?, camera.map.as_deref()) })
    }
}
