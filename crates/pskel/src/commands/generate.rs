//! `pskel generate`: replays a log frame by frame and generates its images. It runs `pskel simulate` on the
//! log's own frames; [`DatasetCopy`] writes the images back into a copy of the data set.

use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use point_skeleton::dataset::nuscenes;
use pskel_eval::protocol::ClipClock;
use pskel_generate::{CopiedLog, DatasetCopy};
use pskel_sim::{ActorPolicy, EgoKind};

use super::simulate::{self, ClipArgs, SimulateArgs};
use crate::args::actors::ScenarioArgs;
use crate::args::frames::MovedEgoArgs;
use crate::args::generator::GeneratorArgs;
use crate::args::lidar::LidarArgs;
use crate::args::maps::MapArgs;
use crate::args::outputs::FolderArgs;
use crate::args::prompt::PromptArgs;
use crate::args::rasterizer::RasterizerArgs;
use crate::args::rollout::RolloutArgs;
use crate::args::source::SourceArgs;
use crate::args::substitutes::SubstituteArgs;
use crate::{WrongUsage, print_result};

/// Regenerate the images of a log from its conditions: ego and actors follow the log
///
/// Writes a rollout like `pskel simulate`'s with one step per frame: steps/STEP with the maps,
/// generated/CAM.png and truth/CAM.png, index.html, a page that plays it, and rollout.mp4. The first frames
/// are references, which are ground-truth images.
#[derive(Debug, Args)]
#[command(mut_arg("generator", |arg| arg.default_value("network")))]
#[command(mut_arg("steps", |arg| arg.help("Number of steps [default: to the end of the log]")))]
pub(crate) struct GenerateArgs {
    #[command(flatten)]
    source: SourceArgs,
    #[command(flatten)]
    folder: FolderArgs,
    #[command(flatten)]
    rollout: RolloutArgs,
    /// Generate every N-th frame [default: the N closest to 2 frames per second for nuScenes, 5 for other
    /// logs]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    every: Option<u16>,
    /// Also write a copy of the data set (nuScenes) with the generated images, enlarged to the original size,
    /// and with --lidar the sweeps of LIDAR_TOP;
    /// all other files are links to the original. A new or empty folder, or an earlier copy, which is
    /// replaced
    #[arg(long, value_name = "DIR", conflicts_with = "scenario")]
    dataset: Option<PathBuf>,
    /// Leave everything out of the copy but the generated samples: new tables, and generated.json, which
    /// lists them
    #[arg(long, requires = "dataset")]
    generated_only: bool,
    #[command(flatten)]
    moved: MovedEgoArgs,
    #[command(flatten)]
    prompt: PromptArgs,
    #[command(flatten)]
    generator: GeneratorArgs,
    #[command(flatten)]
    maps: MapArgs,
    #[command(flatten)]
    lidar: LidarArgs,
    #[command(flatten)]
    scenario: ScenarioArgs,
    #[command(flatten)]
    substitutes: SubstituteArgs,
    #[command(flatten)]
    rasterizer: RasterizerArgs,
}

/// Runs the command: generates the rollout, then writes the copy of the data set.
pub(crate) fn run(args: GenerateArgs) -> anyhow::Result<()> {
    if args.dataset.is_some() && *args.source.log.format != nuscenes::FORMAT {
        let message = format!("expected a log nuscenes:.. with --dataset, found {}", args.source.log);
        return Err(WrongUsage(message).into());
    }
    if args.dataset.is_some() {
        args.lidar.check_copy()?;
    }
    let (log, roots, out) = (args.source.log.clone(), args.source.roots.clone(), args.folder.out.clone());
    let generated_only = args.generated_only;
    let open = |folder: PathBuf| -> anyhow::Result<_> {
        let copy = DatasetCopy::open(&log, &folder, Some(&out))?;
        copy.check(roots.open(&log)?.recording())?;
        Ok((folder, copy))
    };
    let copy = args.dataset.clone().map(open).transpose()?;
    simulate::run(args.simulation())?;
    if let Some((folder, copy)) = copy {
        let log = roots.open(&log)?;
        let logs = [CopiedLog { log: log.recording(), rollout: &out }];
        let counts = write_copy(copy, &logs, generated_only)?;
        print_result(&format!("{counts}: {}", folder.display()));
    }
    Ok(())
}

/// Writes a copy of the data set, whole or with only the generated samples. Returns its counts.
pub(super) fn write_copy(
    copy: DatasetCopy<'_>,
    logs: &[CopiedLog<'_>],
    generated_only: bool,
) -> anyhow::Result<String> {
    Ok(match generated_only {
        true => copy.write_generated(logs)?.to_string(),
        false => copy.write(logs)?.to_string(),
    })
}

impl GenerateArgs {
    fn simulation(self) -> SimulateArgs {
        SimulateArgs::of_clip(ClipArgs {
            source: self.source,
            folder: self.folder,
            rollout: self.rollout,
            clock: self.every.map(|every| ClipClock::Frames(usize::from(every))),
            ego: EgoKind::Replay,
            planner: None,
            actors: ActorPolicy::Replay,
            least_warmup: false,
            ego_offset: self.moved.ego_offset,
            copies_dataset: self.dataset.is_some(),
            prompt: self.prompt,
            generator: self.generator,
            images: None,
            maps: self.maps,
            lidar: self.lidar,
            scenario: self.scenario,
            substitutes: self.substitutes,
            rasterizer: self.rasterizer,
            opener: Arc::default(),
        })
    }
}
