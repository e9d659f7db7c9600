use std::path::Path;

use rayon::prelude::*;

use super::Output;
use super::files::step_folder;
use crate::report::{Phase, StepRow, Video, film};
use crate::rollout::error::RolloutError;
use crate::rollout::report::RolloutReport;

/// Number of video images in memory at the same time.
const PICTURES: usize = 16;
/// Encodes the video. Images are composed on all threads and encoded in order.
pub(in super::super) fn write(
    output: &Output<'_>,
    path: &Path,
    report: &RolloutReport,
) -> Result<(), RolloutError> {
    let mut video = None;
    for rows in report.rows.chunks(PICTURES) {
        let picture = |row: &StepRow| {
            let folder = step_folder(output.folder, &row.name());
            film::picture(&folder, &report.layout.maps, &caption(output, row))
        };
        for picture in rows.par_iter().map(picture).collect::<Vec<_>>() {
            let (size, pixels) = picture?;
            let video = match &mut video {
                Some(video) => video,
                none => none.insert(Video::new(path, size, output.record.sim_hz)?),
            };
            video.push(size, &pixels)?;
        }
    }
    video.map_or(Ok(()), |video| Ok(video.write()?))
}

fn caption(output: &Output<'_>, row: &StepRow) -> String {
    let phase = if row.phase == Phase::WarmUp { "  warm-up" } else { "" };
    let seconds = row.step as f64 / output.record.sim_hz;
    format!("{}  {}  {seconds:.2} s  {:.1} m/s{phase}", output.record.log, row.name(), row.ego.speed_mps)
}
