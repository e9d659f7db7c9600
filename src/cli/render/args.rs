use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use crate::cli::WrongUsage;
use crate::cli::log_args::{self, LogRoots};
use crate::cli::map_args::{MapArgs, MapFormat};
use crate::cli::numbers::{self, FrameRange};
use crate::cli::rasterizer::RasterizerArgs;
use crate::cli::stand_ins::{StandInArgs, StandInReport};
use crate::conditions::{ColorFilter, ConditionOptions, MapSet};
use crate::dataset::LogLocator;
use crate::scene::{EgoOffset, SelectionOptions};

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
    #[arg(long, value_name = "DIR", value_parser = log_args::output_folder())]
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
    #[command(flatten)]
    pub(super) maps: MapArgs,
    /// Also write FRAME/birdseye.png: 100 x 100 m around the ego from above, with HD map, boxes and cameras
    #[arg(long)]
    pub(super) birdseye: bool,
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
    /// For the prompt in meta.json: {"weather": "Sunny", "city": "Boston"}, either may be missing
    #[arg(long, value_name = "F.json")]
    pub(super) annotations: Option<PathBuf>,
    #[command(flatten)]
    pub(super) stand_ins: StandInArgs,
    #[command(flatten)]
    pub(super) rasterizer: RasterizerArgs,
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
        if self.distort && self.maps.color_filter == ColorFilter::ValidArea {
            let message = "expected --color-filter bilinear with --distort, found valid-area";
            return Err(WrongUsage(message.to_owned()));
        }
        self.maps.check()
    }

    /// The maps to make of a log with or without an HD map; `None` if that is missing and was asked for.
    pub(super) fn maps(&self, has_map: bool) -> Option<MapSet> {
        self.maps.kinds(has_map)
    }

    /// Whether the log's HD map is of use.
    pub(super) fn wants_map(&self) -> bool {
        self.birdseye || self.maps.wants_map()
    }

    pub(super) fn options(&self, maps: MapSet, stand_ins: StandInReport) -> RenderOptions {
        RenderOptions {
            conditions: self.maps.conditions(maps),
            selection: self.maps.selection(),
            hz: self.hz,
            stand_ins,
            ego_offset: self.ego_offset.unwrap_or_default(),
            distort: self.distort,
            cameras: self.cameras.clone(),
            format: self.maps.format,
            birdseye: self.birdseye,
        }
    }
}
