//! Large arrays in huge pages, where the system has them: random access to gigabytes in pages of 4 KiB waits
//! for the translation of addresses.

use std::ops::{Deref, DerefMut};

use bytemuck::Pod;
use memmap2::MmapMut;

/// A slice in memory of its own.
pub(super) enum HugeSlice<T> {
    Mapped(MmapMut, std::marker::PhantomData<T>),
    /// Where memory cannot be mapped, and for empty slices.
    Vec(Vec<T>),
}

impl<T: Pod> HugeSlice<T> {
    pub(super) fn zeroed(count: usize) -> Self {
        let bytes = count * size_of::<T>();
        let mapped = if bytes == 0 { None } else { MmapMut::map_anon(bytes).ok() };
        match mapped {
            Some(memory) => {
                // Systems without huge pages refuse; the memory is as usable then.
                #[cfg(target_os = "linux")]
                let _ = memory.advise(memmap2::Advice::HugePage);
                Self::Mapped(memory, std::marker::PhantomData)
            }
            None => Self::Vec(vec![T::zeroed(); count]),
        }
    }
}

impl<T: Pod> Deref for HugeSlice<T> {
    type Target = [T];

    #[inline(always)]
    fn deref(&self) -> &[T] {
        match self {
            Self::Mapped(memory, _) => bytemuck::cast_slice(memory),
            Self::Vec(values) => values,
        }
    }
}

impl<T: Pod> DerefMut for HugeSlice<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        match self {
            Self::Mapped(memory, _) => bytemuck::cast_slice_mut(memory),
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
        let mut slice: HugeSlice<u32> = HugeSlice::zeroed(3_000_001);
        assert!(slice.len() == 3_000_001 && slice.iter().all(|value| *value == 0));
        slice[3_000_000] = 7;
        assert_eq!(slice.iter().sum::<u32>(), 7);
        assert!(HugeSlice::<[u64; 3]>::zeroed(0).is_empty());
    }
}
