use std::path::Path;
use std::sync::mpsc::{Receiver, SyncSender};

use point_skeleton::error::FileError;
use point_skeleton::geometry::ImageSize;
use point_skeleton::pipeline::write_beside;
use rayon::prelude::*;

use super::Output;
use super::files::step_folder;
use crate::report::{Phase, StepRow, Video, VideoError, video_frame};
use crate::rollout::error::RolloutError;
use crate::rollout::report::RolloutReport;

/// Maximum number of video images that are composed together; three times as many are in memory.
const MAX_PICTURES: usize = 16;
/// Video image: its size and its RGB pixels.
type Picture = (ImageSize, Vec<[u8; 3]>);

/// Encodes the video. All threads compose images, while another thread encodes them in order.
pub(in super::super) fn write(
    output: &Output<'_>,
    path: &Path,
    report: &RolloutReport,
) -> Result<(), RolloutError> {
    let rate_hz = output.record.sim_hz;
    let encode = |pictures: Receiver<Vec<Picture>>| encode(path, rate_hz, pictures);
    let compose = |sender: SyncSender<Vec<Picture>>| {
        let picture = |row: &StepRow| {
            let folder = step_folder(output.folder, &row.name());
            video_frame::compose(&folder, &report.layout.maps, &caption(output, row))
        };
        for rows in report.rows.chunks(rayon::current_num_threads().clamp(1, MAX_PICTURES)) {
            let pictures = rows.par_iter().map(picture).collect::<Result<Vec<_>, FileError>>()?;
            // An encoder that has failed receives nothing more, and returns its error.
            if sender.send(pictures).is_err() {
                break;
            }
        }
        Ok::<(), FileError>(())
    };
    let (composed, video) = write_beside("the thread that encodes the video", encode, compose)?;
    composed?;
    video?.map_or(Ok(()), |video| Ok(video.write()?))
}

fn encode(path: &Path, rate_hz: f64, pictures: Receiver<Vec<Picture>>) -> Result<Option<Video>, VideoError> {
    let mut video = None;
    for (size, pixels) in pictures.into_iter().flatten() {
        let video = match &mut video {
            Some(video) => video,
            none => none.insert(Video::new(path, size, rate_hz)?),
        };
        video.push(size, &pixels)?;
    }
    Ok(video)
}

fn caption(output: &Output<'_>, row: &StepRow) -> String {
    let phase = if row.phase == Phase::WarmUp { "  warm-up" } else { "" };
    let seconds = row.step as f64 / output.record.sim_hz;
    format!("{}  {}  {seconds:.2} s  {:.1} m/s{phase}", output.record.log, row.name(), row.ego.speed_mps)
}
