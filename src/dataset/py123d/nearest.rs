//! Which image belongs to which frame.
//!
//! py123d may write each table at its own rate. Then `sync` names the first row in the interval of a frame,
//! and an image that was taken shortly before its sweep is named by the frame before. So where `sync` leaves
//! rows out, the row nearest in time is taken.

/// What the row of a table belongs to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Assignment {
    /// Frames.
    Frames(Vec<usize>),
    /// The interval before a frame.
    Before(usize),
    /// The time after the last frame.
    Beyond,
}

/// Half the distance of frames where there is only one, microseconds.
const TOLERANCE_US: u64 = 50_000;

/// Returns the assignment of each row. `times_us` are the rows' times, `named` is the row that `sync` names
/// for each frame, and `frames_us` are the frames' times, which increase.
pub(super) fn assign(times_us: &[i64], named: &[Option<usize>], frames_us: &[i64]) -> Vec<Assignment> {
    let mut places: Vec<Vec<usize>> = vec![Vec::new(); times_us.len()];
    named.iter().enumerate().filter_map(|(frame, row)| Some((frame, (*row)?))).for_each(|(frame, row)| {
        places[row].push(frame);
    });
    if places.iter().any(Vec::is_empty) {
        places = nearest(times_us, frames_us);
    }
    let place = |(row, frames): (usize, Vec<usize>)| {
        let next = frames_us.partition_point(|t_us| *t_us < times_us[row]);
        match frames.is_empty() {
            false => Assignment::Frames(frames),
            true if next < frames_us.len() => Assignment::Before(next),
            true => Assignment::Beyond,
        }
    };
    places.into_iter().enumerate().map(place).collect()
}

/// Returns for each row the frames to which it is the nearest one, at most half the median distance of frames
/// away.
fn nearest(times_us: &[i64], frames_us: &[i64]) -> Vec<Vec<usize>> {
    let mut gaps: Vec<u64> = frames_us.windows(2).map(|pair| pair[1].abs_diff(pair[0])).collect();
    gaps.sort_unstable();
    let tolerance = gaps.get(gaps.len() / 2).map_or(TOLERANCE_US, |gap| gap / 2);
    let mut places = vec![Vec::new(); times_us.len()];
    for (frame, t_us) in frames_us.iter().enumerate() {
        let next = times_us.partition_point(|time| time < t_us);
        let near = next.saturating_sub(1)..times_us.len().min(next + 1);
        let best = near.min_by_key(|row| times_us[*row].abs_diff(*t_us));
        if let Some(row) = best.filter(|row| times_us[*row].abs_diff(*t_us) <= tolerance) {
            places[row].push(frame);
        }
    }
    // A row belongs to the nearest of the frames that want it.
    for (row, frames) in places.iter_mut().enumerate().filter(|(_, frames)| frames.len() > 1) {
        let best = frames.iter().copied().min_by_key(|frame| frames_us[*frame].abs_diff(times_us[row]));
        *frames = best.into_iter().collect();
    }
    places
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_named_rows_are_taken_as_named() {
        // Images that are 81 of 100 ms after their frame.
        let found = assign(&[81, 181], &[Some(0), Some(1)], &[0, 100]);
        assert_eq!(found, [Assignment::Frames(vec![0]), Assignment::Frames(vec![1])]);
    }

    #[test]
    fn rows_between_named_ones_are_assigned_by_time() {
        // Frames at 0, 100 and 200; images shortly before them, so that each is named by the frame before.
        let found = assign(&[-10, 90, 150, 195], &[Some(1), Some(2), None], &[0, 100, 200]);
        let frames = |frame: usize| Assignment::Frames(vec![frame]);
        assert_eq!(found, [frames(0), frames(1), Assignment::Before(2), frames(2)]);
        // A second row of a frame, one too far away, and one after the end.
        let found = assign(&[0, 1, 260, 400], &[Some(0), None, None], &[0, 100, 200]);
        assert_eq!(found, [frames(0), Assignment::Before(1), Assignment::Beyond, Assignment::Beyond]);
        // Of two frames that share a nearest row, the nearer one has it.
        let found = assign(&[60, 900], &[None, None], &[0, 100]);
        assert_eq!(found, [frames(1), Assignment::Beyond]);
        assert_eq!(assign(&[40_000], &[None], &[0]), [frames(0)]);
        assert_eq!(assign(&[], &[None], &[0]), []);
    }
}
