use std::collections::BTreeMap;
use std::path::Path;

use glam::DVec3;

use super::{Asset, BuildOptions, BuildReport, CHUNK_M, Checksum, Chunk, Skeleton, SkeletonWriter, Source};
use crate::cloud::{Bounds, Point};
use crate::dataset::Class;
use crate::error::FileError;

/// Point in the global frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GlobalPoint {
    /// Global meters, finite.
    pub position: DVec3,
    /// Red, green, blue.
    pub rgb: [u8; 3],
    /// Class, as in the class map.
    pub class: u8,
}

/// Points of a track.
#[derive(Clone, Debug, PartialEq)]
pub struct AssetPoints {
    /// Track id.
    pub track: String,
    /// Dotted category as in nuScenes.
    pub category: String,
    /// Coarse class.
    pub class: Class,
    /// Length, width, height of the track's box, meters.
    pub size: [f64; 3],
    /// Points in the frame of the box, meters.
    pub points: Vec<Point>,
}

impl Skeleton {
    /// Writes a skeleton of colored points from another source to a folder, under the name of a log. An existing skeleton
    /// is replaced. Points retain their order within a chunk of the background and within an asset.
    ///
    /// # Errors
    /// Fails if there is no background point, if a track occurs twice, or if the folder cannot be written.
    pub fn from_points(
        folder: &Path,
        log: &str,
        background: &[GlobalPoint],
        mut assets: Vec<AssetPoints>,
    ) -> Result<Self, FileError> {
        let mut chunks: BTreeMap<[i64; 3], Vec<Point>> = BTreeMap::new();
        for GlobalPoint { position, rgb, class } in background {
            let at = (position / CHUNK_M).floor();
            let local = (position - at * CHUNK_M).as_vec3().to_array();
            chunks.entry(at.to_array().map(|i| i as i64)).or_default().push(Point::new(local, *rgb, *class));
        }
        if chunks.is_empty() {
            return Err(FileError::content("a point of the background", "none", folder));
        }
        assets.sort_by(|a, b| a.track.cmp(&b.track));
        if let Some(pair) = assets.windows(2).find(|pair| pair[0].track == pair[1].track) {
            return Err(FileError::content("tracks once each", format!("two {:?}", pair[0].track), folder));
        }
        let report = BuildReport {
            points_read: background.len() + assets.iter().map(|asset| asset.points.len()).sum::<usize>(),
            background_points: background.len(),
            actor_points: assets.iter().map(|asset| asset.points.len()).sum(),
            ..BuildReport::default()
        };
        SkeletonWriter::write(folder, |writer| {
            for (at, points) in &chunks {
                let Some(bounds) = Bounds::of(points) else { continue };
                let (origin, xxh3) = (at.map(|i| i as f64 * CHUNK_M), Checksum::of(points));
                writer.chunk(Chunk { origin, points: points.len(), bounds, xxh3 }, points)?;
            }
            for AssetPoints { track, category, class, size, points } in &assets {
                let Some(bounds) = Bounds::of(points) else { continue };
                let asset = Asset {
                    log: log.to_owned(),
                    track: track.clone(),
                    category: category.clone(),
                    class: *class,
                    size: *size,
                    sweeps: 0,
                    points: points.len(),
                    bounds,
                    xxh3: Checksum::of(points),
                };
                writer.actor(asset, points)?;
            }
            let source = Source { log: log.to_owned(), ..Source::default() };
            writer.finish(vec![source], BuildOptions::default(), report)
        })?;
        Self::open(folder)
    }
}
