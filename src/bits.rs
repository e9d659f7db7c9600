//! Bit masks.

/// Iterator over the bits that are set in a word, lowest first.
pub(crate) struct Ones(pub(crate) u64);

impl Iterator for Ones {
    type Item = usize;

    #[inline(always)]
    fn next(&mut self) -> Option<usize> {
        let bit = self.0.trailing_zeros() as usize;
        (self.0 != 0).then(|| {
            self.0 &= self.0 - 1;
            bit
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ones_yields_set_bits() {
        assert_eq!(Ones(1 << 63 | 0b10_0001).collect::<Vec<_>>(), [0, 5, 63]);
        assert_eq!(Ones(0).count(), 0);
    }
}
