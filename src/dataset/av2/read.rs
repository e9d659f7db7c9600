//! Conversion of a log's files to a [`Recording`].

use std::path::Path;

use super::annotations::Annotations;
use super::poses::{Trajectory, micros};
use super::{calibration, sensors};
use crate::dataset::clock::{Offset, Unit, note_interval};
use crate::dataset::recording::notes::{
    FLAT_BOX, NO_ANNOTATIONS, Notes, UNKNOWN_POINTS, note, note_unknown_category, settle,
};
use crate::dataset::{BoxPoints, DatasetError, Frame, Gap, ReadOptions, Recording, TrackBox};
use crate::error::FileError;
use crate::files::input::is_there;

/// Kind of a gap: an annotated time outside of the recorded poses.
const NO_POSE: &str = "annotated times without an ego pose";

/// Reads a log with its sweeps and images in `sensors`. Also returns the stated number of LiDAR points per
/// frame and box.
pub(super) fn read(
    folder: &Path,
    sensors: &Path,
    name: String,
    location: String,
    reading: &ReadOptions,
) -> Result<(Recording, BoxPoints), DatasetError> {
    let path = folder.join("annotations.feather");
    let lidar = sensors.join("lidar");
    let annotations = if is_there(&path)? { Some(Annotations::read(&path)?) } else { None };
    // Logs of the test split, and of the lidar and map-change sets, have none.
    let annotations = annotations.filter(|annotations| !annotations.frames.is_empty());
    let is_annotated = annotations.is_some();
    let annotations = match annotations {
        Some(annotations) => annotations,
        None => Annotations::none(sensors::times_ns(&lidar)?),
    };
    let poses = folder.join("city_SE3_egovehicle.feather");
    let ego = Trajectory::read(&poses)?;
    let mut notes = Notes::new();
    let rig = calibration::read(&folder.join("calibration"), reading.distortion, &mut notes)?;
    if !is_annotated {
        notes.gap(Gap::record(NO_ANNOTATIONS, "frames are at the times of sweeps, without actors", &path));
    }
    for (category, boxes) in &annotations.unknown_categories {
        note_unknown_category(&mut notes, category, *boxes);
    }
    note(&mut notes, "boxes of another category than their track", annotations.other_category);
    let (mut times_ns, mut frames, mut box_points) = (Vec::new(), Vec::new(), Vec::new());
    for (&t_ns, boxes) in &annotations.frames {
        let Some(global_from_ego) = ego.at(t_ns) else {
            // Without annotations this is the time of a sweep, which is counted with the other sweeps.
            if is_annotated {
                notes.gap(Gap::record(NO_POSE, format!("time {t_ns}"), &poses));
            }
            continue;
        };
        let t_us = micros(t_ns);
        if frames.last().is_some_and(|last: &Frame| last.t_us == t_us) {
            let hint = Unit::NANOS.hint(t_us as f64);
            let found = format!("{t_ns} in the microsecond of the one before{hint}");
            return Err(FileError::content("annotated times a microsecond apart", found, &path).into());
        }
        let (mut boxes_here, mut points) = (Vec::new(), Vec::new());
        for item in boxes {
            let record = || format!("row {}", item.row);
            let cuboid = item.cuboid(&global_from_ego).map_err(|source| DatasetError::Cuboid {
                source,
                record: record(),
                path: path.clone(),
            })?;
            let Some(cuboid) = cuboid else {
                notes.gap(Gap::record(FLAT_BOX, record(), &path));
                continue;
            };
            boxes_here.push(TrackBox { track: item.track, cuboid });
            points.push(item.points);
        }
        let (sweeps, images, between_images) = Default::default();
        let boxes_at = Frame { t_us, global_from_ego, sweeps, images, between_images, boxes: boxes_here };
        frames.push(boxes_at);
        note(&mut notes, UNKNOWN_POINTS, points.iter().filter(|n| n.is_none()).count());
        box_points.push(points);
        times_ns.push(t_ns);
    }
    if frames.is_empty() && !is_annotated {
        let expected = "annotations.feather, or sweeps at times with an ego pose in sensors/lidar";
        return Err(FileError::content(expected, "neither", folder).into());
    }
    if frames.is_empty() {
        let rows = annotations.frames.values().map(Vec::len).sum::<usize>();
        let times = annotations.frames.keys().map(|t_ns| micros(*t_ns));
        let offset = Offset::of_all(times, ego.span_us(), Unit::NANOS);
        let offset = offset.map_or_else(String::new, |offset| format!(", the first {offset}"));
        let found = format!("none in {rows} rows{offset}");
        return Err(FileError::content("boxes at a time with an ego pose", found, &path).into());
    }
    let times_us: Vec<i64> = frames.iter().map(|frame: &Frame| frame.t_us).collect();
    note_interval(&times_us, Unit::NANOS, &mut notes);
    sensors::add_sweeps(&lidar, &times_ns, &ego, &mut frames, &mut notes)?;
    for camera in &rig {
        let folder = sensors.join("cameras");
        sensors::add_images(&folder, &name, &times_ns, &ego, camera, &mut frames, &mut notes)?;
    }
    for frame in &mut frames {
        frame.between_images.sort_by_key(|i| (i.t_us, i.channel));
    }
    let cameras = rig.iter().map(|c| c.camera.name.clone()).collect();
    let (tracks, description) = (annotations.tracks, String::new());
    let mut log = Recording {
        name,
        location,
        description,
        cameras,
        rig,
        tracks,
        frames,
        reading: *reading,
        ..Recording::default()
    };
    settle(&mut log, notes)?;
    Ok((log, box_points))
}
