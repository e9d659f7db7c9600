//! Conversion of one scene's tables to a [`Recording`].

use super::chain::Chain;
use super::tables::{LogRecord, Table};
use super::version::Version;
use super::{annotations, choose, frames};
use crate::dataset::clock::{Unit, note_interval};
use crate::dataset::recording::notes::{Notes, settle};
use crate::dataset::{BoxPoints, DatasetError, Frame, ReadOptions, Recording, RigCamera};
use crate::files::input::DataRoot;

/// Reads the log of a scene. Also returns the stated number of LiDAR points per frame and box.
pub(super) fn read(
    root: &DataRoot,
    version: &Version,
    wanted_scene: Option<&str>,
    reading: &ReadOptions,
) -> Result<(Recording, BoxPoints), DatasetError> {
    let scene = choose::choose_scene(&version.scenes, wanted_scene)?;
    let logs = Table::<LogRecord>::load(&version.folder)?;
    let recorded = logs.get(&scene.log_token, || format!("scene {}", scene.token))?;

    let mut notes = Notes::new();
    let chain = Chain::of(&version.samples, scene, &mut notes)?;
    let shots = frames::read(root, version, scene, &chain, reading.distortion, &mut notes)?;
    note_interval(&chain.times_us, Unit::MICROS, &mut notes);
    let annotated = annotations::read(version, scene, &chain, &mut notes)?;
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
        location: recorded.location.clone(),
        description: scene.description.clone(),
        cameras: shots.cameras,
        rig: RigCamera::first_used(&log_frames),
        tracks: annotated.tracks,
        frames: log_frames,
        reading: *reading,
        ..Recording::default()
    };
    settle(&mut log, notes)?;
    Ok((log, box_points))
}
