//! Placement of pedestrians and their paths.

use glam::DVec2;
use point_skeleton::geometry::Polyline;

use super::bodies::Bodies;
use super::pavement::{Kerb, Track};
use super::walker::{CrossingState, Walker, junction_of};
use crate::model::BodyKind;
use crate::plan::Network;
use crate::plan::line::polyline;
use crate::plan::random::Random;

/// Distances from the ego's route within which people walk and cross, meters.
const NEAR_M: f64 = 75.0;
const CROSS_NEAR_M: f64 = 130.0;
/// Length of track per strolling walker, meters, and their maximum number.
const SPACING_M: f64 = 46.0;
const MOST: usize = 60;
/// Maximum number of crossings with pedestrians.
const CROSSED: usize = 8;
/// Offset of crossing walkers to the right of a crossing's middle, so that opposite directions pass each
/// other, meters.
const PASS_M: f64 = 0.75;

/// Generator of pedestrians.
pub(super) struct People<'a> {
    pub(super) network: &'a Network,
    pub(super) bodies: &'a Bodies,
    pub(super) random: Random,
    /// Duration that their paths last for, seconds.
    pub(super) duration_s: f64,
}

impl People<'_> {
    /// Returns the walkers near a route.
    pub(super) fn around(&mut self, drive: &[DVec2]) -> Vec<Walker> {
        let mut tracks = Vec::new();
        let sidewalk_m = self.network.roads.first().map_or(2.5, |road| road.sidewalk_m);
        for (number, kerb) in Kerb::all(self.network).iter().enumerate() {
            tracks.extend(kerb.tracks(sidewalk_m, number));
        }
        let mut walkers = self.crossing(&tracks, drive);
        let mut strolling = Vec::new();
        for track in &tracks {
            let mut along_m = self.random.between(0.0, SPACING_M);
            while along_m < track.length_m() - 3.0 {
                let point = track.part(along_m, 0.0, 1.0)[0];
                if drive.iter().any(|p| p.distance(point) < NEAR_M) {
                    let pace_mps = self.random.between(1.0, 1.6);
                    let line = track.part(along_m, 1.0, 4.0 + pace_mps * self.duration_s);
                    strolling.extend(self.walker(polyline(&line), 1.0, pace_mps, None));
                }
                along_m += self.random.between(0.35, 1.65) * SPACING_M;
            }
        }
        self.random.shuffle(&mut strolling);
        strolling.truncate(MOST);
        walkers.extend(strolling);
        apart(walkers)
    }

    fn walker(
        &mut self,
        path: Polyline,
        along_m: f64,
        pace_mps: f64,
        crossing: Option<CrossingState>,
    ) -> Option<Walker> {
        let body = self.bodies.of(BodyKind::Walker, &mut self.random);
        let size_m = body.size_m().truncate();
        (path.length_m() > along_m).then_some(Walker {
            body,
            size_m,
            path,
            along_m,
            speed_mps: pace_mps,
            pace_mps,
            crossing,
        })
    }

    /// Returns up to three walkers for each crossing.
    fn crossing(&mut self, tracks: &[Track], drive: &[DVec2]) -> Vec<Walker> {
        let near =
            |i: &usize| drive.iter().any(|p| p.distance(self.network.crossings[*i].path[0]) < CROSS_NEAR_M);
        let mut crossings: Vec<usize> = (0..self.network.crossings.len()).filter(near).collect();
        self.random.shuffle(&mut crossings);
        crossings.truncate(CROSSED);
        let mut walkers = Vec::new();
        for crossing in crossings {
            let count = 1 + self.random.index(3);
            for _ in 0..count {
                walkers.extend(self.crosser(tracks, crossing));
            }
        }
        walkers
    }

    /// Returns a walker from a sidewalk over a crossing and onward.
    fn crosser(&mut self, tracks: &[Track], crossing: usize) -> Option<Walker> {
        let mut path = self.network.crossings[crossing].path;
        if self.random.chance(0.5) {
            path.reverse();
        }
        let across = (path[1] - path[0]).normalize_or(DVec2::X);
        let path = path.map(|p| p - across.perp() * (PASS_M + self.random.between(-0.1, 0.1)));
        let mut nearest = |point: DVec2| {
            let feet: Vec<(f64, usize)> = (0..tracks.len())
                .filter_map(|i| {
                    let (along_m, distance_m) = tracks[i].nearest(point);
                    (distance_m < 2.0).then_some((along_m, i))
                })
                .collect();
            (!feet.is_empty()).then(|| feet[self.random.index(feet.len())])
        };
        let (from_m, from) = nearest(path[0])?;
        let (to_m, to) = nearest(path[1])?;
        let pace_mps = self.random.between(1.1, 1.6);
        let before_m = self.random.between(1.5, 26.0);
        let mut points = tracks[from].part(from_m, before_m, 0.0);
        let first_m = polyline(&points).length_m();
        let start = points[points.len() - 1];
        let after = tracks[to].part(to_m, 0.0, 4.0 + pace_mps * self.duration_s);
        // Distance from the track to the kerb.
        let half_m = self.network.roads[self.network.crossings[crossing].road].half_width_m;
        let middle = (path[0] + path[1]) / 2.0;
        let off_m = first_m + (middle - start).dot(across) - half_m;
        let over = CrossingState {
            crossing,
            junction: junction_of(self.network, crossing)?,
            kerbs_m: [off_m, off_m + 2.0 * half_m],
            walks: false,
        };
        points.extend(after);
        self.walker(polyline(&points), 0.6, pace_mps, Some(over))
    }
}

/// Drops walkers that start on top of earlier ones.
fn apart(walkers: Vec<Walker>) -> Vec<Walker> {
    let mut retained: Vec<Walker> = Vec::new();
    for walker in walkers {
        let rect = walker.rect_at(walker.along_m).grown(0.3);
        if retained.iter().all(|other| !rect.overlaps(&other.rect_at(other.along_m))) {
            retained.push(walker);
        }
    }
    retained
}
