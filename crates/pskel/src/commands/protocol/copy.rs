use std::path::Path;

use clap::Args;
use point_skeleton::dataset::{LogLocator, nuscenes};
use pskel_eval::protocol::Part;
use pskel_generate::{CopiedLog, DatasetCopy};
use pskel_sim::EgoPolicy;

use super::super::generate::write_copy;
use crate::{WrongUsage, print_progress};

/// The copy of the data set with the generated images of a part.
#[derive(Debug, Args)]
pub(super) struct CopyArgs {
    /// Part whose images are written into a copy of the data set (nuScenes), which follows the log and steps
    /// from frame to frame [default: 2hz of nuscenes-val, if selected; none of the others]
    #[arg(long, value_name = "PART")]
    copy: Option<String>,
    /// Leave everything out of the copy but the generated samples: new tables, and generated.json, which
    /// lists them
    #[arg(long)]
    generated_only: bool,
}

impl CopyArgs {
    /// Selects the part with a copy among the parts that run.
    pub(super) fn select(&self, parts: &mut [Part]) -> Result<(), WrongUsage> {
        if let Some(name) = &self.copy {
            let follows = parts.iter().filter(|part| part.ego == EgoPolicy::Replay);
            let names: Vec<&str> = follows.map(|part| part.name).collect();
            if !names.contains(&name.as_str()) {
                let expected =
                    if names.is_empty() { "a part that follows the log" } else { &names.join(", ") };
                return Err(WrongUsage(format!("expected --copy of {expected}, found {name}")));
            }
            parts.iter_mut().for_each(|part| part.copies_dataset = part.name == name);
        }
        if self.generated_only && !parts.iter().any(|part| part.copies_dataset) {
            let message = "expected --copy PART with --generated-only, found no part with a copy";
            return Err(WrongUsage(message.to_owned()));
        }
        Ok(())
    }

    /// Writes the copy with the rollouts of some logs.
    pub(super) fn write(
        &self,
        copy: DatasetCopy<'_>,
        logs: &[CopiedLog<'_>],
        folder: &Path,
    ) -> anyhow::Result<()> {
        let counts = write_copy(copy, logs, self.generated_only)?;
        print_progress(&format!("{counts}: {}", folder.display()));
        Ok(())
    }
}

/// Checks that all logs are of one version of a nuScenes data set, which a part copies.
pub(super) fn check_one_dataset(part: &Part, logs: &[LogLocator]) -> Result<(), WrongUsage> {
    let first = logs.first().map(|log| (&log.path, &log.version));
    let is_other =
        |log: &&LogLocator| *log.format != nuscenes::FORMAT || Some((&log.path, &log.version)) != first;
    logs.iter().find(is_other).map_or(Ok(()), |other| {
        Err(WrongUsage(format!(
            "expected recordings nuscenes:.. of one folder and version for part {}, found {other}",
            part.name
        )))
    })
}
