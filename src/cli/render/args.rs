use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use crate::cli::WrongUsage;
use crate::cli::log_args::{self, LogRoots};
use crate::cli::numbers::{self, FrameRange};
use crate::cli::rasterizer::RasterizerArgs;
use crate::cli::stand_ins::{StandInArgs, StandInReport};
use crate::conditions::{
    BinScale, ColorFilter, ConditionOptions, DepthBins, DepthEmbedding, ImageSize, MapKind, MapSet, Occlusion,
};
use crate::dataset::LogLocator;
use crate::raster::SplatSchedule;
use crate::scene::{EgoOffset, SelectionOptions, TemplateFit};

/// Render condition maps of a drive's frames from its skeleton: color, depth, class, instance, boxes, map
///
/// Writes FRAME/CAM/MAP.png or .exr, or FRAME/maps.npz or conditions.safetensors (arrays V,H,W(,3) named as the maps,
/// points V,20,H,W and layout V,6,H,W of the tensor, cameras in the order of index.json); FRAME/meta.json with poses and intrinsics; FRAME/sheet.png with all maps at a glance; at the end
/// index.json. FRAME is the frame's number with six digits, or the time with --at and --hz.
#[derive(Debug, Args)]
pub(in crate::cli) struct RenderArgs {
    /// Drive: FORMAT:PATH[@VERSION][#SCENE], like nuscenes:/data/nuscenes@v1.0-mini#scene-0061
    #[arg(value_parser = log_args::log)]
    pub(super) log: LogLocator,
    #[command(flatten)]
    pub(super) roots: LogRoots,
    /// Skeleton that was built from it
    #[arg(long, value_name = "SKEL")]
    pub(super) skeleton: PathBuf,
    /// Folder to write; frames of an earlier run in it are replaced one by one
    #[arg(long, value_name = "DIR")]
    pub(super) out: PathBuf,
    /// Only these frames, numbered from 0 in the log's order, without B [default: all]
    #[arg(long, value_name = "A..B")]
    pub(super) frames: Option<FrameRange>,
    /// Instead of frames any times within the log, absolute microseconds; ego and actors are interpolated
    #[arg(long, value_name = "T_US,..", value_delimiter = ',', allow_hyphen_values = true)]
    #[arg(conflicts_with = "frames")]
    pub(super) at: Vec<i64>,
    /// Times at this rate (0.1 to 100 a second) from the first to the last of the frames; ego and actors are interpolated
    #[arg(long, value_name = "F", value_parser = numbers::rate_hz, allow_negative_numbers = true)]
    #[arg(conflicts_with = "at")]
    pub(super) hz: Option<f64>,
    /// Which maps: color, depth, class, instance, boxes, map (of the log's HD map), point (numbers of the points), and
    /// tensor (what networks are fed; npz and safetensors alone) [default: color,depth,class,instance,boxes, and map
    /// where the log has one]
    #[arg(long, value_name = "MAP,..")]
    maps: Option<MapSet>,
    /// Also write FRAME/birdseye.png: 100 x 100 m around the ego from above, with HD map, boxes and cameras
    #[arg(long)]
    pub(super) birdseye: bool,
    /// Files: png (depth as 16-bit bins); exr, npz or safetensors (depth in metres, -300 where empty)
    #[arg(long, value_enum, default_value = "png")]
    pub(super) format: MapFormat,
    /// Draw at this size; scales the intrinsics [default: the size of the cameras]
    #[arg(long, value_name = "HxW")]
    size: Option<ImageSize>,
    /// Reduce the maps to this size after drawing [default: no reduction]
    #[arg(long, value_name = "HxW")]
    out_size: Option<ImageSize>,
    /// Splat radius by depth: up to Z metres a point covers (2R+1) x (2R+1) pixels; beyond the last Z nothing is drawn
    #[arg(long, value_name = "Z:R,..", default_value_t)]
    splat: SplatSchedule,
    /// Use points up to this far from the ego along x and y of the log's frame, metres
    #[arg(long, value_name = "M", default_value = "100", value_parser = numbers::distance_m)]
    #[arg(allow_negative_numbers = true)]
    radius: f64,
    /// Move the ego in its own frame: metres forward, metres to the left, degrees to the left
    #[arg(long, value_name = "X,Y,YAW_DEG", value_parser = numbers::ego_offset, allow_hyphen_values = true)]
    #[arg(conflicts_with = "cameras")]
    pub(super) ego_offset: Option<EgoOffset>,
    /// These cameras instead of the log's, standing in the log's global frame:
    /// {"cameras": [{"name", "width", "height", "intrinsics": 3x3, "camera_from_world": 4x4}]}
    #[arg(long, value_name = "C.json")]
    pub(super) cameras: Option<PathBuf>,
    /// Draw what the cameras recorded, lens distortion included; every pixel takes the nearest one of a pinhole's image
    /// [default: pinhole cameras]
    #[arg(long, conflicts_with = "cameras")]
    pub(super) distort: bool,
    /// How depth is cut into the bins of depth.png, of the sheet and of the tensor
    #[arg(long, value_enum, default_value = "linear")]
    depth_bins: BinScale,
    /// Depth in the tensor: itself (continuous), its sines and cosines (discrete), or both
    #[arg(long, value_enum, default_value = "continuous")]
    depth_embedding: DepthEmbedding,
    /// Where the last depth bin ends, metres [default: --radius]
    #[arg(long, value_name = "M", value_parser = numbers::distance_m, allow_negative_numbers = true)]
    far: Option<f64>,
    /// What hides actors in class and instance maps: the whole scene, or only other actors
    #[arg(long, value_enum, default_value = "scene")]
    occlusion: Occlusion,
    /// Scale templates to the actor's box, or leave them as they are
    #[arg(long, value_enum, default_value = "box")]
    template_fit: TemplateFit,
    /// How color is reduced: as OpenCV's INTER_LINEAR, or as the mean of the pixels that are not empty
    #[arg(long, value_enum, default_value = "bilinear")]
    color_filter: ColorFilter,
    /// Actors with more points than this show their own points in depth, class and instance maps, others the
    /// template of their category where there is one
    #[arg(long, value_name = "N", default_value_t = SelectionOptions::default().min_actor_points)]
    min_actor_points: usize,
    /// For the prompt in meta.json: {"weather": "Sunny", "city": "Boston"}, either may be missing
    #[arg(long, value_name = "F.json")]
    pub(super) annotations: Option<PathBuf>,
    #[command(flatten)]
    pub(super) stand_ins: StandInArgs,
    #[command(flatten)]
    pub(super) rasterizer: RasterizerArgs,
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

/// What stands in `index.json` about how the maps were made.
#[derive(Clone, Debug, Serialize)]
pub(super) struct RenderOptions {
    #[serde(flatten)]
    pub(super) conditions: ConditionOptions,
    #[serde(flatten)]
    pub(super) selection: SelectionOptions,
    /// Times per second, where not frames were rendered.
    hz: Option<f64>,
    #[serde(flatten)]
    stand_ins: StandInReport,
    ego_offset: EgoOffset,
    /// Whether maps look like recorded images.
    distort: bool,
    /// File of other cameras.
    cameras: Option<PathBuf>,
    format: MapFormat,
    birdseye: bool,
}

impl RenderArgs {
    /// Files of images hold no tensors; distorted maps do not know which pixels were empty.
    pub(super) fn check(&self) -> Result<(), WrongUsage> {
        if self.distort && self.color_filter == ColorFilter::ValidArea {
            let message = "expected --color-filter bilinear with --distort, found valid-area";
            return Err(WrongUsage(message.to_owned()));
        }
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
    pub(super) fn maps(&self, has_map: bool) -> Option<MapSet> {
        match self.maps {
            None if has_map => Some(MapSet::default().with(MapKind::Map)),
            None => Some(MapSet::default()),
            Some(maps) => (has_map || !maps.contains(MapKind::Map)).then_some(maps),
        }
    }

    /// Whether the log's HD map is of use.
    pub(super) fn wants_map(&self) -> bool {
        self.birdseye || self.maps.is_none() || self.asks_for(MapKind::Map) || self.asks_for(MapKind::Tensor)
    }

    pub(super) fn options(&self, maps: MapSet, stand_ins: StandInReport) -> RenderOptions {
        let far_m = self.far.unwrap_or(self.radius) as f32;
        let conditions = ConditionOptions {
            maps,
            splat: self.splat.clone(),
            radius_m: self.radius,
            size: self.size,
            out_size: self.out_size,
            color_filter: self.color_filter,
            occlusion: self.occlusion,
            depth_bins: DepthBins { scale: self.depth_bins, far_m, ..DepthBins::default() },
            depth_embedding: self.depth_embedding,
        };
        RenderOptions {
            conditions,
            selection: SelectionOptions {
                min_actor_points: self.min_actor_points,
                template_fit: self.template_fit,
            },
            hz: self.hz,
            stand_ins,
            ego_offset: self.ego_offset.unwrap_or_default(),
            distort: self.distort,
            cameras: self.cameras.clone(),
            format: self.format,
            birdseye: self.birdseye,
        }
    }
}
