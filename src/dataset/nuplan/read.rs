//! Conversion of a log's tables to a [`Recording`].

use super::database::{Database, Query, hex};
use super::place::LogPaths;
use super::{annotations, frames, images, routes, situation};
use crate::dataset::clock::{Unit, note_interval};
use crate::dataset::recording::notes::{Notes, settle};
use crate::dataset::{DatasetError, Frame, MapFiles, ReadOptions, Recording};
use crate::error::FileError;

/// Reads a log, or one scene of it. Also returns the name of its map.
pub(super) fn read(
    place: &LogPaths,
    scene: Option<&str>,
    reading: &ReadOptions,
) -> Result<(Recording, String), DatasetError> {
    let database = Database::open(&place.database)?;
    let about = LogInfo::read(&database)?;
    let scene = scene.map(|wanted| Scene::read(&database, wanted)).transpose()?;
    let mut notes = Notes::new();
    let wanted = scene.as_ref().map(|s| s.token.as_slice());
    let (shots, span_us) = frames::read(&database, place, wanted, &mut notes)?;
    let times_us: Vec<i64> = shots.iter().map(|shot| shot.t_us).collect();
    note_interval(&times_us, Unit::MICROS, &mut notes);
    let within = images::FrameTimes { times_us: &times_us, span_us, is_whole: scene.is_none() };
    let pictures = images::read(&database, place, &within, reading.distortion, &mut notes)?;
    let annotated = annotations::read(&database, &shots, &mut notes)?;
    let (scenarios, lights) = situation::read(&database, &shots, &mut notes)?;
    let routes = routes::read(&database, &shots, &mut notes)?;
    let absolute = |root| std::path::absolute(root).map_err(FileError::io("find", root));
    let root = place.maps.as_deref().map(absolute).transpose()?;
    let seen = pictures.frames.into_iter().zip(annotated.frames);
    let frame = |(shot, (pictures, boxes)): (frames::FrameRecord, (images::FrameImages, _))| Frame {
        t_us: shot.t_us,
        global_from_ego: shot.global_from_ego,
        sweeps: shot.sweep.into_iter().collect(),
        images: pictures.images,
        between_images: pictures.between_images,
        boxes,
    };
    let description = match &scene {
        None => about.description,
        Some(scene) => format!("{}, {}", about.description, scene.name),
    };
    let mut log = Recording {
        name: about.name,
        location: about.location,
        description,
        cameras: pictures.rig.iter().map(|c| c.camera.name.clone()).collect(),
        rig: pictures.rig,
        tracks: annotated.tracks,
        frames: shots.into_iter().zip(seen).map(frame).collect(),
        scenarios,
        lights,
        routes,
        map_files: root.map(|root| MapFiles { name: about.map_name.clone(), root }),
        reading: *reading,
        ..Recording::default()
    };
    settle(&mut log, notes)?;
    Ok((log, about.map_name))
}

/// Row of the table `log`.
struct LogInfo {
    name: String,
    location: String,
    description: String,
    map_name: String,
}

impl LogInfo {
    fn read(database: &Database) -> Result<Self, DatasetError> {
        let columns = &["token", "logfile", "location", "map_version", "vehicle_name", "date"];
        let mut rows = Vec::new();
        database.rows(&Query { table: "log", columns, from: "FROM log" }, |row| {
            let map_version = row.text(3)?;
            rows.push(Self {
                name: row.text(1)?.to_owned(),
                location: row.text(2)?.to_owned(),
                description: format!("{} {}", row.text(4)?, row.text(5)?),
                map_name: map_version.strip_suffix(".gpkg").unwrap_or(map_version).to_owned(),
            });
            Ok(())
        })?;
        let found = rows.len();
        match (rows.pop(), found) {
            (Some(about), 1) => Ok(about),
            _ => Err(FileError::content("one row in log", found.to_string(), database.path()).into()),
        }
    }
}

/// Row of the table `scene`, a time slice of the log.
struct Scene {
    token: Vec<u8>,
    name: String,
}

impl Scene {
    /// Finds a scene by name or token.
    fn read(database: &Database, wanted: &str) -> Result<Self, DatasetError> {
        let mut scenes = Vec::new();
        database.rows(&Query { table: "scene", columns: &["token", "name"], from: "FROM scene" }, |row| {
            scenes.push(Self { token: row.blob(0)?.to_owned(), name: row.text(1)?.to_owned() });
            Ok(())
        })?;
        if let Some(at) = scenes.iter().position(|s| s.name == wanted || hex(&s.token) == wanted) {
            return Ok(scenes.swap_remove(at));
        }
        let mut names: Vec<String> = scenes.into_iter().map(|s| s.name).collect();
        names.sort();
        let path = database.path().to_owned();
        Err(DatasetError::Scene { found: Some(wanted.to_owned()), scenes: names, path })
    }
}
