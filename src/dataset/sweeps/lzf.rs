//! LZF, the compression of PCD files.

/// Decompresses LZF data of exactly `length` bytes. `None` if the data are damaged or of another length.
///
/// Source of the format: the comments of `lzf_d.c` in liblzf.
pub(super) fn decompress(data: &[u8], length: usize) -> Option<Vec<u8>> {
    /// A control byte below this number announces literal bytes.
    const LITERALS: u8 = 1 << 5;
    let mut out = Vec::new();
    let mut bytes = data.iter();
    let mut next = || bytes.next().copied();
    while let Some(control) = next() {
        if control < LITERALS {
            for _ in 0..=control {
                out.push(next()?);
            }
        } else {
            let mut count = usize::from(control >> 5);
            if count == 7 {
                count += usize::from(next()?);
            }
            let back = (usize::from(control & 31) << 8 | usize::from(next()?)) + 1;
            let start = out.len().checked_sub(back)?;
            // The source may overlap the bytes that it creates.
            (start..start + count + 2).for_each(|i| out.push(out[i]));
        }
        if out.len() > length {
            return None;
        }
    }
    (out.len() == length).then_some(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn literals_and_repetitions_are_decoded() {
        // "abc", then 6 bytes from 3 back, then 10 bytes from 1 back.
        let data = [2, b'a', b'b', b'c', 4 << 5, 2, 7 << 5, 1, 0];
        assert_eq!(decompress(&data, 19).unwrap(), b"abcabcabccccccccccc");
        assert_eq!(decompress(&data, 18), None);
        assert_eq!(decompress(&data, 20), None);
        assert_eq!(decompress(&data[..8], 19), None);
        assert_eq!(decompress(&[1 << 5, 0], 3), None);
        assert_eq!(decompress(&[], 0).unwrap(), b"");
    }

    proptest! {
        #[test]
        fn any_bytes_are_data_or_none(data in proptest::collection::vec(any::<u8>(), 0..200),
        length in 0..400_usize) {
            prop_assert!(decompress(&data, length).is_none_or(|out| out.len() == length));
        }
    }
}
