//! `annotations.feather`: boxes, each in the ego frame at its time.

use std::collections::BTreeMap;
use std::path::Path;

use glam::DVec3;

use super::poses::{POSE, micros, poses};
use crate::dataset::category::argoverse;
use crate::dataset::clock::Unit;
use crate::dataset::tables::{ArrowFile, Table};
use crate::dataset::{Class, DatasetError, Track};
use crate::error::FileError;
use crate::geometry::{Cuboid, CuboidError, Pose};

/// Column with the number of LiDAR points in a box. It is only reported, so it may be missing.
const POINTS: &str = "num_interior_pts";

/// Row of the file: a box at one time.
#[derive(Clone, Copy)]
pub(super) struct Annotation {
    /// Row in the file.
    pub(super) row: usize,
    /// Index in [`Annotations::tracks`].
    pub(super) track: usize,
    /// In the ego frame.
    pub(super) ego_from_box: Pose,
    /// Length, width, height in meters.
    pub(super) size: DVec3,
    /// Number of LiDAR points in the box, as stated by the file, if it is known.
    pub(super) points: Option<u32>,
}

/// All boxes of a log.
pub(super) struct Annotations {
    /// Sorted by id.
    pub(super) tracks: Vec<Track>,
    /// Boxes by time in nanoseconds; each list is sorted by track.
    pub(super) frames: BTreeMap<i64, Vec<Annotation>>,
    /// Number of boxes per category that the dataset does not define.
    pub(super) unknown_categories: BTreeMap<String, usize>,
    /// Number of boxes whose category differs from the first row of their track.
    pub(super) other_category: usize,
}

impl Annotations {
    /// Creates the frames of a log without annotations, at the times of its sweeps (nanoseconds).
    pub(super) fn none(times_ns: Vec<i64>) -> Self {
        let frames = times_ns.into_iter().map(|t_ns| (t_ns, Vec::new())).collect();
        Self { tracks: Vec::new(), frames, unknown_categories: BTreeMap::new(), other_category: 0 }
    }

    /// Reads and validates the file.
    ///
    /// # Errors
    /// Fails if the file is damaged, a pose is invalid, or a track occurs twice at one time.
    pub(super) fn read(path: &Path) -> Result<Self, DatasetError> {
        const OTHERS: [&str; 6] =
            ["timestamp_ns", "track_uuid", "category", "length_m", "width_m", "height_m"];
        let table = ArrowFile::read(path)?.table(&[&OTHERS[..], &POSE[..]].concat(), &[POINTS])?;
        let (ids, categories) = (table.column("track_uuid")?.texts()?, table.column("category")?.texts()?);
        let mut category_of = BTreeMap::new();
        for (id, category) in ids.iter().zip(&categories) {
            category_of.entry(*id).or_insert(*category);
        }
        let of_track = |id: &&str, category: &&str| category_of.get(id) == Some(category);
        let other_category = ids.iter().zip(&categories).filter(|(id, c)| !of_track(id, c)).count();
        let mut unknown_categories = BTreeMap::new();
        for name in categories.iter().filter(|name| argoverse::dotted(name).is_none()) {
            *unknown_categories.entry((*name).to_owned()).or_default() += 1;
        }
        let place: BTreeMap<&str, usize> = category_of.keys().enumerate().map(|(i, id)| (*id, i)).collect();
        let frames = frames(&table, |row| place.get(ids[row]).copied().unwrap_or_default())?;
        for (t_ns, boxes) in &frames {
            if let Some(pair) = boxes.windows(2).find(|pair| pair[0].track == pair[1].track) {
                let hint = Unit::NANOS.hint(micros(*t_ns) as f64);
                let found = format!("two of {} at {t_ns}{hint}", ids[pair[0].row]);
                return Err(FileError::content("one box per track and time", found, path).into());
            }
        }
        let track = |(id, name): (&str, &str)| {
            let category = argoverse::dotted(name).unwrap_or_else(|| argoverse::unknown(name));
            let class = Class::from_category(&category);
            Track { id: id.to_owned(), category, class }
        };
        let tracks = category_of.into_iter().map(track).collect();
        Ok(Self { tracks, frames, unknown_categories, other_category })
    }
}

impl Annotation {
    /// Returns the box in the city frame; `None` if it has no size, see [`Cuboid::unless_flat`].
    ///
    /// # Errors
    /// Fails if a side is not finite, or a side or a coordinate is beyond the limits of boxes.
    pub(super) fn cuboid(&self, city_from_ego: &Pose) -> Result<Option<Cuboid>, CuboidError> {
        Cuboid::unless_flat(*city_from_ego * self.ego_from_box, self.size)
    }
}

/// Groups the rows by time; `track_of` returns the track of a row.
fn frames(
    table: &Table,
    track_of: impl Fn(usize) -> usize,
) -> Result<BTreeMap<i64, Vec<Annotation>>, DatasetError> {
    let numbers = |name: &str| table.column(name)?.numbers();
    let [length, width, height] = [numbers("length_m")?, numbers("width_m")?, numbers("height_m")?];
    let times_ns = table.column("timestamp_ns")?.integers()?;
    let points = match table.has(POINTS) {
        true => table.column(POINTS)?.known_counts(),
        false => vec![None; table.rows()],
    };
    let mut frames: BTreeMap<i64, Vec<Annotation>> = BTreeMap::new();
    for (row, ego_from_box) in poses(table, |row| format!("row {row}"))?.into_iter().enumerate() {
        let size = DVec3::new(length[row], width[row], height[row]);
        let track = track_of(row);
        let annotation = Annotation { row, track, ego_from_box, size, points: points[row] };
        frames.entry(times_ns[row]).or_default().push(annotation);
    }
    for boxes in frames.values_mut() {
        boxes.sort_by_key(|b| b.track);
    }
    Ok(frames)
}
