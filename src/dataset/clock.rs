//! Clocks of sensors, compared with the clock of the frames.
//!
//! Boxes exist at frames only. With data of another clock, all actors would silently become background.

use std::collections::BTreeSet;
use std::fmt;

use super::recording::notes::{Notes, note};

/// Maximum difference between a time and the one that it belongs to, microseconds.
pub(super) const TOLERANCE_US: u64 = 1_000_000;

/// Difference up to which clocks are not noted, microseconds: a rotation of a LiDAR takes 100 ms.
const NOTED_US: u64 = 120_000;

/// Plausible times from frame to frame, microseconds.
const INTERVALS_US: std::ops::RangeInclusive<i64> = 2_000..=100_000_000;

/// Units of time, each a thousandth of the one before.
const UNITS: [&str; 4] = ["seconds", "milliseconds", "microseconds", "nanoseconds"];

/// Unit of the times in the files of a format: an index in [`UNITS`]. All functions here take times in
/// microseconds, to which the reader has converted them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Unit(usize);

impl Unit {
    pub(super) const MICROS: Self = Self(2);
    pub(super) const NANOS: Self = Self(3);

    /// Returns ` (UNIT instead of UNIT?)` if a file's time is one of the years 1980 to 2100 in another unit;
    /// otherwise nothing. Clocks of GPS may begin in 1980.
    pub(super) fn hint(self, t_us: f64) -> String {
        const SECONDS: std::ops::RangeInclusive<f64> = 3.15e8..=4.2e9;
        let in_file = t_us * thousands(self.0 as i32 - 2);
        let unit = (0..UNITS.len()).find(|unit| SECONDS.contains(&(in_file / thousands(*unit as i32))));
        let other = unit.filter(|unit| *unit != self.0);
        other.map_or_else(String::new, |unit| format!(" ({})", self.instead(unit)))
    }

    /// Returns the unit of times that are a fraction of those in this unit, if it is another one.
    fn of_fraction(self, ratio: f64) -> Option<String> {
        let is = |unit: &usize| (ratio / thousands(self.0 as i32 - *unit as i32) - 1.0).abs() < 1e-3;
        let other = (0..UNITS.len()).find(is).filter(|unit| *unit != self.0);
        other.map(|unit| self.instead(unit))
    }

    fn instead(self, unit: usize) -> String {
        format!("{} instead of {}?", UNITS[unit], UNITS[self.0])
    }
}

/// Returns a power of a thousand.
fn thousands(power: i32) -> f64 {
    1000_f64.powi(power)
}

/// Time that is farther than [`TOLERANCE_US`] from the one that it belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Offset {
    t_us: i64,
    expected_us: i64,
    /// Range of the clock's offset, if the times are a part of the others.
    range_us: [u64; 2],
    unit: Unit,
}

impl Offset {
    /// Compares a time with the one that it belongs to, in microseconds; `None` within the tolerance.
    pub(super) fn of(t_us: i64, expected_us: i64) -> Option<Self> {
        Self::beyond(t_us, expected_us, TOLERANCE_US)
    }

    /// Compares a time with the one that it belongs to, in microseconds; `None` within a tolerance.
    fn beyond(t_us: i64, expected_us: i64, tolerance_us: u64) -> Option<Self> {
        let range_us = [t_us.abs_diff(expected_us); 2];
        (range_us[0] > tolerance_us).then_some(Self { t_us, expected_us, range_us, unit: Unit::MICROS })
    }

    /// Compares ascending times with the first and last of a span. Returns the offset of the first time from
    /// the first of the span, if no time is within the span or the tolerance. Times on both sides of the span
    /// are of its clock.
    pub(super) fn of_all(
        times_us: impl Iterator<Item = i64>,
        [first, last]: [i64; 2],
        unit: Unit,
    ) -> Option<Self> {
        let mut ends = None;
        for t_us in times_us {
            if t_us.abs_diff(t_us.clamp(first, last.max(first))) <= TOLERANCE_US {
                return None;
            }
            ends.get_or_insert([t_us; 2])[1] = t_us;
        }
        let [t_us, end_us] = ends?;
        if t_us < first && end_us > last {
            return None;
        }
        let mut range_us = [t_us.abs_diff(first), end_us.abs_diff(last)];
        range_us.sort_unstable();
        Some(Self { t_us, expected_us: first, range_us, unit })
    }

    fn distance(&self) -> u64 {
        self.t_us.abs_diff(self.expected_us)
    }

    /// Names the probable cause, if there is one.
    fn cause(&self) -> Option<String> {
        if let Some(unit) = self.unit.of_fraction(self.expected_us as f64 / self.t_us as f64) {
            return Some(unit);
        }
        const HALF_HOUR_S: f64 = 1800.0;
        let [least, most] = self.range_us.map(|t_us| t_us as f64 * 1e-6);
        let half_hours = ((least - 5.0) / HALF_HOUR_S).ceil();
        if (1.0..=28.0).contains(&half_hours)
            && half_hours * HALF_HOUR_S <= most + 5.0
            && most - least < HALF_HOUR_S / 2.0
        {
            return Some(format!("{} h, another time zone?", half_hours / 2.0));
        }
        // UTC has 37 leap seconds, GPS time started with 19 of them.
        let is_near = |leap: &f64| (least - 0.5..=most + 0.5).contains(leap) && most - least < 1.0;
        let is_leap = [18.0, 19.0, 37.0].iter().any(is_near);
        is_leap.then(|| "GPS time instead of UTC?".to_owned())
    }
}

/// Formats like `3600.000 s later (1 h, another time zone?)`.
impl fmt::Display for Offset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let side = if self.t_us > self.expected_us { "later" } else { "earlier" };
        write!(f, "{:.3} s {side}", self.distance() as f64 * 1e-6)?;
        self.cause().map_or(Ok(()), |cause| write!(f, " ({cause})"))
    }
}

/// Ego poses whose time differs from the time of the data that refer to them.
#[derive(Debug, Default)]
pub(super) struct PoseTimes {
    count: usize,
    sensors: BTreeSet<String>,
    /// Token and offset of the first one.
    first: Option<(String, Offset)>,
}

impl PoseTimes {
    /// Compares the time of a pose with the time of its data, in microseconds. `names` returns the sensor,
    /// and the token of the pose.
    pub(super) fn compare(&mut self, pose_us: i64, data_us: i64, names: impl FnOnce() -> [String; 2]) {
        if let Some(offset) = Offset::beyond(pose_us, data_us, NOTED_US) {
            let [sensor, token] = names();
            self.count += 1;
            self.sensors.insert(sensor);
            self.first.get_or_insert((token, offset));
        }
    }

    /// Adds a note with the first of them.
    pub(super) fn note(self, notes: &mut Notes) {
        if let Some((token, offset)) = self.first {
            let sensors = self.sensors.into_iter().collect::<Vec<_>>().join(", ");
            let text = format!(
                "ego poses of another time than their data of {sensors} (used; ego_pose {token} is {offset})"
            );
            note(notes, &text, self.count);
        }
    }
}

/// Times of key frames relative to their frames, by sensor. Only nuScenes links them; where they are found by
/// time, they are near it.
#[derive(Debug, Default)]
pub(super) struct KeyTimes(std::collections::BTreeMap<String, Vec<[i64; 2]>>);

impl KeyTimes {
    /// Adds a key frame of a sensor and the time of its frame, microseconds.
    pub(super) fn add(&mut self, sensor: &str, t_us: i64, frame_us: i64) {
        match self.0.get_mut(sensor) {
            Some(times) => times.push([t_us, frame_us]),
            None => _ = self.0.insert(sensor.to_owned(), vec![[t_us, frame_us]]),
        }
    }

    /// Adds a note for each sensor whose median difference is noteworthy.
    pub(super) fn note(self, notes: &mut Notes) {
        for (sensor, mut times) in self.0 {
            let count = times.len();
            let (_, [t_us, frame_us], _) =
                times.select_nth_unstable_by_key(count / 2, |[t_us, frame_us]| t_us - frame_us);
            if let Some(offset) = Offset::beyond(*t_us, *frame_us, NOTED_US) {
                let text = format!(
                    "key frames of {sensor} of another time than their boxes (used; median {offset})"
                );
                note(notes, &text, count);
            }
        }
    }
}

/// Adds a note if frames are too close or too far apart for times in a unit.
pub(super) fn note_interval(times_us: &[i64], unit: Unit, notes: &mut Notes) {
    let mut gaps: Vec<i64> = times_us.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).collect();
    gaps.sort_unstable();
    let Some(median) = gaps.get(gaps.len() / 2).filter(|gap| !INTERVALS_US.contains(gap)) else { return };
    let seconds = *median as f64 / 1e6;
    let hint = times_us.first().map_or_else(String::new, |first| unit.hint(*first as f64));
    let hint = if hint.is_empty() { format!(" (are their times {}?)", UNITS[unit.0]) } else { hint };
    note(notes, &format!("frames {seconds} s apart{hint}"), times_us.len());
}

#[cfg(test)]
mod tests {
    use super::*;

    const T_US: i64 = 1_557_539_956_493_730;

    #[test]
    fn differences_up_to_a_second_are_ignored() {
        for t_us in [T_US, T_US + 20_000, T_US - 1_000_000, T_US + 1_000_000] {
            assert_eq!(Offset::of(t_us, T_US), None);
        }
    }

    #[test]
    fn offsets_name_their_probable_cause() {
        let text = |t_us: i64| Offset::of(t_us, T_US).unwrap().to_string();
        for (t_us, part) in [
            (T_US + 3_600_000_000, "3600.000 s later (1 h, another time zone?)"),
            (T_US - 3_600_000_000 + 20_000, "3599.980 s earlier (1 h, another time zone?)"),
            (T_US + 19_800_000_000, "(5.5 h, another time zone?)"),
            (T_US / 1000, "(milliseconds instead"),
            (T_US / 1_000_000, "(seconds instead"),
            (T_US * 1000, "(nanoseconds instead"),
            (T_US + 18_000_000, "18.000 s later (GPS time"),
        ] {
            assert!(text(t_us).contains(part), "{} without {part}", text(t_us));
        }
        assert_eq!(text(T_US + 2_500_000), "2.500 s later");
        assert!(Offset::of(i64::MAX, i64::MIN).unwrap().to_string().contains("later"));
        assert!(Offset::of(0, T_US).unwrap().to_string().ends_with("earlier"));
    }

    #[test]
    fn a_clock_is_wrong_if_no_time_is_near() {
        let span = [T_US, T_US + 5_000_000];
        let of = |times: &[i64]| Offset::of_all(times.iter().copied(), span, Unit::MICROS);
        for t_us in [T_US - 1_000_000, T_US + 2_500_000, T_US + 6_000_000] {
            assert_eq!(of(&[T_US - 9_000_000, t_us]), None);
        }
        assert!(of(&[T_US + 6_000_001]).is_some());
        assert_eq!(of(&[]), None);
        assert_eq!(of(&[T_US - 2_000_000, T_US + 7_000_000]), None);
        assert!(of(&[T_US - 3_000_000, T_US - 2_000_000]).is_some());
        // The first is compared with the first: the offset of the clocks, whatever the length of the log.
        let text = |times: [i64; 2]| of(&times.map(|t_us| T_US + t_us)).unwrap().to_string();
        assert_eq!(text([18_000_000, 23_000_000]), "18.000 s later (GPS time instead of UTC?)");
        assert_eq!(text([18_000_000, 19_000_000]), "18.000 s later");
        // Two of its files, from anywhere in the log.
        assert_eq!(text([3_604_000_000, 3_604_100_000]), "3604.000 s later (1 h, another time zone?)");
    }

    #[test]
    fn units_follow_the_format() {
        let nanos = |t_us: i64| {
            let span = [T_US, T_US + 5_000_000];
            Offset::of_all([t_us].into_iter(), span, Unit::NANOS).unwrap().to_string()
        };
        for (t_us, unit) in [
            (T_US / 1000, "microseconds"),
            (T_US / 1_000_000, "milliseconds"),
            (T_US / 1_000_000_000, "seconds"),
        ] {
            let cause = format!("({unit} instead of nanoseconds?)");
            assert!(nanos(t_us).ends_with(&cause), "{}", nanos(t_us));
            assert_eq!(Unit::NANOS.hint(t_us as f64), format!(" {cause}"));
        }
        assert_eq!(Unit::MICROS.hint(T_US as f64), "");
        assert_eq!(Unit::MICROS.hint(T_US as f64 / 1e6), " (seconds instead of microseconds?)");
        assert_eq!(Unit::MICROS.hint(T_US as f64 * 1e3), " (nanoseconds instead of microseconds?)");
        assert_eq!((Unit::MICROS.hint(0.0), Unit::NANOS.hint(1.0)), (String::new(), String::new()));
    }

    #[test]
    fn a_median_beyond_a_rotation_is_noted() {
        let noted = |offsets: &[i64]| {
            let (mut times, mut notes) = (KeyTimes::default(), Notes::new());
            offsets.iter().for_each(|offset| times.add("LIDAR_TOP", T_US + offset, T_US));
            times.note(&mut notes);
            notes.counts.into_iter().collect::<Vec<_>>()
        };
        let note = "key frames of LIDAR_TOP of another time than their boxes (used; median 0.400 s earlier)";
        assert_eq!(noted(&[-400_000; 3]), [(note.to_owned(), 3)]);
        assert_eq!(noted(&[-100_000; 4]), []);
        assert_eq!(noted(&[0, 900_000, 0]), []);
    }

    #[test]
    fn intervals_of_other_units_are_noted() {
        let count = |step: i64| {
            let mut notes = Notes::new();
            note_interval(&(0..5).map(|i| i * step).collect::<Vec<_>>(), Unit::MICROS, &mut notes);
            notes.counts
        };
        assert!(count(50_000).is_empty() && count(500_000).is_empty());
        assert_eq!(
            count(500).into_iter().collect::<Vec<_>>(),
            [("frames 0.0005 s apart (are their times microseconds?)".to_owned(), 5)]
        );
        assert_eq!(count(500_000_000).len(), 1);
        note_interval(&[7], Unit::MICROS, &mut Notes::new());
        let mut notes = Notes::new();
        note_interval(&[T_US / 1000, T_US / 1000 + 200], Unit::MICROS, &mut notes);
        let text = "frames 0.0002 s apart (milliseconds instead of microseconds?)";
        assert_eq!(notes.counts.into_iter().collect::<Vec<_>>(), [(text.to_owned(), 2)]);
    }
}
