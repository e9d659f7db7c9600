//! Masks of 8 by 8 cells.

/// Cells of a side.
pub(super) const SIDE: usize = 8;

/// A mask of 8 by 8 cells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Mask(u64);

/// All columns but the last, and all but the first.
const NOT_LAST: u64 = 0x7f7f_7f7f_7f7f_7f7f;
const NOT_FIRST: u64 = 0xfefe_fefe_fefe_fefe;

impl Mask {
    /// Sets the cell at coordinates from 0 to 1 over the mask.
    pub(super) fn set(&mut self, at: [f32; 2]) {
        self.0 |= 1 << Self::cell(at);
    }

    /// Returns whether the cell at coordinates from 0 to 1 is set.
    #[inline(always)]
    pub(super) fn has(self, at: [f32; 2]) -> bool {
        self.0 >> Self::cell(at) & 1 == 1
    }

    /// Returns the number of cells that are set.
    pub(super) fn count(self) -> usize {
        self.0.count_ones() as usize
    }

    /// Returns the morphological closing by a square of `2 radius + 1` cells: gaps of up to `2 radius` cells
    /// are filled. Cells beyond the edge count as set, so gaps at the edge are filled up to `radius` cells.
    #[must_use]
    pub(super) fn closed(self, radius: usize) -> Self {
        let dilated = (0..radius).fold(self, |mask, _| mask.dilated());
        (0..radius).fold(dilated, |mask, _| Self(!Self(!mask.0).dilated().0))
    }

    fn dilated(self) -> Self {
        let beside = self.0 | (self.0 & NOT_FIRST) >> 1 | (self.0 & NOT_LAST) << 1;
        Self(beside | beside << SIDE | beside >> SIDE)
    }

    #[inline(always)]
    fn cell([x, y]: [f32; 2]) -> usize {
        let cell = |at: f32| ((at * SIDE as f32) as usize).min(SIDE - 1);
        cell(y) * SIDE + cell(x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(rows: [&str; SIDE]) -> Mask {
        let mut mask = Mask::default();
        for (y, row) in rows.iter().enumerate() {
            for (x, _) in row.bytes().enumerate().filter(|(_, cell)| *cell == b'#') {
                mask.set([x, y].map(|i| (i as f32 + 0.5) / SIDE as f32));
            }
        }
        mask
    }

    /// Two rows with a gap of two, a gap of four in a row, and a hole at the edge.
    #[test]
    fn closing_fills_narrow_gaps_and_retains_outlines() {
        let open = mask([
            "........", "........", "........", "####....", "........", "........", "####....", "........",
        ]);
        let one = mask([
            "........", "........", "........", "####....", "####....", "####....", "####....", "####....",
        ]);
        assert_eq!(open.closed(1), one);
        assert_eq!((open.closed(0), open.count()), (open, 8));
        let far = mask([
            "#....#..", "........", "........", "........", "........", "........", "........", "........",
        ]);
        assert!(far.closed(1).count() < far.closed(2).count());
        assert!([0, 1, 2, 3].iter().all(|radius| Mask::default().closed(*radius) == Mask::default()));
    }

    #[test]
    fn cells_are_found_by_coordinates() {
        let mut mask = Mask::default();
        mask.set([0.0, 1.0]);
        assert!(mask.has([0.124, 0.876]) && !mask.has([0.126, 0.876]) && !mask.has([0.124, 0.874]));
        assert_eq!(mask.count(), 1);
    }
}
