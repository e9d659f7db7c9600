use std::collections::BTreeMap;
use std::path::Path;

use glam::DVec3;

use super::{Asset, BuildOptions, BuildReport, CHUNK_M, Chunk, Skeleton, SkeletonWriter, Source};
use crate::cloud::{Bounds, Point, sort_in_space};
use crate::dataset::Class;
use crate::error::FileError;
use crate::files::Checksum;
use crate::skeleton::manifest::{check_position, check_size};

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
    /// Writes a skeleton of colored points from another source to a folder, under the name of a log. An
    /// existing skeleton is replaced. Points of background chunks and of assets are sorted in
    /// space.
    ///
    /// # Errors
    /// Fails if there is no background point, if a track occurs twice, if a position or size is beyond the
    /// limits of all files ([`geometry`](crate::geometry)), or if the folder cannot be written.
    pub fn from_points(
        folder: &Path,
        log: &str,
        background: &[GlobalPoint],
        mut assets: Vec<AssetPoints>,
    ) -> Result<Self, FileError> {
        let mut chunks: BTreeMap<[i64; 3], Vec<Point>> = BTreeMap::new();
        for (row, GlobalPoint { position, rgb, class }) in background.iter().enumerate() {
            check_position(
                "a position",
                position.to_array(),
                || format!("point {row} of the background"),
                folder,
            )?;
            let at = (position / CHUNK_M).floor();
            let local = (position - at * CHUNK_M).as_vec3().to_array();
            chunks.entry(at.to_array().map(|i| i as i64)).or_default().push(Point::new(local, *rgb, *class));
        }
        if chunks.is_empty() {
            return Err(FileError::content("a point of the background", "none", folder));
        }
        chunks.values_mut().for_each(sort_in_space);
        assets.sort_by(|a, b| a.track.cmp(&b.track));
        if let Some(pair) = assets.windows(2).find(|pair| pair[0].track == pair[1].track) {
            return Err(FileError::content("tracks once each", format!("two {:?}", pair[0].track), folder));
        }
        for AssetPoints { track, size, points, .. } in &assets {
            check_size(*size, || format!("track {track:?}"), folder)?;
            for (row, point) in points.iter().enumerate() {
                let of = || format!("point {row} of track {track:?}");
                check_position("a position", point.position.map(f64::from), of, folder)?;
            }
        }
        assets.iter_mut().for_each(|asset| sort_in_space(&mut asset.points));
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_keep_their_positions() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("skeleton");
        let far = DVec3::new(500_000.25, -4_000_000.5, 30.125);
        let point = |i: u8| GlobalPoint {
            position: far + DVec3::new(f64::from(i) * 7.5, 0.0, 0.0),
            rgb: [i, 2, 3],
            class: i % 5,
        };
        let background: Vec<GlobalPoint> = (0..20).map(point).collect();
        let asset = |track: &str| AssetPoints {
            track: track.to_owned(),
            category: "vehicle.car".to_owned(),
            class: Class::MotorVehicle,
            size: [4.0, 2.0, 1.5],
            points: vec![Point::new([0.5, 0.25, -0.125], [9, 8, 7], 1)],
        };
        let assets = vec![asset("b"), asset("a")];
        let skeleton = Skeleton::from_points(&path, "mine", &background, assets).unwrap();
        let mut found = Vec::new();
        for (chunk, points) in skeleton.manifest.background.iter().zip(skeleton.background().unwrap()) {
            for point in points {
                let position = DVec3::from(chunk.origin) + glam::Vec3::from(point.position).as_dvec3();
                found.push(GlobalPoint { position, rgb: point.rgb(), class: point.class() });
            }
        }
        assert!(skeleton.manifest.background.len() > 3, "several chunks");
        assert_eq!(found, background); // all positions are multiples of 1/8 m
        let tracks: Vec<&str> = skeleton.manifest.actors.iter().map(|asset| asset.track.as_str()).collect();
        assert_eq!((tracks, skeleton.manifest.times_us("mine")), (vec!["a", "b"], Some([0, 0])));

        let message = |background: &[GlobalPoint], assets| {
            Skeleton::from_points(&path, "mine", background, assets).unwrap_err().to_string()
        };
        assert!(message(&[], Vec::new()).contains("a point of the background, found none"));
        assert!(message(&background, vec![asset("a"), asset("a")]).contains("two \"a\""));
        let lost = GlobalPoint { position: DVec3::new(0.0, 0.0, -1e20), ..background[0] };
        let found = message(&[background[0], lost], Vec::new());
        assert!(found.contains("found [0.0, 0.0, -1e20] in point 1 of the background"), "{found}");
        let mut far = asset("a");
        far.points[0].position[2] = 3e38;
        assert!(message(&background, vec![far]).contains("in point 0 of track \"a\""));
        let huge = AssetPoints { size: [4.0, 1e308, 1.5], ..asset("a") };
        assert!(message(&background, vec![huge]).contains("found [4.0, 1e308, 1.5] in track \"a\""));
        assert!(Skeleton::open(&path).is_ok(), "a failure leaves the old one");
    }
}
