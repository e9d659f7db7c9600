use std::ops::{Deref, Range};
use std::sync::Arc;

use bytemuck::Pod;

use crate::gpu::Mapped;

/// Values of one map: owned, or in the memory that the rasterizer wrote. It reuses that memory only after all
/// planes of a frame are dropped.
#[derive(Clone)]
pub struct Plane<'a, T>(Place<'a, T>);

#[derive(Clone)]
enum Place<'a, T> {
    Owned(Vec<T>),
    Borrowed(&'a [T]),
    Mapped { memory: Arc<Mapped<'a>>, bytes: Range<usize> },
}

impl<'a, T: Pod> Plane<'a, T> {
    /// Returns a plane over mapped memory; the byte range must be aligned for `T`.
    pub(in super::super) fn mapped(memory: Arc<Mapped<'a>>, bytes: Range<usize>) -> Self {
        Self(Place::Mapped { memory, bytes })
    }

    /// Returns a plane over the memory of a rasterizer.
    pub(in super::super) fn borrowed(values: &'a [T]) -> Self {
        Self(Place::Borrowed(values))
    }

    /// Returns the values; copies them from the memory of a rasterizer.
    pub fn into_owned(self) -> Vec<T> {
        match self.0 {
            Place::Owned(values) => values,
            Place::Borrowed(_) | Place::Mapped { .. } => self.to_vec(),
        }
    }
}

impl<T> From<Vec<T>> for Plane<'_, T> {
    fn from(values: Vec<T>) -> Self {
        Self(Place::Owned(values))
    }
}

impl<T: Pod> Deref for Plane<'_, T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        match &self.0 {
            Place::Owned(values) => values,
            Place::Borrowed(values) => values,
            Place::Mapped { memory, bytes } => bytemuck::cast_slice(&memory[bytes.clone()]),
        }
    }
}

impl<T: Pod + std::fmt::Debug> std::fmt::Debug for Plane<'_, T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.deref().fmt(f)
    }
}

impl<T: Pod + PartialEq> PartialEq for Plane<'_, T> {
    fn eq(&self, other: &Self) -> bool {
        self.deref() == other.deref()
    }
}
