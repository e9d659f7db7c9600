//! `pskel town`: writes the synthetic town as a data set in nuScenes layout.

use std::sync::Mutex;
use std::time::Instant;

use clap::Args;
use point_skeleton::dataset::{LogReader, Recording};
use point_skeleton::files::{Inputs, WholeFolder};
use pskel_town::{Town, TownOptions, WriteError};

use crate::args::outputs::FolderArgs;
use crate::print_result;
use crate::progress::Progress;

/// Write the synthetic town as a data set in nuScenes layout: images, LiDAR sweeps, boxes, and the HD map
///
/// Everything is determined by the seed. Writes tables to v1.0-town, images and sweeps to samples and sweeps,
/// the map to maps/expansion/town.json and maps/town.png, and the options to town.json. The same recording
/// without files is the log town:seed=S,frames=N.
#[derive(Debug, Args)]
pub(crate) struct TownArgs {
    /// Options of the town, all optional: seed, frames (annotated ones), hz (annotated frames per second),
    /// beams of the LiDAR (32 or 64), lidar_hz (rotations per second, 10 or 20), size of the images, light
    /// (day, dusk or overcast)
    #[arg(value_name = "seed=7,frames=40,..", default_value_t, hide_default_value = true)]
    options: TownOptions,
    #[command(flatten)]
    folder: FolderArgs,
    /// Also write the ground truth of every image: truth/FRAME/CAM/depth.exr (meters), class.png and
    /// instance.png, with the numbers of that frame's maps
    #[arg(long)]
    truth: bool,
}

/// Runs the command: generates and writes the town.
pub(crate) fn run(args: &TownArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    let out = WholeFolder::open(&args.folder.out, "town", &Inputs::default())?;
    let town = Town::new(&args.options)?;
    out.write(|folder| {
        let progress = Mutex::new(Progress::new(town.recording().frames.len()));
        let frame_done = |index: usize| {
            let mut progress = progress.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            progress.step(&format!("frame {index:06}"));
        };
        town.write(folder, &frame_done)?;
        if args.truth {
            let mut progress = Progress::new(town.recording().frames.len());
            town.write_truth(folder, &mut |index| progress.step(&format!("truth {index:06}")))?;
        }
        Ok::<_, WriteError>(())
    })?;
    print_result(&format!(
        "{} in {:.2} s: {}",
        summary(town.recording()),
        start.elapsed().as_secs_f64(),
        args.folder.out.display()
    ));
    Ok(())
}

fn summary(log: &Recording) -> String {
    let (images, sweeps, boxes) = log.frames.iter().fold((0, 0, 0), |(images, sweeps, boxes), frame| {
        (images + frame.images.len(), sweeps + frame.sweeps.len(), boxes + frame.boxes.len())
    });
    format!(
        "wrote {}: {} frames, {images} images, {sweeps} sweeps, {boxes} boxes of {} tracks",
        log.name,
        log.frames.len(),
        log.tracks.len()
    )
}
