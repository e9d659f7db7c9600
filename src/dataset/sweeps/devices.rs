//! Whether the numbers of a column are beams of one LiDAR or merged LiDARs, from the directions of their points.
//!
//! # How it works
//! A beam of a spinning LiDAR keeps its elevation, and the beams of one LiDAR sweep the same azimuths. Several LiDARs
//! each have many beams, so their elevations overlap, and they look at different azimuths or from different places.
//! Numbers whose points have all directions in common are interleaved: they say nothing about devices.

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

/// More numbers than this are beams: recorded vehicles merge up to five LiDARs.
const MOST_DEVICES: usize = 8;
/// Points that a number needs to count, and the number of points at which a sample is large enough.
const MIN_POINTS: u32 = 200;
const SAMPLE: usize = 20_000;
/// Bins of directions: 15 degrees of azimuth, half a degree of elevation.
const AZIMUTHS: usize = 24;
const ELEVATIONS: usize = 360;
/// Range of elevations, degrees: a beam has less, even after motion compensation, and a LiDAR more.
const BEAM_DEGREES: f64 = 2.0;
const DEVICE_DEGREES: f64 = 5.0;
/// Share of points at other azimuths: interleaved beams have less, and two LiDARs certainly differ above.
const SAME_AZIMUTHS: f64 = 0.15;
const OTHER_AZIMUTHS: f64 = 0.5;

/// Directions of the points of one number.
struct Pattern {
    points: u32,
    azimuths: [u32; AZIMUTHS],
    elevations: [u32; ELEVATIONS],
}

/// Judges the numbers of points; `number` returns that of a point by its index.
pub(super) fn evidence(points: &[SweepPoint], number: impl Fn(usize) -> u16) -> Evidence {
    let mut patterns: BTreeMap<u16, Pattern> = BTreeMap::new();
    for (i, point) in points.iter().enumerate() {
        if !is_sampled(i, points.len()) {
            continue;
        }
        let pattern = patterns.entry(number(i)).or_insert_with(|| Pattern {
            points: 0,
            azimuths: [0; AZIMUTHS],
            elevations: [0; ELEVATIONS],
        });
        pattern.add(point.position);
        if patterns.len() > MOST_DEVICES {
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
    if are_wide && pairs().all(overlaps) && pairs().any(|pair| differ(pair) >= OTHER_AZIMUTHS) {
        return Evidence::Devices;
    }
    let are_narrow = ranges.iter().all(|range| width(range) <= BEAM_DEGREES);
    let are_interleaved = pairs().all(|pair| differ(pair) <= SAME_AZIMUTHS && overlaps(pair));
    if are_narrow || are_interleaved { Evidence::Beams } else { Evidence::Unknown }
}

/// Returns whether a point is in the sample. Scattered indices cannot be in step with the order of beams.
fn is_sampled(index: usize, points: usize) -> bool {
    let scattered = (index as u32).wrapping_mul(0x9E37_79B9);
    u64::from(scattered) * points as u64 <= (SAMPLE as u64) << 32
}

impl Pattern {
    fn add(&mut self, [x, y, z]: [f32; 3]) {
        let bin = |turn: f32, bins: usize| ((turn * bins as f32) as usize).min(bins - 1);
        let azimuth = y.atan2(x) / std::f32::consts::TAU + 0.5;
        let elevation = z.atan2(x.hypot(y)) / std::f32::consts::PI + 0.5;
        self.points += 1;
        self.azimuths[bin(azimuth, AZIMUTHS)] += 1;
        self.elevations[bin(elevation, ELEVATIONS)] += 1;
    }

    /// Returns the elevations between which nine tenths of the points are, degrees.
    fn elevation_range(&self) -> [f64; 2] {
        let reaches = |share: f64| {
            let mut sum = 0;
            let reaches = |count: &u32| {
                sum += count;
                f64::from(sum) >= share * f64::from(self.points)
            };
            self.elevations.iter().position(reaches).unwrap_or(ELEVATIONS - 1) as f64
        };
        [0.05, 0.95].map(|share| reaches(share) * 180.0 / ELEVATIONS as f64)
    }

    /// Returns the share of points that would have to turn to another azimuth for the patterns to be the same.
    fn azimuth_difference(&self, other: &Self) -> f64 {
        let share = |pattern: &Self, i: usize| f64::from(pattern.azimuths[i]) / f64::from(pattern.points);
        (0..AZIMUTHS).map(|i| (share(self, i) - share(other, i)).abs()).sum::<f64>() / 2.0
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
    fn lidars_that_look_elsewhere_are_devices() {
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
    fn interleaved_numbers_are_no_devices() {
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
    fn many_numbers_are_beams_and_few_points_say_nothing() {
        let round = lidar([-180.0, 180.0], 32);
        assert_eq!(judge(&round, |i| i as u16 % 32), Evidence::Beams);
        assert_eq!(judge(&round[..300], |i| i as u16 % 2), Evidence::Unknown);
        assert_eq!(judge(&round, |_| 1), Evidence::Unknown);
        assert_eq!(judge(&[], |_| 0), Evidence::Unknown);
    }

    /// Numbers in step with any order are all in the sample.
    #[test]
    fn samples_are_not_in_step_with_beams() {
        let points = 170_000;
        for period in 2..40 {
            let mut counts = vec![0_usize; period];
            (0..points).filter(|i| is_sampled(*i, points)).for_each(|i| counts[i % period] += 1);
            let expected = SAMPLE / period;
            assert!(counts.iter().all(|n| n.abs_diff(expected) < expected / 4 + 20), "{period}: {counts:?}");
        }
    }
}
