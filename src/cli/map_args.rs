use std::path::Path;

use clap::Args;
use serde::Serialize;

use super::WrongUsage;
use super::numbers;
use crate::conditions::{
    BinScale, ColorFilter, ConditionError, ConditionOptions, ConditionSet, DepthBins, DepthEmbedding,
    ImageSize, MapKind, MapSet, Occlusion, exr, npz, png, safetensors,
};
use crate::raster::SplatSchedule;
use crate::scene::{SelectionOptions, TemplateFit};

/// Which maps are made and how, shared by all commands that render a log.
#[derive(Clone, Debug, Args)]
pub(super) struct MapArgs {
    /// Which maps: color, depth, class, instance, boxes, map (of the log's HD map), point (numbers of the points), and
    /// tensor (what networks are fed; npz and safetensors alone) [default: color,depth,class,instance,boxes, and map
    /// where the log has one]
    #[arg(long, value_name = "MAP,..")]
    pub(super) maps: Option<MapSet>,
    /// Files: png (depth as 16-bit bins); exr, npz or safetensors (depth in metres, -300 where empty)
    #[arg(long, value_enum, default_value = "png")]
    pub(super) format: MapFormat,
    /// Draw at this size; scales the intrinsics [default: the size of the cameras]
    #[arg(long, value_name = "HxW")]
    pub(super) size: Option<ImageSize>,
    /// Reduce the maps to this size after drawing [default: no reduction]
    #[arg(long, value_name = "HxW")]
    pub(super) out_size: Option<ImageSize>,
    /// Splat radius by depth: up to Z metres a point covers (2R+1) x (2R+1) pixels; beyond the last Z nothing is drawn
    #[arg(long, value_name = "Z:R,..", default_value_t)]
    pub(super) splat: SplatSchedule,
    /// Use points up to this far from the ego along x and y of the log's frame, metres
    #[arg(long, value_name = "M", default_value = "100", value_parser = numbers::distance_m)]
    #[arg(allow_negative_numbers = true)]
    pub(super) radius: f64,
    /// How depth is cut into the bins of depth.png, of the sheet and of the tensor
    #[arg(long, value_enum, default_value = "linear")]
    pub(super) depth_bins: BinScale,
    /// Depth in the tensor: itself (continuous), its sines and cosines (discrete), or both
    #[arg(long, value_enum, default_value = "continuous")]
    pub(super) depth_embedding: DepthEmbedding,
    /// Where the last depth bin ends, metres [default: --radius]
    #[arg(long, value_name = "M", value_parser = numbers::distance_m, allow_negative_numbers = true)]
    pub(super) far: Option<f64>,
    /// What hides actors in class and instance maps: the whole scene, or only other actors
    #[arg(long, value_enum, default_value = "scene")]
    pub(super) occlusion: Occlusion,
    /// Scale templates to the actor's box, or leave them as they are
    #[arg(long, value_enum, default_value = "box")]
    pub(super) template_fit: TemplateFit,
    /// How color is reduced: as OpenCV's INTER_LINEAR, or as the mean of the pixels that are not empty
    #[arg(long, value_enum, default_value = "bilinear")]
    pub(super) color_filter: ColorFilter,
    /// Actors with more points than this show their own points in depth, class and instance maps, others the
    /// template of their category where there is one
    #[arg(long, value_name = "N", default_value_t = SelectionOptions::default().min_actor_points)]
    pub(super) min_actor_points: usize,
}

/// What is written for the maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub(super) enum MapFormat {
    /// A PNG per map.
    Png,
    /// An OpenEXR file per map.
    Exr,
    /// One NumPy archive per frame.
    Npz,
    /// One safetensors file per frame.
    Safetensors,
}

impl MapFormat {
    /// Writes the maps of a step into its folder.
    pub(super) fn write(
        self,
        folder: &Path,
        set: &ConditionSet,
        t_us: i64,
        options: &ConditionOptions,
    ) -> Result<(), ConditionError> {
        match self {
            Self::Png => png::write(folder, set, &options.depth_bins)?,
            Self::Exr => exr::write(folder, set)?,
            Self::Npz => npz::write(&folder.join("maps.npz"), set)?,
            Self::Safetensors => {
                safetensors::write(&folder.join("conditions.safetensors"), set, t_us, options)?;
            }
        }
        Ok(())
    }
}

impl MapArgs {
    /// Files of images hold no tensors.
    pub(super) fn check(&self) -> Result<(), WrongUsage> {
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

    /// The maps to make of a log with or without an HD map; `None` if that is missing and was asked for.
    pub(super) fn kinds(&self, has_map: bool) -> Option<MapSet> {
        match self.maps {
            None if has_map => Some(MapSet::default().with(MapKind::Map)),
            None => Some(MapSet::default()),
            Some(maps) => (has_map || !maps.contains(MapKind::Map)).then_some(maps),
        }
    }

    /// Whether the log's HD map is of use.
    pub(super) fn wants_map(&self) -> bool {
        self.maps.is_none() || self.asks_for(MapKind::Map) || self.asks_for(MapKind::Tensor)
    }

    /// How the maps are made.
    pub(super) fn conditions(&self, maps: MapSet) -> ConditionOptions {
        let far_m = self.far.unwrap_or(self.radius) as f32;
        ConditionOptions {
            maps,
            splat: self.splat.clone(),
            radius_m: self.radius,
            size: self.size,
            out_size: self.out_size,
            color_filter: self.color_filter,
            occlusion: self.occlusion,
            depth_bins: DepthBins { scale: self.depth_bins, far_m, ..DepthBins::default() },
            depth_embedding: self.depth_embedding,
        }
    }

    /// Which clouds stand for actors.
    pub(super) fn selection(&self) -> SelectionOptions {
        SelectionOptions { min_actor_points: self.min_actor_points, template_fit: self.template_fit }
    }
}
