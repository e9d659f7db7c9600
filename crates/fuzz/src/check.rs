//! Invariants of everything that is read.

use std::path::Path;

use point_skeleton::dataset::{Area, EgoTrack, LogReader, Recording, VectorMap};
use point_skeleton::files::text::printable_path;
use point_skeleton::scene::{EgoOffset, SceneMap, frame_rate_hz, state_at, state_of_frame};

/// Asserts that an error ends with its file's name, as messages escape it, and is not much longer than the
/// input that it may quote.
#[track_caller]
pub(crate) fn assert_names_file(error: impl std::fmt::Display, file: &Path, input: &[u8]) {
    let (message, file) = (error.to_string(), printable_path(file));
    assert!(message.ends_with(&file), "{message:?} does not end with {file}");
    short(&message, input);
}

/// Same as [`assert_names_file`], for an error in one of a folder's files.
#[track_caller]
pub(crate) fn assert_names_file_in(error: impl std::fmt::Display, folder: &Path, input: &[u8]) {
    let (message, folder) = (error.to_string(), printable_path(folder));
    assert!(message.contains(&folder), "{message:?} names no file of {folder}");
    short(&message, input);
}

/// Asserts the maximum length of a message, which may name no file.
#[track_caller]
pub(crate) fn short(message: &str, input: &[u8]) {
    let most = 4096 + 16 * input.len();
    assert!(message.len() <= most, "a message of {} bytes for {} of input", message.len(), input.len());
}

/// Checks the guarantees of a log, and that its users can process it.
pub(crate) fn dataset(dataset: &dyn LogReader, folder: &Path, input: &[u8]) {
    let log = dataset.recording();
    check_log(log);
    if let Some(points) = dataset.box_points() {
        let counts: Vec<usize> = points.iter().map(Vec::len).collect();
        assert_eq!(counts, log.frames.iter().map(|f| f.boxes.len()).collect::<Vec<_>>());
    }
    for record in log.frames.iter().flat_map(|f| &f.sweeps).take(2) {
        match (dataset.check_sweep(record), dataset.read_sweep(record)) {
            (Ok(count), Ok(sweep)) => {
                assert!(count.is_none_or(|n| n == (sweep.points.len() + sweep.dropped_non_finite) as u64));
            }
            (check, read) => check
                .err()
                .into_iter()
                .chain(read.err())
                .for_each(|e| assert_names_file(e, &record.path, input)),
        }
    }
    for record in log.frames.iter().flat_map(|f| &f.images).take(2) {
        if let Err(error) = dataset.check_image(record) {
            assert_names_file(error, &record.path, input);
        }
    }
    match dataset.read_map() {
        Ok(map) => map.iter().for_each(|map| check_map(map, log)),
        Err(error) => assert_names_file_in(error, folder, input),
    }
}

fn check_log(log: &Recording) {
    assert!(!log.frames.is_empty());
    assert!(log.frames.windows(2).all(|w| w[0].t_us < w[1].t_us), "times that do not grow");
    assert!(log.tracks.windows(2).all(|w| w[0].id < w[1].id), "tracks that are not sorted");
    assert!(log.rig.windows(2).all(|w| w[0].channel < w[1].channel));
    for frame in &log.frames {
        assert!(
            frame.global_from_ego.translation.is_finite() && frame.global_from_ego.rotation.is_normalized()
        );
        assert!(frame.boxes.windows(2).all(|w| w[0].track < w[1].track));
        assert!(frame.boxes.iter().all(|b| b.track < log.tracks.len()));
        assert!(
            frame
                .boxes
                .iter()
                .all(|b| b.cuboid.pose.translation.is_finite() && b.cuboid.size.min_element() > 0.0)
        );
        assert!(frame.images.windows(2).all(|w| w[0].channel < w[1].channel));
        assert!(frame.images.iter().chain(&frame.between_images).all(|i| i.channel < log.cameras.len()));
    }
    let (first, last) = (&log.frames[0], &log.frames[log.frames.len() - 1]);
    let (ego, middle) = (EgoTrack::new(log), first.t_us.midpoint(last.t_us));
    assert!(log.boxes_at(middle).len() <= log.tracks.len());
    assert!(ego.at(middle).is_some_and(|pose| !pose.translation.is_nan()));
    assert!(frame_rate_hz(&log.frames).is_none_or(|hz| hz > 0.0));
    assert!(state_of_frame(log, 0, EgoOffset::default()).is_some());
    assert!(state_at(log, &ego, middle, EgoOffset::default()).is_some());
}

/// Checks the guarantees of a map.
pub(crate) fn check_map(map: &VectorMap, log: &Recording) {
    let whole = |area: &Area| {
        std::iter::once(&area.exterior)
            .chain(&area.holes)
            .all(|r| r.len() >= 3 && r.iter().all(|p| p.is_finite()))
    };
    let lanes = || map.lanes.iter().chain(&map.lane_connectors);
    assert!(lanes().all(|lane| whole(&lane.outline) && lane.centerline.iter().all(|p| p.is_finite())));
    assert!(map.drivable_area.iter().chain(&map.crossings).chain(&map.stop_lines).all(whole));
    assert!(map.dividers.iter().all(|line| line.len() >= 2 && line.iter().all(|p| p.is_finite())));
    let scene = SceneMap::new(map.clone(), log);
    let place = log.frames[0].global_from_ego.translation.truncate();
    assert!(scene.edges_within(place - 50.0, place + 50.0).len() <= scene.edges().len());
}
