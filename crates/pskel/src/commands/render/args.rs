use std::collections::BTreeSet;
use std::path::PathBuf;

use clap::Args;
use point_skeleton::conditions::{ConditionOptions, MapFormat, MapSet};
use point_skeleton::dataset::{ActorEdits, Recording};
use point_skeleton::files::Inputs;
use point_skeleton::scene::{EgoOffset, LogTimes, SelectionOptions, SubstituteReport};
use point_skeleton::sequence::LidarOutput;
use serde::Serialize;

use crate::WrongUsage;
use crate::args::actors::ActorArgs;
use crate::args::frames::{FrameArgs, MovedEgoArgs, RateArgs};
use crate::args::lidar::LidarArgs;
use crate::args::maps::MapArgs;
use crate::args::outputs::FolderArgs;
use crate::args::prompt::PromptArgs;
use crate::args::rasterizer::RasterizerArgs;
use crate::args::source::SourceArgs;
use crate::args::substitutes::SubstituteArgs;

/// Help of `--out`.
const OUT: &str = "Folder to write; frames of an earlier run in it are replaced one by one";

/// Render condition maps of a recording's frames from its skeleton: color, depth, class, instance, boxes, map
///
/// Writes FRAME/CAM/MAP.png or .exr, or FRAME/maps.npz or conditions.safetensors (arrays V,H,W(,3) named like
/// the maps, points V,20,H,W and layout V,6,H,W of the tensor, cameras in the order of index.json);
/// FRAME/meta.json with poses and intrinsics; FRAME/sheet.png, a contact sheet of all maps; with --lidar also
/// FRAME/lidar.pcd.bin (or .pcd, .npy), lidar.png and lidar.json; finally index.json. FRAME is the
/// six-digit frame number, or the time with --at and --hz.
#[derive(Debug, Args)]
#[command(mut_arg("out", |arg| arg.help(OUT)))]
pub(crate) struct RenderArgs {
    #[command(flatten)]
    pub(super) source: SourceArgs,
    #[command(flatten)]
    pub(super) folder: FolderArgs,
    #[command(flatten)]
    pub(super) frames: FrameArgs,
    /// Render at these times within the log instead of at frames, absolute microseconds; ego and actors are
    /// interpolated
    #[arg(long, value_name = "T_US,..", value_delimiter = ',', allow_hyphen_values = true)]
    #[arg(conflicts_with_all = ["frames", "hz"])]
    pub(super) at: Vec<i64>,
    #[command(flatten)]
    pub(super) rate: RateArgs,
    /// Also write FRAME/birdseye.png: bird's-eye view of 100 x 100 m around the ego, with HD map, boxes and
    /// cameras
    #[arg(long)]
    pub(super) birdseye: bool,
    #[command(flatten)]
    pub(super) moved: MovedEgoArgs,
    /// Use these cameras instead of the log's, posed in the log's global frame:
    /// {"cameras": [{"name", "width", "height", "intrinsics": 3x3, "camera_from_world": 4x4}]}
    #[arg(long, value_name = "C.json", conflicts_with = "ego_offset")]
    pub(super) cameras: Option<PathBuf>,
    /// Render with the lens distortion of the recorded cameras; every pixel is the nearest one of a pinhole
    /// image [default: pinhole cameras]
    #[arg(long, conflicts_with = "cameras")]
    pub(super) distort: bool,
    #[command(flatten)]
    pub(super) prompt: PromptArgs,
    #[command(flatten)]
    pub(super) maps: MapArgs,
    #[command(flatten)]
    pub(super) lidar: LidarArgs,
    #[command(flatten)]
    pub(super) actors: ActorArgs,
    #[command(flatten)]
    pub(super) substitutes: SubstituteArgs,
    #[command(flatten)]
    pub(super) rasterizer: RasterizerArgs,
}

/// Rendering options in `index.json`.
#[derive(Clone, Debug, Serialize)]
pub(super) struct RenderOptions {
    #[serde(flatten)]
    pub(super) conditions: ConditionOptions,
    #[serde(flatten)]
    pub(super) selection: SelectionOptions,
    #[serde(skip_serializing_if = "BTreeSet::is_empty")]
    hide: BTreeSet<String>,
    #[serde(flatten)]
    edits: ActorEdits,
    /// Times per second, unless frames were rendered.
    hz: Option<f64>,
    #[serde(flatten)]
    substitutes: SubstituteReport,
    ego_offset: EgoOffset,
    /// `true` if maps have lens distortion.
    distort: bool,
    /// File of other cameras.
    cameras: Option<PathBuf>,
    format: MapFormat,
    birdseye: bool,
    #[serde(flatten)]
    pub(super) lidar: Option<LidarOutput>,
}

impl RenderArgs {
    /// Rejects tensors in image formats, and filters by area with distortion, since distorted maps do not
    /// record which pixels were empty.
    pub(super) fn check(&self) -> Result<(), WrongUsage> {
        if self.distort && self.maps.color_filter.needs_depth() {
            let message = "expected --color-filter bilinear with --distort, found a filter by area";
            return Err(WrongUsage(message.to_owned()));
        }
        self.maps.check()
    }

    /// Returns everything that is read.
    pub(super) fn inputs(&self) -> Inputs {
        let files = [&self.cameras, &self.prompt.annotations].into_iter().flatten();
        let inputs = self.source.inputs().and(files).and(self.actors.file());
        inputs.and(self.substitutes.inputs()).and(self.lidar.inputs())
    }

    /// Returns the maps to render of a log with or without an HD map; `None` if the HD map is requested but
    /// missing.
    pub(super) fn maps(&self, has_map: bool) -> Option<MapSet> {
        self.maps.kinds(has_map)
    }

    /// Returns whether the output uses the log's HD map.
    pub(super) fn wants_map(&self) -> bool {
        self.birdseye || self.maps.wants_map()
    }

    /// Returns the times of the log to render.
    pub(super) fn times(&self, log: &Recording) -> anyhow::Result<LogTimes> {
        if !self.at.is_empty() {
            return Ok(LogTimes::At(self.at.clone()));
        }
        let frames = self.frames.of(log.frames.len())?;
        Ok(self.rate.hz.map_or(LogTimes::Frames(frames.clone()), |hz| LogTimes::Rate(frames, hz)))
    }

    pub(super) fn options(
        &self,
        log: &Recording,
        maps: MapSet,
        substitutes: SubstituteReport,
        lidar: Option<LidarOutput>,
    ) -> RenderOptions {
        RenderOptions {
            conditions: self.maps.conditions(maps),
            selection: self.maps.selection(),
            hide: self.actors.hidden(),
            edits: log.edits.clone(),
            hz: self.rate.hz,
            substitutes,
            ego_offset: self.moved.ego_offset.unwrap_or_default(),
            distort: self.distort,
            cameras: self.cameras.clone(),
            format: self.maps.format,
            birdseye: self.birdseye,
            lidar,
        }
    }
}
