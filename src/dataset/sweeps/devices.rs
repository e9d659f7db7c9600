//! Whether the numbers of a column are beams of one LiDAR or merged LiDARs, from the directions of their
//! points.
//!
//! # How it works
//! A beam of a spinning LiDAR keeps its elevation, and the beams of one LiDAR sweep the same azimuths.
//! Several LiDARs each have many beams, so their elevations overlap, and they look at different azimuths or
//! from different places. Numbers whose points have all directions in common are interleaved: they say
//! nothing about devices.
//!
//! A flag of one LiDAR (near or far, left or right, ground, echo) divides its directions. Where two LiDARs
//! look into the same directions, each of them sees what the other sees, and has as many points there as
//! elsewhere. Where a flag divides, one number lacks the points that the other has.

use std::collections::BTreeMap;

use crate::dataset::SweepPoint;

/// What the directions of points say about their numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Evidence {
    /// Certainly merged LiDARs.
    Devices,
    /// Certainly not.
    Beams,
    /// Too few points, or neither.
    Unknown,
}

/// More numbers than this, or greater ring numbers, are beams: recorded vehicles merge up to five LiDARs.
pub(super) const MAX_DEVICES: u16 = 8;
/// Points that a number needs to count.
const MIN_POINTS: u32 = 200;
/// Cells of directions: a degree of azimuth and two of elevation: cells where sparse beams still meet.
const AZIMUTHS: usize = 360;
const ELEVATIONS: usize = 90;
/// Cells of a sector, 15 degrees, for comparisons of azimuths.
const SECTOR: usize = 15;
/// Bins of half a degree of elevation.
const FINE_ELEVATIONS: usize = 360;
/// Range of elevations, degrees: a beam has less, even after motion compensation, and a LiDAR more.
const BEAM_DEGREES: f64 = 2.0;
const DEVICE_DEGREES: f64 = 5.0;
/// Share of points at other azimuths: interleaved beams have less, and two LiDARs certainly differ above.
const SAME_AZIMUTHS: f64 = 0.15;
const OTHER_AZIMUTHS: f64 = 0.5;
/// Share of one LiDAR's cells, in the sectors of the other, that the other has too. Flags in space have up to
/// half of them.
const COMMON_CELLS: f64 = 0.75;
const MIN_CELLS: u32 = 100;
/// Sectors with fewer cells than this share of the fullest one are not part of a LiDAR's view.
const SECTOR_SHARE: f64 = 0.25;
/// Points that one number lacks per point of the other in its cells: flags lack 0.4 to 1.1, LiDARs less than
/// 0.05.
const LACKING: f64 = 0.2;
/// Cells of a row that are compared with the others of the row.
const MIN_ROW_CELLS: u32 = 20;

/// Directions of the points with one number.
struct Pattern {
    points: u32,
    /// Rows of elevation, cells of azimuth.
    cells: Vec<[u32; AZIMUTHS]>,
    elevations: [u32; FINE_ELEVATIONS],
}

/// Judges the numbers of points; `number` returns the number of a point by its index.
pub(super) fn evidence(points: &[SweepPoint], number: impl Fn(usize) -> u16) -> Evidence {
    let mut patterns: BTreeMap<u16, Pattern> = BTreeMap::new();
    for (i, point) in points.iter().enumerate() {
        patterns.entry(number(i)).or_insert_with(Pattern::new).add(point.position);
        if patterns.len() > usize::from(MAX_DEVICES) {
            return Evidence::Beams;
        }
    }
    let patterns: Vec<&Pattern> = patterns.values().filter(|p| p.points >= MIN_POINTS).collect();
    if patterns.len() < 2 {
        return Evidence::Unknown;
    }
    let ranges: Vec<[f64; 2]> = patterns.iter().map(|pattern| pattern.elevation_range()).collect();
    let width = |range: &[f64; 2]| range[1] - range[0];
    let pairs = || (0..patterns.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
    let overlaps = |(i, j): (usize, usize)| {
        let shared = ranges[i][1].min(ranges[j][1]) - ranges[i][0].max(ranges[j][0]);
        shared >= 0.5 * width(&ranges[i]).min(width(&ranges[j]))
    };
    let differ = |(i, j): (usize, usize)| patterns[i].azimuth_difference(patterns[j]);
    let are_wide = ranges.iter().all(|range| width(range) >= DEVICE_DEGREES);
    if are_wide && pairs().all(overlaps) {
        let proven = |&(i, j): &(usize, usize)| {
            differ((i, j)) >= OTHER_AZIMUTHS && are_independent(patterns[i], patterns[j])
        };
        let proven: Vec<(usize, usize)> = pairs().filter(proven).collect();
        if (0..patterns.len()).all(|i| proven.iter().any(|pair| pair.0 == i || pair.1 == i)) {
            return Evidence::Devices;
        }
    }
    let are_narrow = ranges.iter().all(|range| width(range) <= BEAM_DEGREES);
    let are_interleaved = pairs().all(|pair| differ(pair) <= SAME_AZIMUTHS && overlaps(pair));
    if are_narrow || are_interleaved { Evidence::Beams } else { Evidence::Unknown }
}

/// Returns the evidence that most sweeps give; `None` for no sweeps.
pub(super) fn majority(sweeps: &[Evidence]) -> Option<Evidence> {
    let is_most = |evidence: &Evidence| 2 * sweeps.iter().filter(|e| *e == evidence).count() > sweeps.len();
    let most = [Evidence::Devices, Evidence::Beams].into_iter().find(is_most);
    (!sweeps.is_empty()).then(|| most.unwrap_or(Evidence::Unknown))
}

/// Returns whether two numbers certainly have directions of their own: both see what is in the view of both,
/// and neither lacks the points that the other has.
fn are_independent(a: &Pattern, b: &Pattern) -> bool {
    let rows = a.rows().start.max(b.rows().start)..a.rows().end.min(b.rows().end);
    let lacking: Vec<f64> =
        [(a, b), (b, a)].into_iter().filter_map(|(a, b)| a.lacking(b, rows.clone())).collect();
    a.sees(b, rows.clone())
        && b.sees(a, rows)
        && !lacking.is_empty()
        && lacking.iter().all(|lacking| *lacking <= LACKING)
}

impl Pattern {
    fn new() -> Self {
        Self { points: 0, cells: vec![[0; AZIMUTHS]; ELEVATIONS], elevations: [0; FINE_ELEVATIONS] }
    }

    fn add(&mut self, [x, y, z]: [f32; 3]) {
        let bin = |turn: f32, bins: usize| ((turn * bins as f32) as usize).min(bins - 1);
        let azimuth = y.atan2(x) / std::f32::consts::TAU + 0.5;
        let elevation = z.atan2(x.hypot(y)) / std::f32::consts::PI + 0.5;
        self.points += 1;
        self.cells[bin(elevation, ELEVATIONS)][bin(azimuth, AZIMUTHS)] += 1;
        self.elevations[bin(elevation, FINE_ELEVATIONS)] += 1;
    }

    /// Returns the elevations between which nine tenths of the points are, degrees.
    fn elevation_range(&self) -> [f64; 2] {
        let reaches = |share: f64| {
            let mut sum = 0;
            let reaches = |count: &u32| {
                sum += count;
                f64::from(sum) >= share * f64::from(self.points)
            };
            self.elevations.iter().position(reaches).unwrap_or(FINE_ELEVATIONS - 1) as f64
        };
        [0.05, 0.95].map(|share| reaches(share) * 180.0 / FINE_ELEVATIONS as f64)
    }

    /// Returns the cell rows of these elevations.
    fn rows(&self) -> std::ops::Range<usize> {
        let [low, high] = self.elevation_range().map(|degrees| degrees * ELEVATIONS as f64 / 180.0);
        low as usize..high as usize + 1
    }

    /// Returns the share of points that would have to turn to another azimuth for the patterns to be the
    /// same.
    fn azimuth_difference(&self, other: &Self) -> f64 {
        let share = |pattern: &Self, sector: usize| {
            let cells = |row: &[u32; AZIMUTHS]| row[sector..sector + SECTOR].iter().sum::<u32>();
            f64::from(pattern.cells.iter().map(cells).sum::<u32>()) / f64::from(pattern.points)
        };
        let sectors = (0..AZIMUTHS).step_by(SECTOR);
        sectors.map(|sector| (share(self, sector) - share(other, sector)).abs()).sum::<f64>() / 2.0
    }

    /// Returns whether this number has most cells of the other one in its own sectors.
    fn sees(&self, other: &Self, rows: std::ops::Range<usize>) -> bool {
        let filled = |sector: usize| {
            let cells =
                |row: usize| self.cells[row][sector..sector + SECTOR].iter().filter(|n| **n > 0).count();
            rows.clone().map(cells).sum::<usize>() as f64
        };
        let sectors: Vec<f64> = (0..AZIMUTHS).step_by(SECTOR).map(filled).collect();
        let fullest = sectors.iter().copied().fold(1.0, f64::max);
        let (mut seen, mut all) = (0, 0);
        for row in rows {
            for (azimuth, (own, other)) in self.cells[row].iter().zip(&other.cells[row]).enumerate() {
                if *other > 0 && sectors[azimuth / SECTOR] >= SECTOR_SHARE * fullest {
                    all += 1;
                    seen += u32::from(*own > 0);
                }
            }
        }
        all >= MIN_CELLS && f64::from(seen) >= COMMON_CELLS * f64::from(all)
    }

    /// Returns the mean number of points that this number lacks in cells of the other one, compared with the
    /// other cells of their row, per point of the other number; `None` if there is nothing to compare.
    fn lacking(&self, other: &Self, rows: std::ops::Range<usize>) -> Option<f64> {
        let (mut lacking, mut others) = (0.0, 0.0);
        for row in rows {
            // Number of cells and their points, without and with the other number.
            let (mut cells, mut points, mut shared) = ([0; 2], [0.0; 2], 0.0);
            for (own, other) in self.cells[row].iter().zip(&other.cells[row]).filter(|(own, _)| **own > 0) {
                let both = usize::from(*other > 0);
                cells[both] += 1;
                points[both] += f64::from(*own);
                shared += f64::from(*other);
            }
            if cells.iter().all(|cells| *cells >= MIN_ROW_CELLS) {
                lacking += points[0] / f64::from(cells[0]) * f64::from(cells[1]) - points[1];
                others += shared;
            }
        }
        (others > 0.0).then(|| lacking / others)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a direction at 20 m.
    fn at(azimuth: f64, elevation: f64) -> SweepPoint {
        let (sin, cos) = azimuth.to_radians().sin_cos();
        let position = [20.0 * cos, 20.0 * sin, 20.0 * elevation.to_radians().tan()].map(|v| v as f32);
        SweepPoint { position, ..SweepPoint::default() }
    }

    /// Returns a spinning LiDAR of many beams between two azimuths, degrees.
    fn lidar(azimuths: [f64; 2], beams: u32) -> Vec<SweepPoint> {
        let steps = 600;
        let step = (azimuths[1] - azimuths[0]) / f64::from(steps);
        let beam = |beam: u32| -20.0 + 25.0 * f64::from(beam) / f64::from(beams);
        let turn = |i: u32| (0..beams).map(move |b| at(azimuths[0] + step * f64::from(i), beam(b)));
        (0..steps).flat_map(turn).collect()
    }

    fn judge(points: &[SweepPoint], number: impl Fn(usize) -> u16) -> Evidence {
        evidence(points, number)
    }

    #[test]
    fn lidars_with_different_views_are_devices() {
        let round = lidar([-180.0, 180.0], 32);
        for others in [vec![[-30.0, 30.0]], vec![[60.0, 120.0], [-120.0, -60.0]]] {
            let mut all: Vec<(SweepPoint, u16)> = round.iter().map(|p| (*p, 0)).collect();
            for (i, side) in others.into_iter().enumerate() {
                all.extend(lidar(side, 24).into_iter().map(|p| (p, i as u16 + 1)));
            }
            let points: Vec<SweepPoint> = all.iter().map(|(point, _)| *point).collect();
            assert_eq!(judge(&points, |i| all[i].1), Evidence::Devices);
        }
    }

    #[test]
    fn interleaved_numbers_are_not_devices() {
        let round = lidar([-180.0, 180.0], 32);
        for beams in [2, 3, 4, 5, 7] {
            assert_eq!(judge(&round, |i| (i % beams) as u16), Evidence::Beams, "{beams}");
        }
    }

    #[test]
    fn numbers_that_keep_their_elevation_are_beams() {
        for beams in [2, 3, 4] {
            let few = lidar([-180.0, 180.0], beams);
            assert_eq!(judge(&few, |i| i as u16 % beams as u16), Evidence::Beams, "{beams}");
        }
        // The upper half of the beams meets houses on one side only.
        let round = lidar([-180.0, 180.0], 32);
        let points: Vec<(SweepPoint, u16)> =
            round.iter().enumerate().map(|(i, p)| (*p, (i % 32 / 8) as u16)).collect();
        let seen: Vec<(SweepPoint, u16)> =
            points.into_iter().filter(|(p, ring)| *ring < 2 || p.position[1] > 10.0).collect();
        let points: Vec<SweepPoint> = seen.iter().map(|(point, _)| *point).collect();
        assert_ne!(judge(&points, |i| seen[i].1), Evidence::Devices);
    }

    #[test]
    fn many_numbers_are_beams_and_few_points_are_no_evidence() {
        let round = lidar([-180.0, 180.0], 32);
        assert_eq!(judge(&round, |i| i as u16 % 32), Evidence::Beams);
        assert_eq!(judge(&round[..300], |i| i as u16 % 2), Evidence::Unknown);
        assert_eq!(judge(&round, |_| 1), Evidence::Unknown);
        assert_eq!(judge(&[], |_| 0), Evidence::Unknown);
    }

    /// Flags of one LiDAR between houses: near on one side of the street, far on the other.
    #[test]
    fn flags_of_one_lidar_are_not_devices() {
        let round: Vec<SweepPoint> = lidar([-180.0, 180.0], 32)
            .into_iter()
            .enumerate()
            .map(|(i, point)| {
                let range = if point.position[1] > 0.0 { 0.4 } else { 2.0 };
                let range = range * crate::hash::between(5, &[i as i64 / 400], 0.7, 1.3) as f32;
                SweepPoint { position: point.position.map(|v| v * range), ..point }
            })
            .collect();
        let azimuth = |p: &SweepPoint| p.position[1].atan2(p.position[0]);
        let random = |i: usize| crate::hash::between(7, &[i as i64], 0.0, 1.0);
        type Flag<'a> = &'a dyn Fn(usize, &SweepPoint) -> bool;
        let flags: [Flag<'_>; 7] = [
            &|_, p| p.position[0].hypot(p.position[1]) > 20.0,
            &|_, p| p.position[0] > 0.0,
            &|_, p| azimuth(p).abs() < 1.0,
            &|_, p| p.position[2] < -1.5 && p.position[1] > 0.0,
            &|i, p| p.position[0] > 0.0 && random(i) < 0.5,
            &|i, p| azimuth(p).abs() < 0.6 && random(i) < 0.25,
            &|i, p| p.position[1] > 0.0 && random(i / 8) < 0.5,
        ];
        for (k, flag) in flags.iter().enumerate() {
            let found = judge(&round, |i| u16::from(flag(i, &round[i])));
            assert_ne!(found, Evidence::Devices, "{k}");
        }
    }

    #[test]
    fn the_majority_of_sweeps_decides() {
        use Evidence::{Beams, Devices, Unknown};
        assert_eq!(majority(&[]), None);
        assert_eq!(majority(&[Devices, Unknown, Devices]), Some(Devices));
        assert_eq!(majority(&[Devices, Unknown]), Some(Unknown));
        assert_eq!(majority(&[Beams, Beams, Devices]), Some(Beams));
    }
}
