//! Conversion of a log's files to a [`Recording`].

use std::path::Path;

use super::annotations::{Annotation, Annotations};
use super::poses::Trajectory;
use super::{calibration, sensors};
use crate::dataset::notes::{Notes, UNKNOWN_POINTS, note, note_unknown_category};
use crate::dataset::{BoxPoints, DatasetError, Frame, Recording, TrackBox};
use crate::error::FileError;

/// Reads a log with its sweeps and images in `sensors`. Also returns the stated number of LiDAR points per frame and
/// box.
pub(super) fn read(
    folder: &Path,
    sensors: &Path,
    name: String,
    location: String,
) -> Result<(Recording, BoxPoints), DatasetError> {
    let path = folder.join("annotations.feather");
    let annotations = Annotations::read(&path)?;
    let ego = Trajectory::read(&folder.join("city_SE3_egovehicle.feather"))?;
    let rig = calibration::read(&folder.join("calibration"))?;
    let mut notes = Notes::new();
    for (category, boxes) in &annotations.unknown_categories {
        note_unknown_category(&mut notes, category, *boxes);
    }
    if annotations.other_category > 0 {
        notes.insert("boxes of another category than their track".into(), annotations.other_category);
    }
    let uncalibrated = calibration::RING.len().saturating_sub(rig.len());
    note(&mut notes, "ring cameras without calibration", uncalibrated);
    let (mut times_ns, mut frames, mut box_points) = (Vec::new(), Vec::new(), Vec::new());
    for (&t_ns, boxes) in &annotations.frames {
        let Some(global_from_ego) = ego.at(t_ns) else {
            note(&mut notes, "annotated times without an ego pose", 1);
            continue;
        };
        let t_us = sensors::micros(t_ns);
        if frames.last().is_some_and(|last: &Frame| last.t_us == t_us) {
            let found = format!("{t_ns} in the microsecond of the one before");
            return Err(FileError::content("annotated times a microsecond apart", found, &path).into());
        }
        let track_box = |item: &Annotation| {
            let cuboid = item.cuboid(&global_from_ego).map_err(|source| DatasetError::Cuboid {
                source,
                record: format!("row {}", item.row),
                path: path.clone(),
            })?;
            Ok(TrackBox { track: item.track, cuboid })
        };
        let (boxes, flat): (Vec<&Annotation>, Vec<_>) = boxes.iter().partition(|b| b.has_size());
        note(&mut notes, "boxes without a size", flat.len());
        let boxes_here = boxes.iter().copied().map(track_box).collect::<Result<Vec<_>, DatasetError>>()?;
        let (sweeps, images, between_images) = Default::default();
        let boxes_at = Frame { t_us, global_from_ego, sweeps, images, between_images, boxes: boxes_here };
        frames.push(boxes_at);
        let points: Vec<Option<u32>> = boxes.iter().map(|b| b.points).collect();
        note(&mut notes, UNKNOWN_POINTS, points.iter().filter(|n| n.is_none()).count());
        box_points.push(points);
        times_ns.push(t_ns);
    }
    if frames.is_empty() {
        let found = format!("none in {} rows", annotations.frames.values().map(Vec::len).sum::<usize>());
        return Err(FileError::content("boxes at a time with an ego pose", found, &path).into());
    }
    sensors::add_sweeps(&sensors.join("lidar"), &times_ns, &ego, &mut frames, &mut notes)?;
    for camera in &rig {
        let folder = sensors.join("cameras");
        sensors::add_images(&folder, &name, &times_ns, &ego, camera, &mut frames, &mut notes)?;
    }
    for frame in &mut frames {
        frame.between_images.sort_by_key(|i| (i.t_us, i.channel));
    }
    let cameras = rig.iter().map(|c| c.camera.name.clone()).collect();
    let (tracks, description) = (annotations.tracks, String::new());
    let log = Recording {
        name,
        location,
        description,
        cameras,
        rig,
        tracks,
        frames,
        notes,
        ..Recording::default()
    };
    Ok((log, box_points))
}
