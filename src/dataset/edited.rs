use glam::DVec3;

use super::{ActorEdits, Appearance, EditError, Recording, Track, scenario};
use crate::geometry::{Cuboid, Pose};

/// Returns the log with the edits; `log` has none.
///
/// # Errors
/// Fails if a track does not exist, has no box at the time where it is held, or if a change does not fit the
/// log.
pub(super) fn apply(edits: &ActorEdits, log: &Recording) -> Result<Recording, EditError> {
    let mut edited = log.clone();
    edited.edits = edits.clone();
    for (id, t_us) in &edits.hold {
        let track = index(log, id)?;
        let held = log.boxes_at(*t_us).into_iter().find(|item| item.track == track);
        let held = held.ok_or_else(|| no_box(log, track, *t_us))?;
        for frame in &mut edited.frames {
            match frame.boxes.binary_search_by_key(&track, |item| item.track) {
                Ok(at) => frame.boxes[at] = held,
                Err(at) => frame.boxes.insert(at, held),
            }
        }
    }
    for (id, appearance) in edits.replace.iter().filter(|(id, _)| !edits.inserts(id)) {
        let track = index(log, id)?;
        let Appearance::Track(other) = appearance else { continue };
        let like = index(log, other)?;
        let Track { category, class, .. } = log.tracks[like].clone();
        edited.tracks[track] = Track { category, class, ..edited.tracks[track].clone() };
        resize(&mut edited, track, log.median_size(like));
    }
    for (id, size_m) in &edits.size_m {
        let (track, size) = (index(log, id)?, DVec3::from(*size_m));
        if Cuboid::new(Pose::IDENTITY, size).is_err() {
            return Err(EditError::Size { track: id.clone(), size_m: *size_m });
        }
        resize(&mut edited, track, size);
    }
    scenario::apply(edits, log, &mut edited)?;
    Ok(edited)
}

/// Gives all boxes of a track a size, meters.
fn resize(log: &mut Recording, track: usize, size: DVec3) {
    let boxes = log.frames.iter_mut().flat_map(|frame| &mut frame.boxes);
    for item in boxes.filter(|item| item.track == track) {
        item.cuboid = item.cuboid.resized(size);
    }
}

/// Returns the index of a track that has a box.
fn index(log: &Recording, id: &str) -> Result<usize, EditError> {
    let found = log.tracks.iter().position(|track| track.id == id);
    let found = found.filter(|track| log.frames.iter().any(|frame| frame.cuboid_of(*track).is_some()));
    found.ok_or_else(|| EditError::NoTrack { track: id.to_owned(), log: log.name.clone() })
}

fn no_box(log: &Recording, track: usize, t_us: i64) -> EditError {
    let boxes = log.track_boxes(track);
    let time_us = |at: Option<&(usize, Cuboid)>| at.map_or(0, |(frame, _)| log.frames[*frame].t_us);
    let (first_us, last_us) = (time_us(boxes.first()), time_us(boxes.last()));
    let (track, log) = (log.tracks[track].id.clone(), log.name.clone());
    EditError::NoBox { track, log, first_us, last_us, t_us }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{Class, Frame, TrackBox};

    /// Two cars and a bus; the second car is only in the first two of three frames.
    fn log() -> Recording {
        let track = |(id, category): (&str, &str)| Track {
            id: id.to_owned(),
            category: category.to_owned(),
            class: Class::from_category(category),
        };
        let cuboid = |x: f64, size: [f64; 3]| {
            let center = DVec3::new(x, 0.0, size[2] / 2.0);
            Cuboid::new(Pose::from_yaw(0.3, center), DVec3::from(size)).unwrap()
        };
        let frame = |i: usize| {
            let x = i as f64 * 2.0;
            let sizes = [[4.0, 2.0, 1.5], [4.5, 2.0, 1.6], [12.0, 2.5, 3.0]];
            let boxes = (0..3).filter(|track| *track != 1 || i < 2);
            let boxes = boxes.map(|track| TrackBox { track, cuboid: cuboid(x + track as f64, sizes[track]) });
            let (sweeps, images, between_images) = Default::default();
            let (t_us, global_from_ego) = (i as i64 * 100_000, Pose::IDENTITY);
            Frame { t_us, global_from_ego, sweeps, images, between_images, boxes: boxes.collect() }
        };
        let tracks =
            [("a", "vehicle.car"), ("b", "vehicle.car"), ("bus", "vehicle.bus.rigid")].map(track).to_vec();
        Recording { name: "log".into(), tracks, frames: (0..3).map(frame).collect(), ..Recording::default() }
    }

    fn edits(hold: &[(&str, i64)], replace: &[(&str, &str)]) -> ActorEdits {
        ActorEdits {
            hold: hold.iter().map(|(track, t_us)| ((*track).to_owned(), *t_us)).collect(),
            replace: replace.iter().map(|(track, by)| ((*track).to_owned(), (*by).into())).collect(),
            ..ActorEdits::default()
        }
    }

    #[test]
    fn a_held_track_stands_in_all_frames() {
        let log = log();
        let held = apply(&edits(&[("b", 50_000)], &[]), &log).unwrap();
        for (frame, before) in held.frames.iter().zip(&log.frames) {
            let center = frame.cuboid_of(1).unwrap().pose.translation;
            assert!(center.distance(DVec3::new(2.0, 0.0, 0.8)) < 1e-12, "{center}");
            assert_eq!([0, 2].map(|track| frame.cuboid_of(track)), [0, 2].map(|t| before.cuboid_of(t)));
            assert!(frame.boxes.is_sorted_by_key(|item| item.track));
        }
        assert_eq!((&held.tracks, held.edits.asset("b")), (&log.tracks, Some("b")));
    }

    #[test]
    fn a_replaced_track_has_the_size_of_the_other_on_its_own_ground() {
        let log = log();
        let both = apply(&edits(&[("a", 0)], &[("a", "bus"), ("bus", "template")]), &log).unwrap();
        assert_eq!(
            (both.tracks[0].id.as_str(), both.tracks[0].category.as_str()),
            ("a", "vehicle.bus.rigid")
        );
        for frame in &both.frames {
            let cuboid = frame.cuboid_of(0).unwrap();
            assert_eq!(cuboid.size, DVec3::new(12.0, 2.5, 3.0));
            assert!(cuboid.pose.translation.distance(DVec3::new(0.0, 0.0, 1.5)) < 1e-12);
        }
        assert_eq!((both.edits.asset("a"), both.edits.asset("bus")), (Some("bus"), None));
        assert_eq!(both.tracks[2], log.tracks[2]);
        assert_ne!(both.fingerprint(), log.fingerprint());
    }

    #[test]
    fn edits_that_change_no_box_have_a_fingerprint_of_their_own() {
        let log = log();
        let template = apply(&edits(&[], &[("a", "template")]), &log).unwrap();
        assert_eq!((&template.frames, &template.tracks), (&log.frames, &log.tracks));
        assert_ne!(template.fingerprint(), log.fingerprint());
        assert_eq!(apply(&ActorEdits::default(), &log).unwrap().fingerprint(), log.fingerprint());
    }

    #[test]
    fn impossible_edits_are_refused() {
        let refused = |edits: ActorEdits| apply(&edits, &log()).unwrap_err().to_string();
        for edits in [edits(&[("c", 0)], &[]), edits(&[], &[("c", "a")]), edits(&[], &[("a", "c")])] {
            assert_eq!(refused(edits), "expected tracks of log log, found \"c\"");
        }
        assert_eq!(
            refused(edits(&[("b", 150_000)], &[])),
            "expected a time at which track b of log log has a box (0 to 100000 us), found 150000"
        );
    }
}
