//! Clouds in files of points, as manifests describe them.

use std::path::Path;

use super::manifest::{Asset, Chunk, Template};
use crate::cloud::Point;
use crate::error::FileError;
use crate::files::Checksum;

/// Manifest entry of a cloud in a file of points.
pub(in crate::skeleton) trait Entry: Sync {
    /// Returns the number of points.
    fn points(&self) -> usize;

    /// Returns the checksum of the points.
    fn checksum(&self) -> Checksum;

    /// Returns the cloud's name for messages; `index` is its position in the manifest's list.
    fn name(&self, index: usize) -> String;

    /// Validates points read from `path` against the checksum.
    fn check(&self, index: usize, points: &[Point], path: &Path) -> Result<(), FileError> {
        self.checksum().check(points, || self.name(index), path)
    }
}

impl Entry for Chunk {
    fn points(&self) -> usize {
        self.points
    }

    fn checksum(&self) -> Checksum {
        self.xxh3
    }

    fn name(&self, index: usize) -> String {
        format!("chunk {index}")
    }
}

impl Entry for Asset {
    fn points(&self) -> usize {
        self.points
    }

    fn checksum(&self) -> Checksum {
        self.xxh3
    }

    fn name(&self, _: usize) -> String {
        format!("track {:?} of log {:?}", self.track, self.log)
    }
}

impl Entry for Template {
    fn points(&self) -> usize {
        self.points
    }

    fn checksum(&self) -> Checksum {
        self.xxh3
    }

    fn name(&self, _: usize) -> String {
        format!("template {}", self.kind.name())
    }
}
