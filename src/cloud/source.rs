use std::borrow::Cow;

use rayon::prelude::*;

use super::paged::{BLOCK, PAGE, StoredCloud};
use super::{Bounds, Point};
use crate::error::FileError;

/// A cloud to render. Its points are numbered in their order.
#[derive(Clone, Copy, Debug)]
pub enum Cloud<'a> {
    /// Points in memory.
    Memory(&'a [Point]),
    /// Points in a file, which are read when they may be seen.
    Stored(StoredCloud<'a>),
}

impl<'a> Cloud<'a> {
    /// Returns the number of points.
    pub fn len(&self) -> usize {
        match self {
            Self::Memory(points) => points.len(),
            Self::Stored(cloud) => cloud.len(),
        }
    }

    /// Returns whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the bounds of each [`BLOCK`] of points, meters; `None` for a block without finite points.
    pub(crate) fn blocks(&self) -> Vec<Option<Bounds>> {
        match self {
            Self::Memory(points) => points.par_chunks(BLOCK).map(Bounds::of_finite).collect(),
            Self::Stored(cloud) => cloud.blocks().collect(),
        }
    }

    /// Returns the bounds of all finite points, meters; `None` if there are none.
    pub fn bounds(&self) -> Option<Bounds> {
        self.blocks().into_iter().flatten().reduce(Bounds::and)
    }

    /// Returns all points.
    ///
    /// # Errors
    /// Fails if they cannot be read or do not match their checksums.
    pub fn points(&self) -> Result<Cow<'a, [Point]>, FileError> {
        match self {
            Self::Memory(points) => Ok(Cow::Borrowed(points)),
            Self::Stored(cloud) => {
                let mut points = vec![Point::default(); cloud.len()];
                let pages = points.par_chunks_mut(PAGE).enumerate();
                let damage = pages.filter_map(|(page, points)| cloud.read(page, points).err());
                damage.find_first(|_| true).map_or(Ok(()), Err)?;
                Ok(Cow::Owned(points))
            }
        }
    }
}

impl<'a> From<&'a [Point]> for Cloud<'a> {
    fn from(points: &'a [Point]) -> Self {
        Self::Memory(points)
    }
}

impl<'a> From<&'a Vec<Point>> for Cloud<'a> {
    fn from(points: &'a Vec<Point>) -> Self {
        Self::Memory(points)
    }
}

impl<'a, const N: usize> From<&'a [Point; N]> for Cloud<'a> {
    fn from(points: &'a [Point; N]) -> Self {
        Self::Memory(points)
    }
}
