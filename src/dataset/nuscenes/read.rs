//! Conversion of one scene's tables to a [`Recording`].

use super::chain::Chain;
use super::folders::SensorFiles;
use super::frames::SweepInfos;
use super::version::Version;
use super::{annotations, choose, frames, unread};
use crate::dataset::clock::{Unit, note_interval};
use crate::dataset::recording::notes::{Notes, note, settle};
use crate::dataset::{BoxPoints, DatasetError, Frame, LogLocator, Recording, RigCamera};

/// Note for scenes of data sets without logs.
const NO_LOG: &str = "scenes without a log (location and HD map unknown)";

/// Log of a scene, and what its reader needs besides.
pub(super) struct SceneLog {
    pub(super) log: Recording,
    /// Stated number of LiDAR points per frame and box.
    pub(super) box_points: BoxPoints,
    pub(super) infos: SweepInfos,
}

/// Reads the log of a scene.
pub(super) fn read(
    files: &SensorFiles,
    version: &Version,
    locator: &LogLocator,
) -> Result<SceneLog, DatasetError> {
    let reading = &locator.reading;
    let scene = choose::choose_scene(&version.scenes, locator.scene.as_deref())?;
    let logs = choose::Logs::of(&version.folder, std::slice::from_ref(scene))?;
    let location = logs.location(scene)?;

    let mut notes = Notes::new();
    note(&mut notes, NO_LOG, usize::from(location.is_none()));
    let chain = Chain::of(&version.samples, scene, &mut notes)?;
    let shots = frames::read(files, version, scene, &chain, reading.distortion, &mut notes)?;
    note_interval(&chain.times_us, Unit::MICROS, &mut notes);
    let annotated = annotations::read(version, scene, &chain, &mut notes)?;
    unread::note_unread(version, scene, locator, location.unwrap_or_default(), &mut notes);
    let (mut log_frames, mut box_points) = (Vec::new(), Vec::new());
    for ((t_us, shot), (boxes, points)) in chain.times_us.iter().zip(shots.frames).zip(annotated.frames) {
        let Some(shot) = shot else { continue };
        let (sweeps, images, between_images) = (shot.sweeps, shot.images, shot.between_images);
        let global_from_ego = shot.global_from_ego;
        log_frames.push(Frame { t_us: *t_us, global_from_ego, sweeps, images, between_images, boxes });
        box_points.push(points);
    }
    let mut log = Recording {
        name: scene.name.clone(),
        token: scene.token.clone(),
        location: location.unwrap_or_default().to_owned(),
        description: scene.description.clone(),
        cameras: shots.cameras,
        rig: RigCamera::first_used(&log_frames),
        tracks: annotated.tracks,
        frames: log_frames,
        reading: *reading,
        ..Recording::default()
    };
    settle(&mut log, notes)?;
    Ok(SceneLog { log, box_points, infos: shots.infos })
}
