//! `pskel train`: [`args`] are the options, [`drives`] keeps what is trained on, [`record`] makes it.

mod args;
mod drives;
mod record;

pub(super) use args::TrainArgs;

use std::time::Instant;

use self::drives::Recording;
use super::{WrongUsage, say};
use crate::dataset::LogFormat;
use crate::generate::Recipe;

/// Records, trains, writes.
pub(super) fn run(args: &TrainArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    if let Some(other) = args.logs.iter().find(|log| log.format != LogFormat::Town) {
        let message = format!("expected logs town:.., of which the truth is known, found {other}");
        return Err(WrongUsage(message).into());
    }
    let recipe = Recipe::default();
    let folder = args.drives.clone().unwrap_or_else(|| args.out.join("drives"));
    let recording = Recording {
        folder: &folder,
        recipe: &recipe,
        variants: usize::from(args.variants),
        augment: !args.no_augment,
        seed: args.seed,
        rasterizer: &args.rasterizer,
    };
    let drives = recording.drives(&args.logs)?;
    let frames: usize = drives.iter().map(|drive| drive.frames.len()).sum();
    say(&format!(
        "recorded {} drives of {frames} frames in {:.2} s: {}",
        drives.len(),
        start.elapsed().as_secs_f64(),
        folder.display()
    ));
    Ok(())
}
