//! `pskel generate`: replays a log frame by frame and generates its images. It runs `pskel simulate` on the
//! log's own frames; [`DatasetCopy`] writes the images back into a copy of the data set.

use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use point_skeleton::dataset::{LogLocator, nuscenes};
use point_skeleton::scene::EgoOffset;
use pskel_eval::protocol::ClipClock;
use pskel_generate::{CopiedLog, DatasetCopy};
use pskel_network::NetworkName;
use pskel_sim::EgoKind;

use super::simulate::{self, ClipArgs, GenerationArgs, SimulateArgs};
use crate::args::generator::GeneratorArgs;
use crate::args::log::{self, LogRoots};
use crate::args::maps::MapArgs;
use crate::args::rasterizer::RasterizerArgs;
use crate::args::substitutes::SubstituteArgs;
use crate::{WrongUsage, say};

/// Regenerate the images of a log from its conditions: ego and actors follow the log
///
/// Writes a rollout like `pskel simulate`'s with one step per frame: steps/STEP with the maps,
/// generated/CAM.png and truth/CAM.png, index.html, a page that plays it, and rollout.mp4. The first frames
/// are references, which are ground-truth images.
#[derive(Debug, Args)]
pub(crate) struct GenerateArgs {
    /// Recording: FORMAT:PATH[@VERSION][#SCENE], like nuscenes:/data/nuscenes@v1.0-mini#scene-0061
    #[arg(value_parser = log::log)]
    log: LogLocator,
    #[command(flatten)]
    roots: LogRoots,
    /// Skeleton that was built from the recording
    #[arg(long, value_name = "SKEL")]
    skeleton: PathBuf,
    /// Folder to write: a new or empty one, or an earlier rollout, which is replaced
    #[arg(long, value_name = "DIR", value_parser = log::output_folder())]
    out: PathBuf,
    /// Network: network (shipped with the program), network:FILE with weights of `pskel train`, fill (no
    /// network: holes filled), or process:COMMAND, process:unix:PATH or process:tcp:HOST:PORT
    /// (docs/src/reference/denoiser.md). Map options apply to the written maps; the network's conditions are
    /// rendered as in its training
    #[arg(long, value_name = "NETWORK", default_value = "network")]
    generator: NetworkName,
    /// Number of steps [default: to the end of the log]
    #[arg(long, value_name = "N", default_value_t = usize::MAX, hide_default_value = true)]
    steps: usize,
    /// Generate every N-th frame [default: the N closest to 2 frames per second for nuScenes, 5 for other
    /// logs]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    every: Option<u16>,
    /// Start at the first frame at or after this time, absolute microseconds [default: the log's first frame]
    #[arg(long, value_name = "T_US", allow_negative_numbers = true)]
    start: Option<i64>,
    /// Move the ego of a synthetic log at all frames, like forward_m=1,left_m=-2,yaw_deg=5: meters forward
    /// and to the left, degrees to the left
    #[arg(long, value_name = "left_m=M,..")]
    ego_offset: Option<EgoOffset>,
    /// Also write a copy of the data set (nuScenes) with the generated images, enlarged to the original size;
    /// all other files are links to the original. A new or empty folder, or an earlier copy, which is
    /// replaced
    #[arg(long, value_name = "DIR")]
    dataset: Option<PathBuf>,
    #[command(flatten)]
    maps: MapArgs,
    /// Continue the rollout in --out after its last step, with the same log, skeleton and options; --steps,
    /// --generator-timeout, --profile and the rasterizer may change
    #[arg(long)]
    resume: bool,
    /// Continue after this step; later ones are generated again
    #[arg(long, value_name = "STEP")]
    resume_from: Option<usize>,
    /// Write the times of all steps and stages to this file
    #[arg(long, value_name = "F.json")]
    profile: Option<PathBuf>,
    /// Annotations for the prompt in meta.json: {"weather": "Sunny", "city": "Boston"}, both optional
    #[arg(long, value_name = "F.json")]
    annotations: Option<PathBuf>,
    #[command(flatten)]
    stand_ins: SubstituteArgs,
    #[command(flatten)]
    rasterizer: RasterizerArgs,
    #[command(flatten, next_help_heading = "Options of the generator")]
    generating: GeneratorArgs,
}

/// Runs the command: generates the rollout, then writes the copy of the data set.
pub(crate) fn run(args: GenerateArgs) -> anyhow::Result<()> {
    if args.dataset.is_some() && *args.log.format != nuscenes::FORMAT {
        let message = format!("expected a log nuscenes:.. with --dataset, found {}", args.log);
        return Err(WrongUsage(message).into());
    }
    let (log, roots, out) = (args.log.clone(), args.roots.clone(), args.out.clone());
    let open = |folder: PathBuf| -> anyhow::Result<_> {
        let copy = DatasetCopy::open(&log.path, &folder, Some(&out))?;
        copy.check(roots.open(&log)?.recording())?;
        Ok((folder, copy))
    };
    let copy = args.dataset.clone().map(open).transpose()?;
    simulate::run(args.simulation())?;
    if let Some((folder, copy)) = copy {
        let log = roots.open(&log)?;
        let counts = copy.write(&[CopiedLog { log: log.recording(), rollout: &out }])?;
        say(&format!("{} images replaced, {} kept: {}", counts.replaced, counts.kept, folder.display()));
    }
    Ok(())
}

impl GenerateArgs {
    fn simulation(self) -> SimulateArgs {
        SimulateArgs::of_clip(ClipArgs {
            log: self.log,
            roots: self.roots,
            skeleton: self.skeleton,
            out: self.out,
            generation: GenerationArgs { generator: Some(self.generator), options: self.generating },
            steps: self.steps,
            clock: self.every.map(|every| ClipClock::Frames(usize::from(every))),
            ego: EgoKind::Replay,
            least_warmup: false,
            start: self.start,
            ego_offset: self.ego_offset,
            maps: self.maps,
            resume: self.resume,
            resume_from: self.resume_from,
            profile: self.profile,
            copies_dataset: self.dataset.is_some(),
            annotations: self.annotations,
            stand_ins: self.stand_ins,
            rasterizer: self.rasterizer,
            opener: Arc::default(),
        })
    }
}
