//! `pskel town`: writes the synthetic town as a data set in nuScenes layout.

use std::path::PathBuf;
use std::sync::Mutex;
use std::time::Instant;

use clap::Args;
use point_skeleton::conditions::ImageSize;
use point_skeleton::dataset::{LogReader, Recording};
use point_skeleton::files::{Inputs, WholeFolder};
use pskel_town::{Daylight, Town, TownOptions, WriteError};

use crate::args::names::names;
use crate::args::{log, numbers};
use crate::progress::Progress;
use crate::{WrongUsage, say};

/// Write the synthetic town as a data set in nuScenes layout: images, LiDAR sweeps, boxes, and the HD map
///
/// Everything is determined by the seed. Writes tables to v1.0-town, images and sweeps to samples and sweeps,
/// the map to maps/expansion/town.json and maps/town.png, and the options to town.json. The same recording
/// without files is the log town:seed=S,frames=N.
#[derive(Debug, Args)]
pub(crate) struct TownArgs {
    /// Seed of the town and of the recorded drive
    #[arg(long, default_value_t = TownOptions::default().seed)]
    seed: u64,
    /// Number of annotated frames
    #[arg(long, value_name = "N", default_value_t = TownOptions::default().frames)]
    frames: usize,
    /// Folder to write; an older town in it is replaced once the new one is complete
    #[arg(long, value_name = "DIR", value_parser = log::output_folder())]
    out: PathBuf,
    /// Annotated frames per second
    #[arg(long, value_name = "F", default_value_t = TownOptions::default().hz,
        value_parser = numbers::rate_hz)]
    hz: f64,
    /// LiDAR beams: 32 or 64
    #[arg(long, value_name = "N", default_value_t = TownOptions::default().beams)]
    beams: u16,
    /// LiDAR rotations per second: 10 or 20
    #[arg(long, value_name = "F", default_value_t = TownOptions::default().lidar_hz,
        value_parser = numbers::rate_hz)]
    lidar_hz: f64,
    /// Size of the images
    #[arg(long, value_name = "HxW", default_value_t = default_size())]
    size: ImageSize,
    /// Daylight [default: chosen by the seed]
    #[arg(long, value_name = "LIGHT", value_parser = names::<Daylight>())]
    light: Option<Daylight>,
    /// Also write the ground truth of every image: truth/FRAME/CAM/depth.exr (meters), class.png and
    /// instance.png, with the numbers of that frame's maps
    #[arg(long)]
    truth: bool,
}

fn default_size() -> ImageSize {
    let [height, width] = TownOptions::default().size;
    ImageSize { height, width }
}

/// Runs the command: generates and writes the town.
pub(crate) fn run(args: &TownArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    let options = args.options();
    options.check().map_err(|error| WrongUsage(error.to_string()))?;
    let out = WholeFolder::open(&args.out, "town", &Inputs::default())?;
    let town = Town::new(&options)?;
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
    say(&format!(
        "{} in {:.2} s: {}",
        summary(town.recording()),
        start.elapsed().as_secs_f64(),
        args.out.display()
    ));
    Ok(())
}

impl TownArgs {
    fn options(&self) -> TownOptions {
        TownOptions {
            seed: self.seed,
            frames: self.frames,
            hz: self.hz,
            lidar_hz: self.lidar_hz,
            beams: self.beams,
            size: [self.size.height, self.size.width],
            daylight: self.light,
        }
    }
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
