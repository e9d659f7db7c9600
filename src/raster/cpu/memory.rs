//! Large arrays in huge pages, where the system has them: random access in pages of 4 KiB waits for the translation of
//! addresses.

use std::ops::{Deref, DerefMut, Range};

use bytemuck::Pod;
use memmap2::MmapMut;

/// A slice in memory of its own.
pub(super) enum HugeSlice<T> {
    /// The bytes of the slice in a mapping.
    Mapped(MmapMut, Range<usize>, std::marker::PhantomData<T>),
    /// Small slices, and where memory cannot be mapped.
    Vec(Vec<T>),
}

/// Size and alignment of a huge page, bytes.
const HUGE_PAGE: usize = 1 << 21;
/// Size from which slices get huge pages of their own, bytes.
const LARGE: usize = HUGE_PAGE / 4;

impl<T: Pod> HugeSlice<T> {
    pub(super) fn zeroed(count: usize) -> Self {
        let bytes = count * size_of::<T>();
        if bytes < LARGE {
            return Self::Vec(vec![T::zeroed(); count]);
        }
        // Only whole and aligned huge pages are used. Memory is not occupied before it is written.
        let pages = bytes.next_multiple_of(HUGE_PAGE);
        match MmapMut::map_anon(pages + HUGE_PAGE) {
            Ok(memory) => {
                let first = memory.as_ptr().align_offset(HUGE_PAGE).min(HUGE_PAGE);
                // Systems without huge pages refuse; the memory is as usable then.
                #[cfg(target_os = "linux")]
                let _ = memory.advise_range(memmap2::Advice::HugePage, first, pages);
                Self::Mapped(memory, first..first + bytes, std::marker::PhantomData)
            }
            Err(_) => Self::Vec(vec![T::zeroed(); count]),
        }
    }
}

impl<T: Pod> Deref for HugeSlice<T> {
    type Target = [T];

    #[inline(always)]
    fn deref(&self) -> &[T] {
        match self {
            Self::Mapped(memory, bytes, _) => bytemuck::cast_slice(&memory[bytes.clone()]),
            Self::Vec(values) => values,
        }
    }
}

impl<T: Pod> DerefMut for HugeSlice<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        match self {
            Self::Mapped(memory, bytes, _) => bytemuck::cast_slice_mut(&mut memory[bytes.clone()]),
            Self::Vec(values) => values,
        }
    }
}

/// Lets the processor load a value into its cache while it works on something else.
#[inline(always)]
pub(super) fn prefetch<T>(value: &T) {
    #[cfg(not(target_arch = "x86_64"))]
    let _ = value;
    #[cfg(target_arch = "x86_64")]
    if let Some(sse) = pulp::core_arch::x86::Sse::try_new() {
        for offset in (0..size_of::<T>()).step_by(64) {
            let line = std::ptr::from_ref(value).cast::<i8>().wrapping_add(offset);
            sse._mm_prefetch::<{ std::arch::x86_64::_MM_HINT_T0 }>(line);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slices_are_zero_and_keep_what_is_written() {
        for count in [1, 1000, LARGE / 4, 3_000_001] {
            let mut slice: HugeSlice<u32> = HugeSlice::zeroed(count);
            assert!(slice.len() == count && slice.iter().all(|value| *value == 0));
            slice[count - 1] = 7;
            assert_eq!(slice.iter().sum::<u32>(), 7);
        }
        assert!(HugeSlice::<[u64; 3]>::zeroed(0).is_empty());
    }
}
