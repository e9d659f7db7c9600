//! `alpasim`: `LOG.usdz`, a scene for the runtime of NVIDIA's AlpaSim. It has what a scene of NuRec has,
//! except for the neural reconstruction and its meshes, in place of which `pskel.serve` renders.
//!
//! A USDZ is a ZIP whose files are stored without compression, at multiples of 64 bytes. The files:
//! - `metadata.yaml`, `rig_trajectories.json` (cameras and ego) and `sequence_tracks.json` (actors),
//! - `clipgt/KIND.parquet`: the tables of the layout `world-scenario`, and those of lanes,
//! - `frames/CAMERA/MICROSECONDS.jpeg`: the first image of each camera.
//!
//! # How it works
//! All coordinates are local, because AlpaSim converts them to 32 bits: the origin is the ego's position at
//! the log's first frame, rounded down, which is also that of `pskel.serve`. Axes are global, and
//! `T_world_base` is the translation to global coordinates. AlpaSim names the cameras of `pskel.serve` as the
//! log does, those of its video model as NVIDIA's rig; a scene has both names.

mod archive;
mod cameras;
mod documents;

use std::path::Path;

use glam::{DQuat, DVec3};
use point_skeleton::Maps;
use point_skeleton::dataset::{ImageRecord, Recording};
use point_skeleton::geometry::{Camera, ImageSize, Pose};
use point_skeleton::scene::SceneMap;

use self::archive::Entry;
use self::cameras::Cameras;
use super::world_scenario::Clip;
use super::{LayoutWriter, Source};
use crate::files::{jpeg, recorded_images};
use crate::samples::Sample;
use crate::shard::Shard;
use crate::{ExportError, ExportOptions};

/// Number of ego poses between which AlpaSim interpolates.
const MIN_FRAMES: usize = 2;

/// Checks that AlpaSim can drive through the exported frames.
pub(super) fn check(options: &ExportOptions, log: &Recording) -> Result<(), ExportError> {
    let all = log.frames.len();
    let frames = options.frames.map_or(all, |[first, end]| end.min(all).saturating_sub(first));
    if frames >= MIN_FRAMES {
        return Ok(());
    }
    let expected = "at least 2 key frames with the layout alpasim";
    Err(ExportError::Lacks { expected, found: frames.to_string(), log: log.name.clone() })
}

pub(super) struct Scene<'a> {
    source: &'a Source<'a>,
}

impl<'a> Scene<'a> {
    pub(super) fn new(source: &'a Source<'a>) -> Self {
        Self { source }
    }

    /// Returns the log in local coordinates.
    fn clip(&self, shard: &Shard) -> Clip<'a> {
        let log = self.source.recording();
        let first = log.frames.first().map_or(DVec3::ZERO, |frame| frame.global_from_ego.translation);
        Clip {
            log,
            frames: log.frames.get(shard.frames()).unwrap_or_default(),
            name: log.name.clone(),
            clip_from_global: Pose { rotation: DQuat::IDENTITY, translation: -first.floor() },
        }
    }

    /// Returns the first image of each camera with a name of NVIDIA's rig, as for its calibration there:
    /// without lens distortion.
    fn first_images(&self, shard: &mut Shard, cameras: &Cameras<'_>) -> Result<Vec<Entry>, ExportError> {
        let (names, records): (Vec<&str>, Vec<&ImageRecord>) = cameras.first_images().unzip();
        let size = |camera: &Camera| ImageSize { height: camera.height, width: camera.width };
        let sizes: Vec<ImageSize> = records.iter().map(|record| size(&record.camera)).collect();
        let wanted: Vec<_> = records.iter().copied().map(Some).collect();
        let images = recorded_images(shard, self.source.log, &wanted, &sizes)?;
        let mut entries = Vec::new();
        for ((name, record), image) in names.iter().zip(records).zip(images) {
            let Some(image) = image else { continue };
            let path = format!("frames/{name}/{}.jpeg", record.t_us);
            let bytes = jpeg(Path::new(&path), &image)?;
            entries.push(Entry { path, bytes });
        }
        Ok(entries)
    }
}

impl LayoutWriter for Scene<'_> {
    fn add(&mut self, _: &mut Shard, _: &Sample<'_>, _: &Maps) -> Result<(), ExportError> {
        Ok(())
    }

    fn finish(self: Box<Self>, shard: &mut Shard) -> Result<(), ExportError> {
        let clip = self.clip(shard);
        let cameras = Cameras::new(&clip);
        let (tracks, skipped) = documents::sequence_tracks(&clip);
        shard.note("tracks with a single box (skipped)", skipped);
        let mut entries = vec![
            Entry::json("rig_trajectories.json", &documents::rig_trajectories(&clip, &cameras)),
            Entry::json("sequence_tracks.json", &tracks),
        ];
        let tables = match self.source.map.as_deref().map(SceneMap::vector_map) {
            Some(map) => clip.tables_with_lanes(map),
            None => clip.tables(None),
        };
        for table in tables {
            entries.push(Entry { path: format!("clipgt/{}.parquet", table.kind), bytes: table.encode()? });
        }
        entries.extend(self.first_images(shard, &cameras)?);
        // The hashes of the metadata are those of the other files.
        entries.insert(0, Entry::json("metadata.yaml", &documents::metadata(&clip, &cameras, &entries)));
        let path = format!("{}.usdz", self.source.listed.name);
        let bytes = archive::stored(&entries, Path::new(&path))?;
        Ok(shard.put(path, &bytes)?)
    }
}
