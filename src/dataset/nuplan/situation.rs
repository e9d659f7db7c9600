//! Scenario tags and traffic lights of the frames.

use std::collections::BTreeMap;

use rustc_hash::{FxHashMap, FxHashSet};

use super::annotations::frame_tokens;
use super::database::{Database, Query, Row};
use super::frames::FrameRecord;
use crate::dataset::recording::notes::{Notes, note};
use crate::dataset::{DatasetError, TrafficLight};

/// Frames by token. Rows may also refer to frames of other scenes.
struct Frames<'a> {
    database: &'a Database,
    places: FxHashMap<&'a [u8], usize>,
    /// All frame tokens of the log, loaded on demand.
    all: Option<FxHashSet<Vec<u8>>>,
    notes: &'a mut Notes,
}

impl Frames<'_> {
    /// Returns the frame of a token in a row; `None` if it is not among the frames read. Logs are cut from
    /// longer recordings, so rows may refer to frames missing from the log; these are counted as `kind`.
    fn place(&mut self, row: &Row<'_>, column: usize, kind: &str) -> Result<Option<usize>, DatasetError> {
        let token = row.blob(column)?;
        if let Some(place) = self.places.get(token) {
            return Ok(Some(*place));
        }
        let all = match &mut self.all {
            Some(all) => all,
            empty => empty.insert(frame_tokens(self.database)?),
        };
        note(self.notes, kind, usize::from(!all.contains(token)));
        Ok(None)
    }
}

/// Frames by scenario type, and traffic light states.
pub(super) type Situation = (BTreeMap<String, Vec<usize>>, Vec<TrafficLight>);

/// Reads `scenario_tag` and `traffic_light_status`.
pub(super) fn read(
    database: &Database,
    shots: &[FrameRecord],
    notes: &mut Notes,
) -> Result<Situation, DatasetError> {
    let places = shots.iter().enumerate().map(|(i, shot)| (shot.token.as_slice(), i)).collect();
    let mut frames = Frames { database, places, all: None, notes };
    let mut scenarios: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    let columns = &["token", "lidar_pc_token", "type"];
    database.rows(&Query { table: "scenario_tag", columns, from: "FROM scenario_tag" }, |row| {
        if let Some(frame) = frames.place(row, 1, "scenario tags of frames that are not there")? {
            scenarios.entry(row.text(2)?.to_owned()).or_default().push(frame);
        }
        Ok(())
    })?;
    for list in scenarios.values_mut() {
        // Frames have one tag per agent, so entries repeat.
        list.sort_unstable();
        list.dedup();
    }
    let mut lights = Vec::new();
    let columns = &["token", "lidar_pc_token", "lane_connector_id", "status"];
    database.rows(
        &Query { table: "traffic_light_status", columns, from: "FROM traffic_light_status" },
        |row| {
            if let Some(frame) = frames.place(row, 1, "traffic lights of frames that are not there")? {
                let (lane_connector, color) = (row.integer(2)?.to_string(), row.text(3)?.to_owned());
                lights.push(TrafficLight { frame, lane_connector, color });
            }
            Ok(())
        },
    )?;
    lights.sort();
    Ok((scenarios, lights))
}
