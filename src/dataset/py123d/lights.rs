//! `traffic_light_detections.arrow`: states of traffic lights by lane of the map.

use std::path::Path;

use super::sync::Sync;
use crate::dataset::recording::notes::{Notes, note};
use crate::dataset::tables::ArrowFile;
use crate::dataset::{DatasetError, TrafficLight};
use crate::error::FileError;
use crate::files::input::is_there;

pub(super) const KEY: &str = "traffic_light_detections";

/// Colors by number; a light that is off has none.
const COLORS: [&str; 5] = ["green", "yellow", "red", "unknown", "unknown"];

/// Reads the states, sorted by frame and lane. `frames` are the numbers of the rows of `sync` in the log, in
/// order; other rows are left out.
///
/// # Errors
/// Fails if the table is damaged.
pub(super) fn read(
    log: &Path,
    sync: &Sync,
    frames: &[usize],
    notes: &mut Notes,
) -> Result<Vec<TrafficLight>, DatasetError> {
    let path = log.join(format!("{KEY}.arrow"));
    if !is_there(&path)? {
        return Ok(Vec::new());
    }
    let file = ArrowFile::open(&path)?;
    let [lane, status] = [format!("{KEY}.lane_id"), format!("{KEY}.status")];
    let table = file.table(&[&lane, &status], &[])?;
    let (lanes, states) = (table.column(&lane)?.integer_lists()?, table.column(&status)?.integer_lists()?);
    let rows = sync.rows_of_lists(KEY, file.rows())?;
    let mut lights = Vec::new();
    for (frame, row) in frames.iter().enumerate().filter_map(|(frame, i)| Some((frame, rows[*i]?))) {
        if lanes[row].len() != states[row].len() {
            let found = format!("{} lanes and {} states in row {row}", lanes[row].len(), states[row].len());
            return Err(FileError::content("a state per lane", found, &path).into());
        }
        for (lane, state) in lanes[row].iter().zip(&states[row]) {
            let color = state.and_then(|state| COLORS.get(usize::try_from(state).ok()?));
            let (Some(lane), Some(color)) = (lane, color) else {
                note(notes, "traffic lights of an unknown state or lane", 1);
                continue;
            };
            lights.push(TrafficLight { frame, lane_connector: lane.to_string(), color: (*color).to_owned() });
        }
    }
    lights.sort();
    Ok(lights)
}
