use std::collections::BTreeMap;

use glam::DVec3;

use super::color::estimator::Candidate;
use super::projector::Corners;
use crate::cloud::{Bounds, Point, morton_order};
use crate::dataset::{Sweep, SweepRecord};
use crate::geometry::is_position;
use crate::skeleton::{Part, SplitOptions, Splitter};

/// Number of points that are projected at a time.
pub(in super::super) const BLOCK: usize = 1024;

/// Point color for logs without images.
const GREY: [u8; 3] = [128; 3];

/// Note for merged sweeps whose LiDARs are all others.
const NO_PRIMARY: &str = "sweeps of merged LiDARs without LiDAR 0 (points on moving actors retained)";

/// Points of a sweep, separated into background and actors.
#[derive(Default)]
pub(in super::super) struct SweepCloud {
    pub(in super::super) t_us: i64,
    /// Background points in the global frame.
    pub(in super::super) background: Vec<Candidate>,
    /// Points of each track in its box frame.
    pub(in super::super) actors: BTreeMap<usize, Vec<Candidate>>,
    pub(in super::super) read: usize,
    /// By part, of its blocks, if its points are sorted in space.
    pub(in super::super) corners: BTreeMap<Option<usize>, Vec<Corners>>,
    /// Points with NaN, infinite or impossible coordinates.
    pub(in super::super) not_finite: usize,
    pub(in super::super) ghosts: usize,
    pub(in super::super) ego: usize,
    /// Notes of the sweep, and of its separation.
    pub(in super::super) notes: BTreeMap<String, usize>,
}

impl SweepCloud {
    /// Separates the points of a sweep into background, actors, ghosts and ego returns.
    pub(in super::super) fn split(
        sweep: &Sweep,
        record: &SweepRecord,
        splitter: &Splitter,
        options: &SplitOptions,
    ) -> Self {
        let global_from_lidar = record.global_from_ego * record.ego_from_lidar;
        let mut cloud = Self {
            t_us: record.t_us,
            read: sweep.points.len() + sweep.dropped_non_finite,
            not_finite: sweep.dropped_non_finite,
            notes: sweep.notes.clone(),
            ..Self::default()
        };
        let primary = options.primary_lidar.filter(|_| sweep.devices);
        // Without points of that LiDAR, nothing says which one matches the boxes.
        let has_points = |lidar: &u16| sweep.points.iter().any(|point| point.ring == *lidar);
        let primary = match primary {
            Some(lidar) if !has_points(&lidar) && !sweep.points.is_empty() => {
                cloud.notes.insert(NO_PRIMARY.to_owned(), 1);
                None
            }
            primary => primary,
        };
        for point in &sweep.points {
            let position = DVec3::from(point.position.map(f64::from));
            let global = global_from_lidar.transform_point(position);
            if !is_position(global) {
                cloud.not_finite += 1;
                continue;
            }
            let synchronized = primary.is_none_or(|lidar| point.ring == lidar);
            let is_ego = position.truncate().abs().max_element() < options.ego_clearance_m;
            match splitter.part(global, synchronized) {
                Part::Actor { track, local } => cloud.actors.entry(track).or_default().push(candidate(local)),
                Part::Ghost => cloud.ghosts += 1,
                Part::Background if is_ego => cloud.ego += 1,
                Part::Background => cloud.background.push(candidate(global)),
            }
        }
        cloud
    }

    /// Sorts the points of each part in space, and notes the corners of its blocks.
    pub(in super::super) fn sort_in_space(&mut self) {
        self.parts_mut().for_each(|(_, points)| sort_in_space(points));
        let corners = |points: &Vec<Candidate>| {
            points.chunks(BLOCK).map(|block| Corners::of(block.iter().map(|point| point.position))).collect()
        };
        let corners: Vec<_> = self.parts().map(|(track, points)| (track, corners(points))).collect();
        self.corners = corners.into_iter().collect();
    }

    /// Returns the points of a part block by block, with the corners around each if they are known.
    pub(in super::super) fn blocks<'c>(
        &'c self,
        track: Option<usize>,
        points: &'c [Candidate],
    ) -> impl Iterator<Item = (Option<&'c Corners>, &'c [Candidate])> {
        let corners = self.corners.get(&track).map_or(&[] as &[Corners], Vec::as_slice);
        points.chunks(BLOCK).enumerate().map(|(i, block)| (corners.get(i), block))
    }

    pub(in super::super) fn parts(&self) -> impl Iterator<Item = (Option<usize>, &Vec<Candidate>)> {
        let actors = self.actors.iter().map(|(track, points)| (Some(*track), points));
        std::iter::once((None, &self.background)).chain(actors)
    }

    pub(in super::super) fn parts_mut(
        &mut self,
    ) -> impl Iterator<Item = (Option<usize>, &mut Vec<Candidate>)> {
        let actors = self.actors.iter_mut().map(|(track, points)| (Some(*track), points));
        std::iter::once((None, &mut self.background)).chain(actors)
    }

    pub(in super::super) fn make_grey(&mut self) {
        for (_, points) in self.parts_mut() {
            points.iter_mut().for_each(|p| p.rgb = Some(GREY));
        }
    }
}

/// Sorts points so that neighbors are close in every image.
fn sort_in_space(points: &mut Vec<Candidate>) {
    let Some(first) = points.first().map(|point| point.position) else { return };
    let local = |point: &Candidate| Point::new((point.position - first).as_vec3().to_array(), [0; 3], 0);
    let locals: Vec<Point> = points.iter().map(local).collect();
    if let Some(order) = Bounds::of(&locals).and_then(|bounds| morton_order(&locals, &bounds)) {
        *points = order.iter().map(|i| points[*i as usize]).collect();
    }
}

fn candidate(position: DVec3) -> Candidate {
    Candidate { position, rgb: None }
}
