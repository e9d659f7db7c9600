//! Rows that represent a file without a header when its layout is judged.

use crate::error::FileError;

/// A file of more than this many parts of this size is judged from parts that are spread over it.
const PARTS: u64 = 32;
const PART_BYTES: u64 = 1 << 11;

/// Reads bytes of a file: `(start, length)`.
pub(in crate::dataset) type ReadAt<'a> = dyn Fn(u64, usize) -> Result<Vec<u8>, FileError> + 'a;

/// Values of a file, 4 bytes each.
pub(super) struct Sample {
    parts: Vec<Part>,
    pub(super) is_whole: bool,
}

struct Part {
    /// Index of the first value in the file, even.
    first: usize,
    words: Vec<u32>,
}

impl Sample {
    /// Reads parts of equal size that are spread over a file of `length` bytes.
    ///
    /// # Errors
    /// Returns any error of `read`.
    pub(super) fn spread(read: &ReadAt<'_>, length: u64) -> Result<Self, FileError> {
        if length <= PARTS * PART_BYTES {
            return Self::whole(read, length);
        }
        // Starts at multiples of 8 bytes, for floats of that size.
        let start = |i: u64| (length - PART_BYTES) / (PARTS - 1) * i / 8 * 8;
        let parts = (0..PARTS).map(|i| Part::read(read, start(i), PART_BYTES)).collect::<Result<_, _>>()?;
        Ok(Self { parts, is_whole: false })
    }

    /// Reads the whole file.
    ///
    /// # Errors
    /// Returns any error of `read`.
    pub(super) fn whole(read: &ReadAt<'_>, length: u64) -> Result<Self, FileError> {
        Ok(Self { parts: vec![Part::read(read, 0, length)?], is_whole: true })
    }

    /// Returns all values.
    pub(super) fn words(&self) -> impl Iterator<Item = u32> {
        self.parts.iter().flat_map(|part| part.words.iter().copied())
    }

    /// Returns all values of 8 bytes.
    pub(super) fn pairs(&self) -> impl Iterator<Item = [u32; 2]> {
        self.parts.iter().flat_map(|part| part.words.as_chunks::<2>().0.iter().copied())
    }

    /// Returns this many rows, except rows that repeat one value, like zeros in place of returns: they look
    /// the same with any number of columns.
    pub(super) fn rows(&self, columns: usize) -> impl Iterator<Item = &[u32]> {
        let skipped = move |part: &Part| part.first.next_multiple_of(columns) - part.first;
        let parts = self.parts.iter().map(move |part| part.words.get(skipped(part)..).unwrap_or_default());
        parts.flat_map(move |words| words.chunks_exact(columns)).filter(|row| !is_uniform(row))
    }
}

/// Returns whether a row has one value only.
pub(super) fn is_uniform(row: &[u32]) -> bool {
    row.windows(2).all(|pair| pair[0] == pair[1])
}

impl Part {
    fn read(read: &ReadAt<'_>, start: u64, length: u64) -> Result<Self, FileError> {
        let bytes = read(start, length as usize)?;
        let words = bytes.as_chunks::<4>().0.iter().map(|word| u32::from_le_bytes(*word)).collect();
        Ok(Self { first: start as usize / 4, words })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows keep their place in the file, wherever a part begins.
    #[test]
    fn rows_of_parts_are_aligned_with_the_file() {
        let values: Vec<u32> = (0..60_000).collect();
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let read = |start: u64, length: usize| Ok(bytes[start as usize..start as usize + length].to_vec());
        let sample = Sample::spread(&read, bytes.len() as u64).unwrap();
        assert!(!sample.is_whole && sample.words().count() == 32 * 512);
        for columns in 3..20 {
            assert!(sample.rows(columns).all(|row| (row[0] as usize).is_multiple_of(columns)));
            assert!(sample.rows(columns).count() >= 32 * (512 / columns - 1));
        }
        assert!(sample.pairs().all(|[low, high]| low % 2 == 0 && high == low + 1));
        let whole = Sample::spread(&read, 1000).unwrap();
        assert!(whole.is_whole && whole.words().count() == 250);
    }

    #[test]
    fn rows_of_one_value_are_left_out() {
        let values: [u32; 9] = [0, 0, 0, 1, 2, 3, 7, 7, 7];
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let read = |_: u64, _: usize| Ok(bytes.clone());
        let sample = Sample::whole(&read, 36).unwrap();
        assert_eq!(sample.rows(3).collect::<Vec<_>>(), [[1, 2, 3]]);
    }
}
