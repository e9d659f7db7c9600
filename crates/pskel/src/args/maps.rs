use clap::Args;
use point_skeleton::conditions::{
    BinScale, ColorFilter, ConditionOptions, DepthBins, DepthEmbedding, LayoutLayers, LayoutStyle, LineWidth,
    MapFormat, MapKind, MapSet, Occlusion,
};
use point_skeleton::scene::{SelectionOptions, TemplateFit};

use super::names::names;
use super::numbers;
use super::size::SizeArgs;
use crate::WrongUsage;

/// Options of condition maps, shared by all commands that render a log.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Maps")]
pub(crate) struct MapArgs {
    /// Maps to render: color, depth, class, instance, boxes, map (the log's HD map), point (point numbers),
    /// and tensor (network inputs; npz and safetensors only) [default: color,depth,class,instance,boxes, and
    /// map if the log has one]
    #[arg(long, value_name = "MAP,..")]
    pub(crate) maps: Option<MapSet>,
    /// Files: png (depth as 16-bit bins); exr, npz or safetensors (depth in meters, -300 where empty)
    #[arg(long, value_parser = names::<MapFormat>(), default_value = "png")]
    pub(crate) format: MapFormat,
    #[command(flatten)]
    pub(crate) size: SizeArgs,
    /// Use points up to this distance from the ego along x and y of the log's frame, meters
    #[arg(long, value_name = "M", default_value = "100", value_parser = numbers::distance_m)]
    #[arg(allow_negative_numbers = true)]
    pub(crate) radius: f64,
    /// Scale of the depth bins in depth.png, the contact sheet and the tensor
    #[arg(long, value_parser = names::<BinScale>(), default_value = "linear")]
    pub(crate) depth_bins: BinScale,
    /// Depth in the tensor: metric values (continuous), their sines and cosines (discrete), or both
    #[arg(long, value_parser = names::<DepthEmbedding>(), default_value = "continuous")]
    pub(crate) depth_embedding: DepthEmbedding,
    /// End of the last depth bin, meters [default: --radius]
    #[arg(long, value_name = "M", value_parser = numbers::distance_m, allow_negative_numbers = true)]
    pub(crate) far: Option<f64>,
    /// Occluders of actors in class and instance maps: the whole scene, or only other actors
    #[arg(long, value_parser = names::<Occlusion>(), default_value = "scene")]
    pub(crate) occlusion: Occlusion,
    /// Scale templates to the actor's box, or retain their size
    #[arg(long, value_parser = names::<TemplateFit>(), default_value = "box")]
    pub(crate) template_fit: TemplateFit,
    /// Filter for reducing color: OpenCV's INTER_LINEAR, or the mean of the pixels that are not empty
    #[arg(long, value_parser = names::<ColorFilter>(), default_value = "bilinear")]
    pub(crate) color_filter: ColorFilter,
    /// Width of the lines in boxes and map
    #[arg(long, value_parser = names::<LineWidth>(), default_value = "scaled")]
    pub(crate) line_width: LineWidth,
    /// Outlines in map
    #[arg(long, value_parser = names::<LayoutLayers>(), default_value = "lanes")]
    pub(crate) map_layers: LayoutLayers,
    /// Actors with more points than this are rendered with their own points in depth, class and instance
    /// maps; others with the template of their category, if available
    #[arg(long, value_name = "N", default_value_t = SelectionOptions::default().min_actor_points)]
    pub(crate) min_actor_points: usize,
}

impl MapArgs {
    /// Rejects tensors in image formats.
    pub(crate) fn check(&self) -> Result<(), WrongUsage> {
        let images = matches!(self.format, MapFormat::Png | MapFormat::Exr);
        if images && self.asks_for(MapKind::Tensor) {
            let found = if self.format == MapFormat::Png { "png" } else { "exr" };
            let message = format!("expected --format npz or safetensors with --maps tensor, found {found}");
            return Err(WrongUsage(message));
        }
        Ok(())
    }

    fn asks_for(&self, kind: MapKind) -> bool {
        self.maps.is_some_and(|maps| maps.contains(kind))
    }

    /// Returns the maps to render of a log with or without an HD map; `None` if the HD map is requested but
    /// missing.
    pub(crate) fn kinds(&self, has_map: bool) -> Option<MapSet> {
        match self.maps {
            None if has_map => Some(MapSet::default().with(MapKind::Map)),
            None => Some(MapSet::default()),
            Some(maps) => (has_map || !maps.contains(MapKind::Map)).then_some(maps),
        }
    }

    /// Returns whether the maps use the log's HD map.
    pub(crate) fn wants_map(&self) -> bool {
        self.maps.is_none() || self.asks_for(MapKind::Map) || self.asks_for(MapKind::Tensor)
    }

    /// Returns the options for rendering these maps.
    pub(crate) fn conditions(&self, maps: MapSet) -> ConditionOptions {
        let far_m = self.far.unwrap_or(self.radius) as f32;
        ConditionOptions {
            maps,
            radius_m: self.radius,
            color_filter: self.color_filter,
            occlusion: self.occlusion,
            depth_bins: DepthBins { scale: self.depth_bins, far_m, ..DepthBins::default() },
            depth_embedding: self.depth_embedding,
            layout: LayoutStyle { line_width: self.line_width, map_layers: self.map_layers },
            ..self.size.conditions()
        }
    }

    /// Returns the options for selecting the clouds of actors.
    pub(crate) fn selection(&self) -> SelectionOptions {
        SelectionOptions { min_actor_points: self.min_actor_points, template_fit: self.template_fit }
    }
}
