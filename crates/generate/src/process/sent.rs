use crate::FrameConditions;

/// Conditions that a process keeps: those of the last call, by number.
#[derive(Debug, Default)]
pub(super) struct SentFrames {
    /// Fingerprints with their numbers.
    kept: Vec<(u64, u64)>,
    /// Number of the next conditions.
    next: u64,
}

/// Numbers of a window's conditions.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Numbered {
    /// Number of each frame.
    pub(super) numbers: Vec<u64>,
    /// Positions in the window of conditions that the process does not have, each once.
    pub(super) new: Vec<usize>,
}

impl SentFrames {
    /// Numbers the conditions of a window; all others are forgotten.
    pub(super) fn number(&mut self, window: &[&FrameConditions]) -> Numbered {
        let fingerprints: Vec<u64> = window.iter().map(|frame| frame.fingerprint()).collect();
        self.number_all(&fingerprints)
    }

    fn number_all(&mut self, fingerprints: &[u64]) -> Numbered {
        let before = std::mem::take(&mut self.kept);
        let (mut numbers, mut new) = (Vec::new(), Vec::new());
        for (position, fingerprint) in fingerprints.iter().enumerate() {
            let known = self.kept.iter().chain(&before).find(|(known, _)| known == fingerprint);
            let number = known.map_or(self.next, |(_, number)| *number);
            if known.is_none() {
                self.next += 1;
                new.push(position);
            }
            numbers.push(number);
            self.kept.push((*fingerprint, number));
        }
        Numbered { numbers, new }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conditions_are_new_once_and_forgotten_after_a_window_without_them() {
        let mut sent = SentFrames::default();
        let mut number = |fingerprints: &[u64]| {
            let Numbered { numbers, new } = sent.number_all(fingerprints);
            (numbers, new)
        };
        assert_eq!(number(&[7, 8, 7]), (vec![0, 1, 0], vec![0, 1]));
        assert_eq!(number(&[7, 8, 7]), (vec![0, 1, 0], vec![]));
        assert_eq!(number(&[8, 9, 9]), (vec![1, 2, 2], vec![1]));
        assert_eq!(number(&[9, 7, 8]), (vec![2, 3, 1], vec![1])); // 7 was forgotten
    }
}
