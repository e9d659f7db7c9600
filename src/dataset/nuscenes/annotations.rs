//! Tracks and boxes of a scene.

use glam::DVec3;
use rustc_hash::FxHashSet;

use super::chain::Chain;
use super::frames::pose;
use super::tables::{Annotation, Category, Instance, Scene, Table};
use super::version::Version;
use crate::dataset::recording::notes::{
    DANGLING_BOX, FLAT_BOX, NO_ANNOTATIONS, Notes, UNKNOWN_POINTS, note, note_unknown_category,
};
use crate::dataset::{CategoryKind, Class, DatasetError, Gap, Track, TrackBox};
use crate::error::FileError;
use crate::geometry::Cuboid;

/// Tracks, and per frame the boxes with their stated number of LiDAR points, if it is known.
pub(super) struct Annotations {
    /// Sorted by id.
    pub(super) tracks: Vec<Track>,
    /// Boxes and point counts per frame, sorted by track; both lists have the same length.
    pub(super) frames: Vec<(Vec<TrackBox>, Vec<Option<u32>>)>,
}

/// Reads the boxes of every sample of the chain.
pub(super) fn read(
    version: &Version,
    scene: &Scene,
    chain: &Chain,
    notes: &mut Notes,
) -> Result<Annotations, DatasetError> {
    let mut annotations = version.rows()?.annotations(scene, &version.folder)?;
    annotations.retain(|a| chain.place.contains_key(&a.sample_token));
    if annotations.records.is_empty() {
        notes.gap(Gap::record(NO_ANNOTATIONS, "frames are without actors", &annotations.path));
        let none = |_| (Vec::new(), Vec::new());
        return Ok(Annotations { tracks: Vec::new(), frames: chain.times_us.iter().map(none).collect() });
    }
    let needed: FxHashSet<&str> = annotations.records.iter().map(|a| a.instance_token.as_str()).collect();
    let mut instances = Table::<Instance>::load(&version.folder)?;
    instances.retain(|i| needed.contains(i.token.as_str()));
    instances.sort_by_token();
    let categories = Table::<Category>::load(&version.folder)?;
    // Boxes without an instance or a category are skipped.
    annotations.retain(|annotation| match missing(annotation, &instances, &categories) {
        Some(gap) => {
            notes.gap(gap);
            false
        }
        None => true,
    });
    // The tracks have the positions of the instances.
    let mut tracks = Vec::new();
    instances.retain(|instance| {
        let Some(category) = categories.find(&instance.category_token) else { return false };
        let (category, class) = (category.name.clone(), Class::from_category(&category.name));
        tracks.push(Track { id: instance.token.clone(), category, class });
        true
    });
    let mut frames = vec![Vec::new(); chain.times_us.len()];
    for annotation in &annotations.records {
        let by = || format!("sample_annotation {}", annotation.token);
        let Some(track) = instances.position(&annotation.instance_token) else { continue };
        let Some(cuboid) = cuboid(&annotations, annotation)? else {
            notes.gap(Gap::record(FLAT_BOX, by(), &annotations.path));
            continue;
        };
        let points = annotation.num_lidar_pts.get();
        note(notes, UNKNOWN_POINTS, usize::from(points.is_none()));
        if CategoryKind::of(&tracks[track].category).is_none() {
            note_unknown_category(notes, &tracks[track].category, 1);
        }
        frames[chain.place[&annotation.sample_token]].push((TrackBox { track, cuboid }, points));
    }
    for frame in &mut frames {
        frame.sort_by_key(|(b, _)| b.track);
        if let Some(pair) = frame.windows(2).find(|pair| pair[0].0.track == pair[1].0.track) {
            let found = format!("two of instance {}", tracks[pair[0].0.track].id);
            return Err(
                FileError::content("one box per instance and sample", found, &annotations.path).into()
            );
        }
    }
    Ok(Annotations { tracks, frames: frames.into_iter().map(|f| f.into_iter().unzip()).collect() })
}

/// Returns the gap of a box whose instance or category is missing.
fn missing(
    annotation: &Annotation,
    instances: &Table<Instance>,
    categories: &Table<Category>,
) -> Option<Gap> {
    let by = format!("sample_annotation {}", annotation.token);
    let Some(instance) = instances.find(&annotation.instance_token) else {
        return Some(Gap::dangling(
            DANGLING_BOX,
            &by,
            "instance",
            &annotation.instance_token,
            &instances.path,
        ));
    };
    let category = &instance.category_token;
    let gap = || Gap::dangling(DANGLING_BOX, &by, "category", category, &categories.path);
    categories.find(category).is_none().then(gap)
}

/// Converts an annotation; the tables store width, length, height. `None` if it has no size.
fn cuboid(table: &Table<Annotation>, annotation: &Annotation) -> Result<Option<Cuboid>, DatasetError> {
    let pose = pose(table, annotation, annotation.rotation, annotation.translation)?;
    let [width, length, height] = annotation.size;
    Cuboid::unless_flat(pose, DVec3::new(length, width, height)).map_err(|source| DatasetError::Cuboid {
        source,
        record: format!("sample_annotation {}", annotation.token),
        path: table.path.clone(),
    })
}
