//! `pskel protocol`: [`clips`] generates and scores the clips of a protocol, [`ablation`] the same frames
//! with variants of the generator, [`scenarios`] scores the driving. [`table`] joins results, [`export`]
//! writes images for other programs.

mod ablation;
mod clip_args;
mod clips;
mod copy;
mod export;
mod logs;
mod scenarios;
mod table;

use clap::Subcommand;
use point_skeleton::named::Named as _;
use pskel_eval::protocol::Protocol;

use self::ablation::AblationArgs;
use self::clip_args::ClipProtocolArgs;
use self::export::ExportImagesArgs;
use self::scenarios::ScenarioArgs;
use self::table::TableArgs;

/// Evaluation protocols.
#[derive(Debug, Subcommand)]
pub(crate) enum ProtocolCommand {
    #[command(about = Protocol::NuplanSimgen.help())]
    NuplanSimgen(Box<ClipProtocolArgs>),
    #[command(about = Protocol::NuscenesVal.help())]
    NuscenesVal(Box<ClipProtocolArgs>),
    #[command(about = Protocol::LaneChange.help())]
    LaneChange(Box<ClipProtocolArgs>),
    Ablation(Box<AblationArgs>),
    Scenarios(Box<ScenarioArgs>),
    Table(TableArgs),
    Export(ExportImagesArgs),
}

/// Runs the command.
pub(crate) fn run(command: ProtocolCommand) -> anyhow::Result<()> {
    match command {
        ProtocolCommand::NuplanSimgen(args) => clips::run(Protocol::NuplanSimgen, &args),
        ProtocolCommand::NuscenesVal(args) => clips::run(Protocol::NuscenesVal, &args),
        ProtocolCommand::LaneChange(args) => clips::run(Protocol::LaneChange, &args),
        ProtocolCommand::Ablation(args) => ablation::run(&args),
        ProtocolCommand::Scenarios(args) => scenarios::run(&args),
        ProtocolCommand::Table(args) => table::run(&args),
        ProtocolCommand::Export(args) => export::run(&args),
    }
}
