//! `pskel protocol`: [`clips`] generates and scores the clips of a protocol, [`ablation`] the same frames
//! with variants of the generator.

mod ablation;
mod clips;
mod copy;
mod logs;

use clap::Subcommand;
use point_skeleton::named::Named as _;
use pskel_eval::protocol::Protocol;

use self::ablation::AblationArgs;
use self::clips::ClipProtocolArgs;

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
}

/// Runs the command.
pub(crate) fn run(command: ProtocolCommand) -> anyhow::Result<()> {
    match command {
        ProtocolCommand::NuplanSimgen(args) => clips::run(Protocol::NuplanSimgen, &args),
        ProtocolCommand::NuscenesVal(args) => clips::run(Protocol::NuscenesVal, &args),
        ProtocolCommand::LaneChange(args) => clips::run(Protocol::LaneChange, &args),
        ProtocolCommand::Ablation(args) => ablation::run(&args),
    }
}
