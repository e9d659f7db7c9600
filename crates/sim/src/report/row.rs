use std::io::Write;
use std::path::{Path, PathBuf};

use glam::DVec2;
use point_skeleton::cloud::cameras::rows;
use point_skeleton::conditions::write::meta::{IndexActor, IndexFrame, Matrix};
use point_skeleton::dataset::Recording;
use point_skeleton::error::FileError;
use point_skeleton::files::FileName;
use point_skeleton::files::input::read_text;
use point_skeleton::files::json;
use point_skeleton::files::write_whole;
use serde::{Deserialize, Serialize};

use super::visibility::{MIN_VISIBLE_PX, VisibleActor, was_in_logged_images};
use crate::{Deviation, EgoState, Instant, SimActor, Waypoint};

/// A line of `states.jsonl`: a committed step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StepRow {
    /// Number of the step, from 0.
    pub step: usize,
    /// Absolute time, microseconds.
    pub t_us: i64,
    /// Source of the step.
    pub phase: Phase,
    /// State of the ego.
    pub ego: EgoRow,
    /// Actors, in the order of their numbers in the instance map.
    pub actors: Vec<ActorRow>,
    /// States of traffic lights.
    pub lights: Vec<LightRow>,
    /// Direction of the recorded path within 20 m: `left`, `straight`, `right` or `unknown`.
    pub driving_command: String,
    /// Plan computed for this step, if any; its first waypoint is the ego state that it was planned from.
    pub plan: Option<Vec<Waypoint>>,
}

/// Source of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// The log.
    WarmUp,
    /// The policies of ego and actors.
    Policy,
}

/// State of the ego in a [`StepRow`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EgoRow {
    /// Ego pose, 4x4 row by row, meters.
    pub global_from_ego: Matrix,
    /// Global heading, counterclockwise, radians.
    pub heading_rad: f64,
    /// Speed along the heading, meters per second.
    pub speed_mps: f64,
    /// Acceleration along the heading, meters per second squared.
    pub acceleration_mps2: f64,
    /// Yaw rate, to the left, radians per second.
    pub yaw_rate_radps: f64,
    /// Steering angle, to the left, radians.
    pub steering_rad: f64,
    /// Lateral deviation from the recorded path, to the left, meters.
    pub lateral_deviation_m: f64,
    /// Heading deviation from the recorded path, to the left, radians.
    pub heading_deviation_rad: f64,
}

/// State of an actor in a [`StepRow`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ActorRow {
    /// Number in the instance map.
    pub instance: u32,
    /// Track id.
    pub track: String,
    /// Category name in the dataset.
    pub category: String,
    /// Number in the class map.
    pub class: u8,
    /// Center of the box, global, meters.
    pub center_m: [f64; 3],
    /// Global heading, counterclockwise, radians.
    pub heading_rad: f64,
    /// Length, width and height, meters.
    pub size_m: [f64; 3],
    /// Speed along the heading, meters per second.
    pub speed_mps: f64,
    /// Velocity in global x and y, meters per second.
    pub velocity_mps: [f64; 2],
    /// Yaw rate, to the left, radians per second.
    pub yaw_rate_radps: f64,
    /// Cameras whose maps show the actor; null without instance maps.
    pub seen: Option<Vec<VisibleActor>>,
    /// Cameras that show at least [`MIN_VISIBLE_PX`] pixels of the actor, and whose own logged images around
    /// that time did not show it; null without instance maps.
    pub new_in_view: Option<Vec<usize>>,
}

/// State of a traffic light in a [`StepRow`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LightRow {
    /// Id of the lane connector through the intersection.
    pub lane_connector: String,
    /// Color name in the dataset.
    pub color: String,
}

/// Deviation of the ego from the recorded path, and visible actors.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepObservations {
    /// Lateral deviation, to the left, meters.
    pub lateral: Deviation,
    /// Heading deviation, to the left, radians.
    pub heading: Deviation,
    /// Direction of the recorded path, as in [`StepRow::driving_command`].
    pub driving_command: &'static str,
    /// Visible parts per actor; `None` without instance maps.
    pub seen: Option<Vec<Vec<VisibleActor>>>,
}

impl StepRow {
    /// Creates the row for a step of a log's rollout.
    pub fn new(
        log: &Recording,
        instant: &Instant,
        phase: Phase,
        observed: &StepObservations,
        plan: Option<Vec<Waypoint>>,
    ) -> Self {
        let actor = |(index, actor): (usize, &SimActor)| {
            let seen = observed.seen.as_ref().and_then(|all| all.get(index)).cloned();
            ActorRow::new(log, instant.t_us, index, actor, seen)
        };
        let light = |light: &point_skeleton::dataset::TrafficLight| LightRow {
            lane_connector: light.lane_connector.clone(),
            color: light.color.clone(),
        };
        Self {
            step: instant.step,
            t_us: instant.t_us,
            phase,
            ego: EgoRow::new(&instant.ego, observed),
            actors: instant.actors.iter().enumerate().map(actor).collect(),
            lights: instant.lights.iter().map(light).collect(),
            driving_command: observed.driving_command.to_owned(),
            plan,
        }
    }

    /// Returns the name of its folder.
    pub fn name(&self) -> String {
        format!("{:06}", self.step)
    }

    /// Returns the global x and y of the ego, meters.
    pub fn place_m(&self) -> DVec2 {
        DVec2::new(self.ego.global_from_ego[0][3], self.ego.global_from_ego[1][3])
    }

    /// Returns its entry in `index.json`.
    pub fn index_frame(&self, cameras: &[FileName]) -> IndexFrame {
        let actor = |actor: &ActorRow| IndexActor {
            instance: actor.instance,
            track: actor.track.clone(),
            category: actor.category.clone(),
            class: actor.class,
        };
        IndexFrame {
            name: self.name(),
            t_us: self.t_us,
            ego: self.ego.global_from_ego,
            cameras: cameras.to_vec(),
            actors: self.actors.iter().map(actor).collect(),
        }
    }
}

impl EgoRow {
    fn new(ego: &EgoState, observed: &StepObservations) -> Self {
        Self {
            global_from_ego: rows(&ego.pose.affine()),
            heading_rad: ego.heading_rad(),
            speed_mps: ego.speed_mps,
            acceleration_mps2: ego.acceleration_mps2,
            yaw_rate_radps: ego.yaw_rate_radps,
            steering_rad: ego.steering_rad,
            lateral_deviation_m: observed.lateral.end,
            heading_deviation_rad: observed.heading.end,
        }
    }
}

impl ActorRow {
    fn new(
        log: &Recording,
        t_us: i64,
        index: usize,
        actor: &SimActor,
        seen: Option<Vec<VisibleActor>>,
    ) -> Self {
        let track = &log.tracks[actor.track];
        let channel = |camera: usize| log.rig.get(camera).map_or(camera, |rig| rig.channel);
        let new = |seen: &&VisibleActor| {
            seen.pixels >= MIN_VISIBLE_PX
                && !was_in_logged_images(log, actor.track, channel(seen.camera), t_us)
        };
        let new_in_view = seen.as_ref().map(|seen| seen.iter().filter(new).map(|seen| seen.camera).collect());
        Self {
            instance: index as u32 + 1,
            track: track.id.clone(),
            category: track.category.clone(),
            class: track.class as u8,
            center_m: actor.cuboid.pose.translation.to_array(),
            heading_rad: actor.cuboid.pose.yaw_rad(),
            size_m: actor.cuboid.size.to_array(),
            speed_mps: actor.speed_mps,
            velocity_mps: actor.velocity_mps().to_array(),
            yaw_rate_radps: actor.yaw_rate_radps,
            seen,
            new_in_view,
        }
    }
}

/// The file `states.jsonl`, with one line per step.
#[derive(Debug)]
pub struct StateFile {
    file: std::fs::File,
    path: PathBuf,
    length: u64,
}

impl StateFile {
    /// Creates the file with some rows; replaces an existing file.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn create(path: &Path, rows: &[StepRow]) -> Result<Self, FileError> {
        write_whole(path, |out| {
            rows.iter().try_for_each(|row| {
                let line = line(row, path)?;
                out.write_all(&line).map_err(FileError::io("write", path))
            })
        })?;
        let file = std::fs::OpenOptions::new().append(true).open(path);
        let file = file.map_err(FileError::io("open", path))?;
        let length = file.metadata().map_err(FileError::io("read", path))?.len();
        Ok(Self { file, path: path.to_owned(), length })
    }

    /// Appends a row. A partly written line is removed, so that the file only contains whole lines.
    ///
    /// # Errors
    /// Fails if the line cannot be written.
    pub fn append(&mut self, row: &StepRow) -> Result<(), FileError> {
        let line = line(row, &self.path)?;
        if let Err(error) = self.file.write_all(&line) {
            let _ = self.file.set_len(self.length); // the write error is the one to report
            return Err(FileError::io("write", &self.path)(error));
        }
        self.length += line.len() as u64;
        Ok(())
    }

    /// Reads all rows. Skips an incomplete last line, from a process that was killed.
    ///
    /// # Errors
    /// Fails if the file cannot be read, or if a line is not the row of its step.
    pub fn read(path: &Path) -> Result<Vec<StepRow>, FileError> {
        let text = read_text(path)?;
        let whole = text.rfind('\n').map_or("", |end| &text[..end]);
        let mut rows: Vec<StepRow> = Vec::new();
        for (number, line) in whole.lines().enumerate() {
            let expected = || format!("a state of step {number} in line {}", number + 1);
            let row: StepRow = json::parse(line.as_bytes(), &expected(), path)?;
            if row.step != number {
                return Err(FileError::content(expected(), format!("one of step {}", row.step), path));
            }
            rows.push(row);
        }
        Ok(rows)
    }
}

fn line(row: &StepRow, path: &Path) -> Result<Vec<u8>, FileError> {
    let mut line = serde_json::to_vec(row).map_err(|e| FileError::io("write", path)(e.into()))?;
    line.push(b'\n');
    Ok(line)
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use point_skeleton::dataset::{Class, Track, TrafficLight};
    use point_skeleton::geometry::{Cuboid, Pose};

    fn row(step: usize) -> StepRow {
        let track = Track { id: "t".into(), category: "vehicle.car".into(), class: Class::MotorVehicle };
        let log = Recording { tracks: vec![track], ..Recording::default() };
        let pose = Pose::from_yaw(0.1 + step as f64, DVec3::new(664_000.123_456_789, 4e6 / 3.0, 0.1));
        let ego = EgoState {
            pose,
            speed_mps: 1.0 / 3.0,
            acceleration_mps2: 0.1,
            yaw_rate_radps: 0.2,
            steering_rad: 0.3,
        };
        let cuboid = Cuboid::new(pose, DVec3::new(4.0, 2.0, 1.5)).unwrap();
        let actors =
            vec![SimActor { track: 0, cuboid, speed_mps: 2.0, lateral_mps: 0.5, yaw_rate_radps: 0.1 }];
        let light = TrafficLight { frame: 0, lane_connector: "7".into(), color: "red".into() };
        let instant = Instant { step, t_us: 5, ego, actors, lights: vec![light] };
        let seen = |pixels| VisibleActor { camera: 1, pixels, bounds: [1, 2, 3, 4] };
        let observed = StepObservations {
            seen: Some(vec![vec![seen(29 + step as u32)]]),
            ..StepObservations::default()
        };
        StepRow::new(&log, &instant, Phase::WarmUp, &observed, None)
    }

    #[test]
    fn rows_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("states.jsonl");
        let mut file = StateFile::create(&path, &[row(0)]).unwrap();
        file.append(&row(1)).unwrap();
        assert_eq!(StateFile::read(&path).unwrap(), [row(0), row(1)]);
        // 29 pixels are too few to be seen well.
        let new = |row: StepRow| row.actors[0].new_in_view.clone();
        assert_eq!([new(row(0)), new(row(1))], [Some(vec![]), Some(vec![1])]);
        assert_eq!(row(1).place_m(), DVec2::new(664_000.123_456_789, 4e6 / 3.0));
        let frame = row(1).index_frame(&["c".parse().unwrap()]);
        assert_eq!((frame.name.as_str(), frame.actors[0].instance, frame.actors[0].class), ("000001", 1, 1));
        // An incomplete last line is skipped.
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, &text[..text.len() - 1]).unwrap();
        assert_eq!(StateFile::read(&path).unwrap(), [row(0)]);
        assert_eq!(StateFile::create(&path, &[row(0)]).unwrap().length, text.find('\n').unwrap() as u64 + 1);
    }

    #[test]
    fn rejects_invalid_lines() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("states.jsonl");
        StateFile::create(&path, &[row(0), row(2)]).unwrap();
        let read = || StateFile::read(&path).unwrap_err().to_string();
        assert!(
            read().starts_with("expected a state of step 1 in line 2, found one of step 2"),
            "{}",
            read()
        );
        std::fs::write(&path, "{}\n").unwrap();
        assert!(read().starts_with("expected a state of step 0 in line 1, found no field "), "{}", read());
        std::fs::write(&path, "").unwrap();
        assert_eq!(StateFile::read(&path).unwrap(), []);
        std::fs::remove_file(&path).unwrap();
        assert!(read().starts_with("cannot read"));
    }
}
