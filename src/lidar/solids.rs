//! Solids of a scene's clouds, each made when a sweep first needs it.

use rayon::prelude::*;

use super::solid::Solid;
use crate::cloud::Bounds;
use crate::error::FileError;
use crate::memory::{MemoryError, Need, reserve};
use crate::raster::CloudSet;

/// Memory of solids that stay after a sweep, bytes.
const KEPT_BYTES: u64 = 1 << 30;
/// Memory that making a solid takes for each point, bytes: points as they are read, and as they are divided.
const POINT_BYTES: u64 = 32;

/// Solids of clouds, as far as sweeps needed them.
pub(crate) struct Solids<'a> {
    clouds: CloudSet<'a>,
    /// Bounds of each cloud, meters.
    bounds: Vec<Option<Bounds>>,
    made: Vec<Option<Solid>>,
    /// Sweep that last used each solid.
    used: Vec<u64>,
    sweep: u64,
}

/// Reason why a solid could not be made.
#[derive(Debug, thiserror::Error)]
pub enum SolidError {
    /// Points could not be read.
    #[error("{0}")]
    File(#[from] FileError),
    /// They do not fit into memory.
    #[error("{0}")]
    Memory(#[from] MemoryError),
}

impl<'a> Solids<'a> {
    /// Creates the solids of clouds; none is made.
    pub(crate) fn new(clouds: CloudSet<'a>) -> Self {
        let bounds: Vec<Option<Bounds>> = clouds.iter().map(|cloud| cloud.bounds()).collect();
        let count = bounds.len();
        Self { clouds, bounds, made: (0..count).map(|_| None).collect(), used: vec![0; count], sweep: 0 }
    }

    /// Returns the bounds of a cloud, meters in its own frame; `None` without points.
    pub(super) fn bounds(&self, cloud: usize) -> Option<Bounds> {
        self.bounds[cloud]
    }

    /// Returns the solid of a cloud; `None` if it was not [made](Self::make).
    pub(super) fn get(&self, cloud: usize) -> Option<&Solid> {
        self.made[cloud].as_ref()
    }

    /// Makes the solids of the clouds that a sweep needs. Solids that were not used for longest are dropped
    /// if there are too many.
    ///
    /// # Errors
    /// Fails if points cannot be read or are damaged, or if there is too little memory.
    pub(super) fn make(&mut self, clouds: impl Iterator<Item = usize>) -> Result<(), SolidError> {
        self.sweep += 1;
        clouds.for_each(|cloud| self.used[cloud] = self.sweep);
        let is_missing = |cloud: &usize| self.used[*cloud] == self.sweep && self.made[*cloud].is_none();
        let missing: Vec<usize> = (0..self.made.len()).filter(is_missing).collect();
        let largest = missing.iter().map(|cloud| self.clouds[*cloud].len() as u64).max().unwrap_or(0);
        let bytes = POINT_BYTES * largest * rayon::current_num_threads() as u64;
        let advice = "a smaller range, or larger voxels of the skeleton, need less";
        let _memory = reserve(bytes, || Need { what: "surfaces for LiDAR".to_owned(), bytes, advice })?;
        let solid = |cloud: &usize| Ok((*cloud, Solid::of(&self.clouds[*cloud].points()?)));
        let made = missing.par_iter().map(solid).collect::<Result<Vec<_>, FileError>>()?;
        made.into_iter().for_each(|(cloud, solid)| self.made[cloud] = Some(solid));
        self.evict();
        Ok(())
    }

    fn evict(&mut self) {
        let mut bytes: u64 = self.made.iter().flatten().map(Solid::bytes).sum();
        let mut old: Vec<usize> =
            (0..self.made.len()).filter(|cloud| self.used[*cloud] < self.sweep).collect();
        old.sort_by_key(|cloud| self.used[*cloud]);
        for cloud in old {
            if bytes <= KEPT_BYTES {
                break;
            }
            bytes -= self.made[cloud].take().map_or(0, |solid| solid.bytes());
        }
    }
}
