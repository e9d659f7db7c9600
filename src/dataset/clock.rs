//! Clocks of sensors, compared with the clock of the frames.
//!
//! Boxes exist at frames only. With data of another clock, all actors would silently become background.

use std::fmt;

use crate::dataset::notes::{Notes, note};

/// Maximum difference between a time and the one that it belongs to, microseconds.
pub(super) const TOLERANCE_US: u64 = 1_000_000;

/// Plausible times from frame to frame, microseconds.
const INTERVALS_US: std::ops::RangeInclusive<i64> = 2_000..=100_000_000;

/// Time that is farther than [`TOLERANCE_US`] from the one that it belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Offset {
    t_us: i64,
    expected_us: i64,
}

impl Offset {
    /// Compares a time with the one that it belongs to, in microseconds; `None` within the tolerance.
    pub(super) fn of(t_us: i64, expected_us: i64) -> Option<Self> {
        (t_us.abs_diff(expected_us) > TOLERANCE_US).then_some(Self { t_us, expected_us })
    }

    /// Compares a time with the first and last of a span; `None` within the span or the tolerance.
    pub(super) fn from_span(t_us: i64, [first, last]: [i64; 2]) -> Option<Self> {
        Self::of(t_us, t_us.clamp(first, last.max(first)))
    }

    /// Compares times in ascending order with a span. Returns the index of the time that is nearest to it, if none is
    /// within the tolerance.
    #[cfg(any(feature = "nuplan", feature = "av2"))]
    pub(super) fn of_all(times_us: impl Iterator<Item = i64>, span: [i64; 2]) -> Option<(usize, Self)> {
        let mut nearest: Option<(usize, Self)> = None;
        for (i, t_us) in times_us.enumerate() {
            let offset = Self::from_span(t_us, span)?;
            if nearest.is_none_or(|(_, other)| offset.distance() < other.distance()) {
                nearest = Some((i, offset));
            }
        }
        nearest
    }

    fn distance(&self) -> u64 {
        self.t_us.abs_diff(self.expected_us)
    }

    /// Names the probable cause, if there is one.
    fn cause(&self) -> Option<String> {
        let ratio = self.expected_us as f64 / self.t_us as f64;
        let unit = [(1e3, "milliseconds"), (1e6, "seconds"), (1e-3, "nanoseconds")];
        if let Some((_, name)) = unit.iter().find(|(unit, _)| (ratio / unit - 1.0).abs() < 1e-3) {
            return Some(format!("{name} instead of microseconds?"));
        }
        const HALF_HOUR_S: f64 = 1800.0;
        let seconds = self.distance() as f64 * 1e-6;
        let half_hours = (seconds / HALF_HOUR_S).round();
        if (1.0..=28.0).contains(&half_hours) && (seconds - half_hours * HALF_HOUR_S).abs() < 5.0 {
            return Some(format!("{} h, another time zone?", half_hours / 2.0));
        }
        // UTC has 37 leap seconds, GPS time started with 19 of them.
        let leaps = [18.0, 19.0, 37.0];
        leaps.iter().any(|leap| (seconds - leap).abs() < 0.5).then(|| "GPS time instead of UTC?".to_owned())
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
#[cfg(any(feature = "nuscenes", feature = "nuplan"))]
#[derive(Debug, Default)]
pub(super) struct PoseTimes {
    count: usize,
    /// Token and offset of the first one.
    first: Option<(String, Offset)>,
}

#[cfg(any(feature = "nuscenes", feature = "nuplan"))]
impl PoseTimes {
    /// Compares the time of a pose with the time of its data, in microseconds.
    pub(super) fn compare(&mut self, pose_us: i64, data_us: i64, token: impl FnOnce() -> String) {
        if let Some(offset) = Offset::of(pose_us, data_us) {
            self.count += 1;
            self.first.get_or_insert_with(|| (token(), offset));
        }
    }

    /// Adds a note with the first of them.
    pub(super) fn note(self, notes: &mut Notes) {
        if let Some((token, offset)) = self.first {
            let text =
                format!("ego poses of another time than their data (used; ego_pose {token} is {offset})");
            note(notes, &text, self.count);
        }
    }
}

/// Adds a note if frames are too close or too far apart for times in microseconds.
pub(super) fn note_interval(times_us: &[i64], notes: &mut Notes) {
    let mut gaps: Vec<i64> = times_us.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).collect();
    gaps.sort_unstable();
    let Some(median) = gaps.get(gaps.len() / 2).filter(|gap| !INTERVALS_US.contains(gap)) else { return };
    let seconds = *median as f64 * 1e-6;
    note(notes, &format!("frames {seconds} s apart (are their times microseconds?)"), times_us.len());
}

#[cfg(test)]
mod tests {
    use super::*;

    const T_US: i64 = 1_557_539_956_493_730;

    #[test]
    fn differences_up_to_a_second_are_no_offset() {
        for t_us in [T_US, T_US + 20_000, T_US - 1_000_000, T_US + 1_000_000] {
            assert_eq!(Offset::of(t_us, T_US), None);
        }
        let span = [T_US, T_US + 5_000_000];
        for t_us in [T_US - 1_000_000, T_US + 2_500_000, T_US + 6_000_000] {
            assert_eq!(Offset::from_span(t_us, span), None);
        }
        assert!(Offset::from_span(T_US + 6_000_001, span).is_some());
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
    #[cfg(any(feature = "nuplan", feature = "av2"))]
    fn a_clock_is_wrong_if_no_time_is_near() {
        let span = [T_US, T_US + 1_000_000];
        assert_eq!(Offset::of_all([T_US - 9_000_000, T_US].into_iter(), span), None);
        let late = [T_US + 9_000_000, T_US + 8_000_000];
        assert_eq!(Offset::of_all(late.into_iter(), span).unwrap().0, 1);
        assert_eq!(Offset::of_all([].into_iter(), span), None);
    }

    #[test]
    fn intervals_of_other_units_are_noted() {
        let count = |step: i64| {
            let mut notes = Notes::new();
            note_interval(&(0..5).map(|i| i * step).collect::<Vec<_>>(), &mut notes);
            notes.counts
        };
        assert!(count(50_000).is_empty() && count(500_000).is_empty());
        assert_eq!(
            count(500).into_iter().collect::<Vec<_>>(),
            [("frames 0.0005 s apart (are their times microseconds?)".to_owned(), 5)]
        );
        assert_eq!(count(500_000_000).len(), 1);
        note_interval(&[7], &mut Notes::new());
    }
}
