use std::path::PathBuf;

use clap::Args;
use point_skeleton::cloud;
use point_skeleton::conditions::{ConditionOptions, MapKind, MapSet};
use point_skeleton::dataset::LogLocator;
use point_skeleton::files::Inputs;
use point_skeleton::raster::FRAMES_IN_FLIGHT;
use point_skeleton::scene::SubstituteOptions;
use point_skeleton::skeleton::Skeleton;
use pskel_eval::bench::{BenchOptions, Workload};

use crate::args::frames::FrameArgs;
use crate::args::rasterizer::RasterizerArgs;
use crate::args::size::SizeArgs;
use crate::args::source::{CloudArgs, open_skeleton};
use crate::args::substitutes::SubstituteArgs;
use crate::args::{log, numbers};
use crate::{WrongUsage, logs, print_notes, print_progress, warn};

/// Measure rendering speed: time per frame and per stage, points per second, peak memory
///
/// A frame is all cameras of one instant: from its poses to all maps in host memory, with the clouds already
/// resident. The workload is a synthetic street, a file of points, or the frames of a recording with its
/// skeleton.
#[derive(Debug, Args)]
#[command(mut_arg("frames", |arg| arg.requires("skeleton")))]
pub(crate) struct BenchArgs {
    /// Recording whose frames are rendered in turn: [FORMAT:]PATH[@VERSION][#SCENE], like
    /// nuscenes:/data/nuscenes#scene-0061
    #[arg(value_parser = log::log, requires = "skeleton")]
    #[arg(conflicts_with_all = ["synthetic", "points", "cameras"])]
    log: Option<LogLocator>,
    /// Skeleton that was built from the recording; with --synthetic a folder for a location of streets with
    /// 10 million points each, which is written if it is missing (16 bytes per point). The frames are a drive
    /// of up to 1 km
    #[arg(long, value_name = "SKEL", conflicts_with_all = ["points", "cameras"])]
    skeleton: Option<PathBuf>,
    #[command(flatten)]
    frames: FrameArgs,
    /// Number of points in a synthetic street with six cameras of 900x1600, like 4000000 or 4e6; the default
    /// workload [default: 4e6]
    #[arg(long, value_name = "N", value_parser = numbers::points, conflicts_with_all = ["points", "cameras"])]
    #[arg(allow_negative_numbers = true)]
    synthetic: Option<usize>,
    #[command(flatten)]
    cloud: CloudArgs,
    #[command(flatten)]
    size: SizeArgs,
    /// Maps to render: color, depth, class, instance, and point (point numbers); with boxes, map (the
    /// recording's HD map) or tensor a frame is a whole step: instance selection, rendering, layouts, and
    /// network inputs
    #[arg(long, value_name = "MAP,..", default_value = "color,depth,class,instance")]
    maps: MapSet,
    /// Number of timed frames [default: 20]; with a skeleton, passes over all frames [default: 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    #[arg(allow_negative_numbers = true)]
    repeat: Option<u32>,
    /// Number of frames rendered before the timed ones
    #[arg(long, value_name = "N", default_value = "3", allow_negative_numbers = true)]
    pub(super) warm_up: u32,
    /// Frames in flight. 1: a frame begins after the previous one is finished; its time is from begin to end.
    /// 2: a frame begins before the previous one is finished; its time is from end to end
    #[arg(long, value_name = "1|2", default_value = "1")]
    #[arg(value_parser = clap::value_parser!(u32).range(1..=FRAMES_IN_FLIGHT as i64))]
    pub(super) in_flight: u32,
    /// Print one JSON object instead of the table
    #[arg(long)]
    pub(super) json: bool,
    /// Write a trace of all timed frames and their stages for chrome://tracing or ui.perfetto.dev
    #[arg(long, value_name = "F.json")]
    pub(super) trace: Option<PathBuf>,
    #[command(flatten)]
    substitutes: SubstituteArgs,
    #[command(flatten)]
    rasterizer: RasterizerArgs,
}

/// Default number of points in the synthetic street.
const DEFAULT_POINTS: usize = 4_000_000;
/// Seed of the synthetic street.
const STREET_SEED: u64 = 1;
/// Default number of timed frames for workloads other than recordings.
const DEFAULT_FRAMES: u32 = 20;

impl BenchArgs {
    /// Rejects maps that are only available in whole steps if there is no recording.
    pub(super) fn check(&self) -> Result<(), WrongUsage> {
        if BenchOptions::has_whole_steps(self.maps) && self.log.is_none() {
            let maps: Vec<&str> = self.maps.iter().map(MapKind::name).collect();
            let expected = "expected a recording, or --maps out of color,depth,class,instance,point";
            return Err(WrongUsage(format!("{expected}, found {}", maps.join(","))));
        }
        if self.skeleton.is_some() && self.log.is_none() && self.synthetic.is_none() {
            let expected = "expected a recording, or --synthetic, with --skeleton";
            return Err(WrongUsage(format!("{expected}, found neither")));
        }
        if self.substitutes.options() != SubstituteOptions::default() && self.log.is_none() {
            let expected = "expected a recording with --templates, --no-default-templates or --augment";
            return Err(WrongUsage(format!("{expected}, found none")));
        }
        Ok(())
    }

    /// Returns everything that is read.
    pub(super) fn inputs(&self) -> Inputs {
        let files = [&self.skeleton, &self.cloud.points, &self.cloud.cameras].into_iter().flatten();
        let log = self.log.iter().flat_map(LogLocator::inputs);
        Inputs::new(files).and(log).and(self.substitutes.inputs())
    }

    /// Generates or loads the workload that the options select.
    pub(super) fn workload(&self) -> anyhow::Result<Workload> {
        match (&self.log, &self.skeleton, &self.cloud.points, &self.cloud.cameras) {
            (Some(log), Some(skeleton), ..) => {
                let log = logs::open(log)?;
                let skeleton = open_skeleton(skeleton, log.recording())?;
                let range = self.frames.of(log.recording().frames.len())?;
                let (substitutes, _) = self.substitutes.options().make(&skeleton, log.name())?;
                let workload = Workload::log(&log, skeleton, substitutes, range, self.maps)?;
                if workload.skipped() > 0 {
                    warn(&format!("{} frames have no cameras and are left out", workload.skipped()));
                }
                Ok(workload)
            }
            (None, Some(skeleton), ..) => {
                let count = self.synthetic.unwrap_or(DEFAULT_POINTS);
                if !Skeleton::is_at(skeleton) {
                    let (path, bytes) = (skeleton.display(), Workload::location_bytes(count));
                    print_progress(&format!(
                        "writing a location of {count} points, {} MB, to {path}",
                        bytes / 1_000_000
                    ));
                }
                Ok(Workload::location(skeleton, count, self.frames.of_any())?)
            }
            (.., Some(points), Some(cameras)) => {
                let views = cloud::cameras::read(cameras)?;
                let cloud = cloud::read(points)?;
                print_notes(points, &cloud.notes);
                Ok(Workload::cloud(cloud, views))
            }
            _ => {
                let count = self.synthetic.unwrap_or(DEFAULT_POINTS);
                print_progress(&format!("generating a street of {count} points"));
                Ok(Workload::street(count, STREET_SEED)?)
            }
        }
    }

    /// Returns the options of the measurement.
    pub(super) fn options(&self) -> Result<BenchOptions, WrongUsage> {
        let repeat = self.repeat.unwrap_or(if self.skeleton.is_some() { 1 } else { DEFAULT_FRAMES });
        Ok(BenchOptions {
            rasterizer: self.rasterizer.desc()?,
            conditions: ConditionOptions { maps: self.maps, ..self.size.conditions() },
            warm_up: self.warm_up as usize,
            repeat: repeat as usize,
            in_flight: self.in_flight as usize,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        args: BenchArgs,
    }

    fn args(text: &str) -> BenchArgs {
        Cli::try_parse_from(std::iter::once("bench").chain(text.split_whitespace())).unwrap().args
    }

    #[test]
    fn layouts_and_tensors_need_a_recording() {
        for (maps, whole) in [("color,point", false), ("map", true), ("depth,boxes", true), ("tensor", true)]
        {
            let drive = args(&format!("nuscenes:log --skeleton sk --maps {maps}"));
            assert!(drive.check().is_ok(), "{maps}");
            assert_eq!(args(&format!("--maps {maps}")).check().is_err(), whole, "{maps}");
        }
    }
}
