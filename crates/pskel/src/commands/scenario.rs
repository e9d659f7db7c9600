//! `pskel scenario`: writes a scenario of a family for a recording.

use std::path::PathBuf;

use clap::Args;
use point_skeleton::dataset::LogLocator;
use point_skeleton::files::{FileKind, Inputs, OutputFile};
use pskel_sim::families::{Family, StaticSpace, family_scenario};

use crate::args::log::{self, LogRoots};
use crate::args::names::names;
use crate::args::source::open_skeleton;
use crate::print_result;

/// Files of the command.
const KIND: FileKind = FileKind {
    name: "a scenario of pskel scenario",
    begin: b"{\n  \"replace\": {\n    \"scenario-target\": ",
    marks: &[b"\n  \"changes\": ["],
};

/// Make a scenario: an actor on collision course with the recorded ego
///
/// Writes a file for --scenario of render, simulate, generate, protocol and drive. An ego that keeps its
/// recorded motion collides within 4 s of the start; one that brakes by a rule does not. Nothing is in the
/// actor's way: up to three actors of the log are removed; the edge of the drivable area and points of the
/// skeleton refuse it.
#[derive(Debug, Args)]
pub(crate) struct ScenarioCommandArgs {
    /// Recording: [FORMAT:]PATH[@VERSION][#SCENE], like /data/nuscenes#scene-0061
    #[arg(value_parser = log::log)]
    log: LogLocator,
    /// Kind of scenario
    #[arg(long, value_name = "FAMILY", value_parser = names::<Family>())]
    family: Family,
    /// Seed, which chooses time, place, speed and actor
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    /// File to write: a new one, or an earlier one of this command, which is replaced
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Skeleton of the recording, whose points must not be in the way
    #[arg(long, value_name = "SKEL")]
    skeleton: Option<PathBuf>,
    #[command(flatten)]
    roots: LogRoots,
}

/// Runs the command.
pub(crate) fn run(args: &ScenarioCommandArgs) -> anyhow::Result<()> {
    let read = Inputs::new(args.roots.locate(&args.log).inputs()).and(&args.skeleton);
    let file = OutputFile::open(&args.out, KIND, &read)?;
    let log = args.roots.open(&args.log)?;
    let skeleton = args.skeleton.as_deref().map(|path| open_skeleton(path, log.recording())).transpose()?;
    let space = skeleton.map(|skeleton| StaticSpace::new(&skeleton, log.recording())).transpose()?;
    let scenario = family_scenario(&log, args.family, args.seed, space.as_ref())?;
    file.write_json(&scenario.edits)?;
    let seconds = (scenario.collision_us - scenario.start_us) as f64 / 1e6;
    print_result(&format!(
        "{} scenario from {} us on, collision of the recorded ego after {seconds:.1} s: {}",
        args.family.name(),
        scenario.start_us,
        args.out.display()
    ));
    Ok(())
}
