/// Dimensions of a rolling window: L frames, C of them clean, T inference steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Roll {
    /// Number of frames in the window, L.
    pub window: usize,
    /// Number of leading frames that are always clean, C.
    pub clean: usize,
    /// Number of inference steps, T.
    pub steps: usize,
}

/// Position of a frame in its noise schedule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Index of its next inference step, or of the last step if all are done.
    pub index: usize,
    /// Whether this network call updates the frame.
    pub is_updated: bool,
}

impl Roll {
    /// Number of inference steps that each frame takes per roll, S; `None` if T is not a multiple of `L - C`.
    pub fn per_roll(&self) -> Option<usize> {
        let moving = self.window.checked_sub(self.clean).filter(|frames| *frames > 0)?;
        (self.steps > 0 && self.steps.is_multiple_of(moving)).then(|| self.steps / moving)
    }

    /// Returns the schedule position of every frame of the window at a network call. `call` runs from `T - S`
    /// to `T - 1` in a roll, and on from there while the window stays in place. The first `references` frames
    /// are finished.
    pub fn progress(&self, call: usize, references: usize) -> Vec<Progress> {
        let per_roll = self.per_roll().unwrap_or(self.steps);
        let last = self.steps.saturating_sub(1);
        let of = |position: usize| {
            let step = call as isize - (position.saturating_sub(self.clean) * per_roll) as isize;
            if position < references {
                return Progress { index: last, is_updated: false };
            }
            let index = step.clamp(0, last as isize) as usize;
            Progress { index, is_updated: index as isize == step }
        };
        (0..self.window).map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_must_divide_evenly() {
        let roll = |window, clean, steps| Roll { window, clean, steps }.per_roll();
        assert_eq!([roll(12, 0, 36), roll(5, 1, 12), roll(1, 0, 3)], [Some(3), Some(3), Some(3)]);
        assert_eq!([roll(12, 0, 35), roll(4, 4, 8), roll(0, 0, 1), roll(4, 0, 0)], [None; 4]);
    }

    /// A window that stays in place finishes its frames one after the other.
    #[test]
    fn a_window_in_place_is_flushed() {
        let roll = Roll { window: 3, clean: 0, steps: 6 };
        let updated = |call| roll.progress(call, 0).iter().map(|p| p.is_updated).collect::<Vec<_>>();
        assert_eq!(
            [updated(5), updated(6), updated(8)],
            [vec![true; 3], vec![false, true, true], vec![false, false, true]]
        );
        assert_eq!(roll.progress(9, 0)[2], Progress { index: 5, is_updated: true });
        assert_eq!(updated(10), [false; 3]);
        // Over all calls of all rolls, a frame takes all inference steps in order.
        let taken: Vec<usize> =
            (4..10).map(|call| roll.progress(call, 0)[2]).filter(|p| p.is_updated).map(|p| p.index).collect();
        assert_eq!(taken, [0, 1, 2, 3, 4, 5]);
    }
}
