//! Points of a sweep, row by row.

use std::path::Path;

use super::devices::{Evidence, MAX_DEVICES, evidence};
use crate::dataset::recording::notes::count;
use crate::dataset::{RingMeaning, Sweep, SweepPoint};
use crate::error::FileError;
use crate::geometry::Pose;

/// Notes on values of columns that are only informative.
const INTENSITIES: &str = "points whose intensity is not finite (read as 0)";
const RINGS: &str = "points whose ring is not a whole number from 0 on (read as 0)";
const DEVICES: &str = "points whose lidar_info is not a whole number from 0 on (read as 0)";
/// Notes on what the numbers of a sweep mean.
const FEW_RINGS: &str =
    "sweeps with few ring numbers, read as beams (--ring-is device if they number merged LiDARs)";
const BEAMS: &str = "sweeps whose lidar_info numbers beams instead of LiDARs";
const MERGED: &str = "sweeps of merged LiDARs (--ring-is beam if not)";
const SOURCES: &str = "sweeps of merged LiDARs, as their files say";

/// Values of a point as stored. `device` is the LiDAR of a merged sweep, if the file has a column that says
/// so.
#[derive(Clone, Copy, Debug)]
pub(in crate::dataset) struct SweepRow {
    pub(in crate::dataset) position: [f32; 3],
    pub(in crate::dataset) intensity: f32,
    pub(in crate::dataset) ring: f64,
    pub(in crate::dataset) device: Option<f64>,
}

/// Sweep being read. A point whose coordinates are finite is retained, whatever its other values are.
#[derive(Debug, Default)]
pub(in crate::dataset) struct SweepRows {
    sweep: Sweep,
    /// Device of each point, if the file has such a column.
    devices: Vec<u16>,
    /// Whether the devices are certain.
    are_sources: bool,
    /// Maps points to the frame of the LiDAR, if they are in another one.
    lidar_from_points: Option<Pose>,
    intensities: usize,
    rings: usize,
    wrong_devices: usize,
}

impl SweepRows {
    /// Creates a sweep with room for a number of points.
    pub(in crate::dataset) fn with_capacity(points: usize) -> Self {
        let sweep = Sweep { points: Vec::with_capacity(points), ..Sweep::default() };
        Self { sweep, ..Self::default() }
    }

    /// Adds a row.
    pub(in crate::dataset) fn push(&mut self, row: SweepRow) {
        let SweepRow { position, intensity, ring, device } = row;
        if !position.iter().all(|v| v.is_finite()) {
            self.sweep.dropped_non_finite += 1;
            return;
        }
        self.intensities += usize::from(!intensity.is_finite());
        let intensity = if intensity.is_finite() { intensity } else { 0.0 };
        let number = whole(ring);
        self.rings += usize::from(number.is_none());
        self.sweep.points.push(SweepPoint { position, intensity, ring: number.unwrap_or(0) });
        if let Some(device) = device.map(whole) {
            self.wrong_devices += usize::from(device.is_none());
            self.devices.push(device.unwrap_or(0));
        }
    }

    /// Adds a row of a LiDAR that is known for certain, whatever the columns say.
    pub(in crate::dataset) fn push_of(&mut self, row: SweepRow, source: Option<u16>) {
        self.are_sources |= source.is_some();
        let device = source.map(f64::from).or(row.device);
        self.push(SweepRow { device, ..row });
    }

    /// Sets the mounting pose of the LiDAR, if points are in the ego frame: directions are judged as the
    /// LiDAR saw them.
    #[cfg(feature = "123d")]
    pub(in crate::dataset) fn set_mount(&mut self, ego_from_lidar: &Pose) {
        self.lidar_from_points = Some(ego_from_lidar.inverse());
    }

    /// Adds a note about the sweep.
    pub(in crate::dataset) fn note(&mut self, kind: &str) {
        count(&mut self.sweep.notes, kind, 1);
    }

    /// Returns whether the points' numbers may be LiDAR numbers, which their directions decide.
    pub(super) fn may_be_merged(&self) -> bool {
        !self.are_sources && (self.has_devices() || may_be_devices(&self.sweep.points))
    }

    /// Returns what the directions of the points say about their numbers; `None` if no number can belong to a
    /// LiDAR.
    pub(super) fn evidence(&self) -> Option<Evidence> {
        if !self.may_be_merged() {
            return None;
        }
        let from_lidar = self.lidar_from_points.map(|pose| {
            let seen = |point: &SweepPoint| {
                let position = pose.transform_point(point.position.map(f64::from).into());
                SweepPoint { position: position.to_array().map(|value| value as f32), ..*point }
            };
            self.sweep.points.iter().map(seen).collect::<Vec<_>>()
        });
        let points = from_lidar.as_deref().unwrap_or(&self.sweep.points);
        Some(match self.has_devices() {
            true => evidence(points, |i| self.devices[i]),
            false => evidence(points, |i| points[i].ring),
        })
    }

    /// Returns whether a column of the file numbers several LiDARs.
    fn has_devices(&self) -> bool {
        self.devices.windows(2).any(|pair| pair[0] != pair[1])
    }

    /// Returns the sweep with the meaning of its ring column, judged from its own points; `path` is for
    /// messages.
    ///
    /// # Errors
    /// Fails as [`SweepRows::finish_as`].
    pub(in crate::dataset) fn finish(self, meaning: RingMeaning, path: &Path) -> Result<Sweep, FileError> {
        let found = if meaning == RingMeaning::Auto { self.evidence() } else { None };
        self.finish_as(meaning, found, path)
    }

    /// Returns the sweep with the meaning of its ring column. `found` decides what [`RingMeaning::Auto`]
    /// means.
    ///
    /// # Errors
    /// Fails if no point has finite coordinates, or all are at the origin.
    pub(super) fn finish_as(
        self,
        meaning: RingMeaning,
        found: Option<Evidence>,
        path: &Path,
    ) -> Result<Sweep, FileError> {
        self.check_points(path)?;
        let has_devices = self.has_devices();
        let Self { mut sweep, devices, are_sources, intensities, rings, wrong_devices, .. } = self;
        count(&mut sweep.notes, INTENSITIES, intensities);
        count(&mut sweep.notes, RINGS, rings);
        count(&mut sweep.notes, DEVICES, wrong_devices);
        sweep.devices = match (meaning, found) {
            (RingMeaning::Device, _) => true,
            (RingMeaning::Auto, _) if are_sources => has_devices,
            (RingMeaning::Beam, _) | (RingMeaning::Auto, None) => false,
            // The name of the column says that it numbers LiDARs, unless its values contradict.
            (RingMeaning::Auto, Some(found)) if has_devices => found != Evidence::Beams,
            (RingMeaning::Auto, Some(found)) => found == Evidence::Devices,
        };
        if meaning == RingMeaning::Auto && are_sources {
            count(&mut sweep.notes, SOURCES, usize::from(has_devices));
        } else if meaning == RingMeaning::Auto && found.is_some() {
            let note = match (sweep.devices, has_devices) {
                (true, _) => MERGED,
                (false, true) => BEAMS,
                (false, false) => FEW_RINGS,
            };
            count(&mut sweep.notes, note, 1);
        }
        if sweep.devices && has_devices {
            sweep.points.iter_mut().zip(&devices).for_each(|(point, device)| point.ring = *device);
        }
        Ok(sweep)
    }

    /// Checks that there is a point that may be a return.
    fn check_points(&self, path: &Path) -> Result<(), FileError> {
        let (points, dropped) = (&self.sweep.points, self.sweep.dropped_non_finite);
        if points.is_empty() {
            let found = format!("none in {dropped} rows");
            return Err(FileError::content("points with finite coordinates", found, path));
        }
        if points.iter().all(|point| point.position == [0.0; 3]) {
            let found = format!("{} points at the origin (a download that was cut off?)", points.len());
            return Err(FileError::content("points around the LiDAR", found, path));
        }
        Ok(())
    }
}

/// Returns a number of a beam or a LiDAR; `None` for other values. Clamped to `u16`.
fn whole(value: f64) -> Option<u16> {
    (value >= 0.0 && value.is_finite() && value.fract() == 0.0).then_some(value as u16)
}

/// Returns whether there are several ring numbers, all small.
fn may_be_devices(points: &[SweepPoint]) -> bool {
    let Some(first) = points.first().map(|point| point.ring) else { return false };
    points.iter().all(|point| point.ring < MAX_DEVICES) && points.iter().any(|point| point.ring != first)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn finished(rows: SweepRows, meaning: RingMeaning) -> Sweep {
        rows.finish(meaning, Path::new("a.pcd")).unwrap()
    }

    fn sweep(rows: &[([f32; 3], f32, f64, Option<f64>)]) -> Sweep {
        let mut sweep = SweepRows::with_capacity(rows.len());
        for &(position, intensity, ring, device) in rows {
            sweep.push(SweepRow { position, intensity, ring, device });
        }
        finished(sweep, RingMeaning::Auto)
    }

    #[test]
    fn points_with_finite_coordinates_are_retained() {
        let at = [1.0, 2.0, 3.0];
        let (nan, inf) = (f64::NAN, f64::INFINITY);
        let sweep = sweep(&[
            (at, 4.0, 5.0, None),
            (at, f32::NAN, 5.0, None),
            (at, f32::NEG_INFINITY, 5.0, None),
            (at, 4.0, nan, None),
            (at, 4.0, inf, None),
            (at, 4.0, -1.0, None),
            (at, 4.0, 2.5, None),
            (at, 4.0, 1e9, None),
            ([1.0, f32::NAN, 3.0], 4.0, 5.0, None),
            ([f32::INFINITY, 2.0, 3.0], 4.0, 5.0, None),
        ]);
        let values: Vec<_> = sweep.points.iter().map(|p| (p.intensity, p.ring)).collect();
        let whole = [(4.0, 5), (0.0, 5), (0.0, 5)];
        let others = [(4.0, 0), (4.0, 0), (4.0, 0), (4.0, 0), (4.0, u16::MAX)];
        assert_eq!(values, [&whole[..], &others].concat());
        assert_eq!(sweep.dropped_non_finite, 2);
        // Infinity has no fraction, but it is no number of a beam either.
        assert_eq!((sweep.notes[INTENSITIES], sweep.notes[RINGS]), (2, 4));
    }

    #[test]
    fn wrong_numbers_of_lidars_are_counted() {
        let at = [1.0, 2.0, 3.0];
        for wrong in [f64::NAN, f64::INFINITY, -1.0, 0.5] {
            let sweep = sweep(&[(at, 4.0, 5.0, Some(wrong)), (at, 4.0, 6.0, Some(0.0))]);
            let rings: Vec<u16> = sweep.points.iter().map(|point| point.ring).collect();
            assert_eq!((sweep.devices, rings, sweep.notes[DEVICES]), (false, vec![5, 6], 1), "{wrong}");
        }
        assert!(sweep(&[(at, 4.0, 5.0, Some(4.0))]).notes.is_empty());
    }

    /// LiDARs of few beams are not told from merged LiDARs by their numbers, up to the most that are merged.
    #[test]
    fn few_beams_are_noted() {
        for beams in 2..=MAX_DEVICES + 1 {
            let mut rows = SweepRows::default();
            for i in 0..beams * 400 {
                let (beam, turn) =
                    (f32::from(i % beams), f32::from(i / beams) * std::f32::consts::TAU / 400.0);
                let position = [20.0 * turn.cos(), 20.0 * turn.sin(), beam - 4.0];
                rows.push(SweepRow { position, intensity: 0.0, ring: beam.into(), device: None });
            }
            let sweep = finished(rows, RingMeaning::Auto);
            let rings = sweep.points.iter().enumerate().all(|(i, p)| p.ring == i as u16 % beams);
            let notes: Vec<&str> = sweep.notes.keys().map(String::as_str).collect();
            let expected = if beams <= MAX_DEVICES { vec![FEW_RINGS] } else { Vec::new() };
            assert_eq!((sweep.devices, rings, notes), (false, true, expected), "{beams}");
        }
    }

    #[test]
    fn an_option_decides_the_meaning_of_rings() {
        let devices = |meaning| {
            let mut rows = SweepRows::default();
            for ring in [0.0, 1.0, 1.0] {
                rows.push(SweepRow { position: [ring as f32; 3], intensity: 0.0, ring, device: None });
            }
            let sweep = finished(rows, meaning);
            (sweep.devices, sweep.notes.len())
        };
        assert_eq!(devices(RingMeaning::Auto), (false, 1));
        assert_eq!(devices(RingMeaning::Device), (true, 0));
        assert_eq!(devices(RingMeaning::Beam), (false, 0));
    }

    #[test]
    fn a_constant_number_is_one_lidar() {
        for ring in [0.0, 1.0, 2.0, 3.0, 255.0] {
            let sweep = sweep(&[([1.0; 3], 0.0, ring, None), ([2.0; 3], 0.0, ring, None)]);
            assert!(!sweep.devices && sweep.notes.is_empty());
        }
        let sweep = sweep(&[([1.0; 3], 0.0, 7.0, Some(3.0)), ([2.0; 3], 0.0, 8.0, Some(3.0))]);
        assert_eq!((sweep.devices, sweep.points[0].ring, sweep.points[1].ring), (false, 7, 8));
    }

    #[test]
    fn rejects_sweeps_without_returns() {
        let refused = |position: [f32; 3]| {
            let mut rows = SweepRows::default();
            (0..3).for_each(|_| {
                rows.push(SweepRow { position, intensity: 0.0, ring: 1.0, device: None });
            });
            rows.finish(RingMeaning::Auto, Path::new("a.pcd")).unwrap_err().to_string()
        };
        let message = refused([1.0, f32::NAN, 0.0]);
        assert_eq!(message, "expected points with finite coordinates, found none in 3 rows: a.pcd");
        let message = refused([0.0, -0.0, 0.0]);
        assert!(message.contains("points around the LiDAR, found 3 points at the origin"), "{message}");
    }
}
