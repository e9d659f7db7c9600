//! The rollout as an MCAP file, written from the lines and folders of its steps.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use glam::{DMat4, DQuat, DVec3};
use point_skeleton::conditions::{ImageSize, MapFormat};
use point_skeleton::dataset::{Class, picture_size};
use point_skeleton::error::FileError;
use point_skeleton::files::input::{IMAGE_BYTES, read_file};
use point_skeleton::files::{FileKind, OutputFile};
use point_skeleton::geometry::{Cuboid, Pose};
use point_skeleton::lidar::MAX_RAYS;
use point_skeleton::raster::MapKind;
use point_skeleton::scene::{ActorState, SceneState, state_of};
use pskel_mcap::{SceneFile, Timestamp, camera_topic};
use serde::Serialize;
use serde_json::Value;

use super::files::step_folder;
use crate::Scenario;
use crate::report::images::{GENERATED, TRUTH, is_reference};
use crate::report::{ActorRow, StepRow};
use crate::rollout::events::Events;
use crate::rollout::finish::{MetricsFile, TRACES};
use crate::rollout::options::RolloutRecord;
use crate::rollout::report::RolloutReport;
use crate::state::ego_cuboid;

/// Files of rollouts.
pub const MCAP: FileKind =
    FileKind { name: "an MCAP file of pskel", begin: b"\x89MCAP0\r\n", marks: &[b"pskel "] };

/// Maximum size of a point file: as many rows as a sweep has rays, each of the longest format.
const POINT_BYTES: u64 = 40 * MAX_RAYS as u64;

/// A rollout whose steps are complete.
pub(in super::super) struct Input<'a> {
    pub(in super::super) scenario: &'a Scenario<'a>,
    pub(in super::super) record: &'a RolloutRecord,
    pub(in super::super) report: &'a RolloutReport,
    /// Folder of the rollout; `None` if nothing was written there.
    pub(in super::super) folder: Option<&'a Path>,
}

impl Input<'_> {
    /// Writes the file, one step after the other.
    pub(in super::super) fn write(&self, file: &OutputFile) -> Result<(), FileError> {
        let path = file.path();
        file.write(|out| {
            let size = |(_, [width, height]): &(_, [u32; 2])| ImageSize { height: *height, width: *width };
            let sizes: Vec<ImageSize> = self.report.cameras.iter().map(size).collect();
            let mut file = SceneFile::begin(out, path, self.scenario.log)?;
            file.describe("rollout", metadata(self.record, path)?)?;
            let mut events = Events::new(self.report, self.folder);
            for row in &self.report.rows {
                let time = file.time(row.t_us)?;
                for event in events.of(row)? {
                    file.write_text(event.level, event.source, event.text, time)?;
                }
                self.write_step(&mut file, row, &sizes, time)?;
            }
            file.describe("metrics", metadata(&MetricsFile::new(self.report), path)?)?;
            file.finish()?;
            Ok(())
        })
    }

    fn write_step<W: Write>(
        &self,
        file: &mut SceneFile<W>,
        row: &StepRow,
        sizes: &[ImageSize],
        time: Timestamp,
    ) -> Result<(), FileError> {
        let [_, (_, driven), (_, planned)] = TRACES;
        let state = self.state(row);
        file.write_state(&state, sizes, time)?;
        file.write_ego(&ego_cuboid(&Pose::IDENTITY), rgb(driven), time)?;
        if let Some(plan) = &row.plan {
            let z = state.global_from_ego.translation.z;
            let points: Vec<DVec3> = plan.iter().map(|waypoint| waypoint.position_m().extend(z)).collect();
            file.write_line("plan", &points, rgb(planned), time)?;
        }
        let Some(folder) = self.folder else { return Ok(()) };
        let folder = step_folder(folder, &row.name());
        for (camera, _) in &self.report.cameras {
            for kind in self.maps() {
                let path = folder.join(camera).join(format!("{}.png", kind.name()));
                let png = read_file(&path, IMAGE_BYTES)?;
                file.write_image(&camera_topic(camera, kind.name()), "png", png, time)?;
            }
        }
        self.write_points(file, &folder, time)?;
        self.write_generated(file, &folder, &state, time)
    }

    /// Writes the points of the LiDAR sweep, if the rollout has them.
    fn write_points<W: Write>(
        &self,
        file: &mut SceneFile<W>,
        folder: &Path,
        time: Timestamp,
    ) -> Result<(), FileError> {
        let Some(format) = self.record.lidar.as_ref().map(|lidar| lidar.format) else { return Ok(()) };
        let path = folder.join(format.file());
        let bytes = read_file(&path, POINT_BYTES)?;
        let expected = || FileError::content("the points of a sweep", "a damaged file", &path);
        let rows = format.rows(&bytes).ok_or_else(expected)?;
        file.write_points(&format.columns(), rows.to_vec(), time)
    }

    /// Writes generated and ground-truth images, which have a size of their own, with calibrations.
    fn write_generated<W: Write>(
        &self,
        file: &mut SceneFile<W>,
        folder: &Path,
        state: &SceneState,
        time: Timestamp,
    ) -> Result<(), FileError> {
        if is_reference(folder)?.is_none() {
            return Ok(());
        }
        for name in [GENERATED, TRUTH] {
            let folder = folder.join(name);
            if name == TRUTH && !folder.is_dir() {
                continue;
            }
            for camera in state.cameras.iter().map(|camera| &camera.view.camera) {
                let path = folder.join(format!("{}.png", camera.name));
                let (height, width) = picture_size(&path)?;
                let topic = |kind: &str| camera_topic(&camera.name, &format!("{name}/{kind}"));
                file.write_calibration(&topic("calibration"), camera, ImageSize { height, width }, time)?;
                file.write_image(&topic("image"), "png", read_file(&path, IMAGE_BYTES)?, time)?;
            }
        }
        Ok(())
    }

    /// Returns the maps that are PNG files.
    fn maps(&self) -> impl Iterator<Item = MapKind> {
        let maps = &self.record.conditions.maps;
        let is_png = self.record.format == MapFormat::Png;
        maps.iter().filter(move |kind| is_png && *kind != MapKind::Tensor)
    }

    fn state(&self, row: &StepRow) -> SceneState {
        let [x, y, z, last] = row.ego.global_from_ego;
        let matrix = DMat4::from_cols_array_2d(&[x, y, z, last]).transpose();
        let (_, rotation, translation) = matrix.to_scale_rotation_translation();
        let state = state_of(self.scenario.log, row.t_us, Pose { rotation, translation }, &[]);
        SceneState { actors: row.actors.iter().map(actor).collect(), ..state }
    }
}

fn actor(row: &ActorRow) -> ActorState {
    let pose = Pose { rotation: DQuat::from_rotation_z(row.heading_rad), translation: row.center_m.into() };
    ActorState {
        track: row.track.clone(),
        category: row.category.clone(),
        class: Class::from_category(&row.category),
        cuboid: Cuboid { pose, size: row.size_m.into() },
        appearance: None,
    }
}

fn rgb([r, g, b, _]: [u8; 4]) -> [u8; 3] {
    [r, g, b]
}

/// Returns the fields of a value, as JSON.
fn metadata(value: &impl Serialize, path: &Path) -> Result<BTreeMap<String, String>, FileError> {
    let value = serde_json::to_value(value).map_err(|error| FileError::io("write", path)(error.into()))?;
    let fields = match value {
        Value::Object(fields) => fields,
        _ => serde_json::Map::new(),
    };
    Ok(fields.into_iter().map(|(name, value)| (name, value.to_string())).collect())
}
