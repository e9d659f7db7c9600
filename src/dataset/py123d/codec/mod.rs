//! Sweeps stored in cells of a LiDAR table, as bytes in one of three codecs.
//!
//! # How it works
//! The first bytes tell the codec. Each decoder validates the counts of the headers against the number of
//! bytes before it allocates memory for them, and turns the bytes into [`Points`]: positions in the order of
//! the file, and the features that are read (`intensity`, `ids`, `channel`). Other features are named, not
//! decoded.
//! - `ipc`: an Arrow IPC stream, uncompressed or with LZ4 or Zstandard; lossless.
//! - `laz`: a LAS file compressed by LASzip; positions are integers times a step.
//! - `draco`: a Draco point cloud; positions are integers times a step that the extent of the cloud decides.

mod draco;
mod feature;
mod ipc;
mod laz;
#[cfg(test)]
mod tests;

use feature::{Column, extend_integers};

use crate::files::sniff;

/// Names of the features that are read.
const FEATURES: [&str; 3] = ["intensity", "ids", "channel"];

/// Maximum decoded bytes per byte of a cell: codecs shrink points by a small factor only.
const MAX_EXPANSION: u64 = 64;
/// Lower bound of this limit, for small cells, bytes.
const MIN_LIMIT_BYTES: u64 = 16 << 20;

/// Points of a sweep as stored. Features have one value per point.
#[derive(Debug, Default, PartialEq)]
pub(in crate::dataset::py123d) struct Points {
    /// Positions, meters. They may be NaN or infinite.
    pub(in crate::dataset::py123d) xyz: Vec<[f32; 3]>,
    pub(in crate::dataset::py123d) intensity: Option<Vec<f32>>,
    /// LiDAR numbers.
    pub(in crate::dataset::py123d) ids: Option<Vec<u8>>,
    /// Beam numbers.
    pub(in crate::dataset::py123d) channel: Option<Vec<u16>>,
    /// Names of features that are not read, in the order of the file.
    pub(in crate::dataset::py123d) skipped: Vec<String>,
}

impl Points {
    /// Appends the values of a feature that is read.
    ///
    /// # Errors
    /// Returns a description of values that the feature cannot have.
    fn extend_feature(&mut self, name: &str, column: &Column<'_>) -> Result<(), String> {
        let failed = |value: f64| format!("a feature {name} of {value}");
        match name {
            "intensity" => {
                self.intensity.get_or_insert_default().extend(column.numbers().map(|value| value as f32));
                Ok(())
            }
            "ids" => extend_integers(self.ids.get_or_insert_default(), column).map_err(failed),
            "channel" => extend_integers(self.channel.get_or_insert_default(), column).map_err(failed),
            _ => Err(format!("a feature {name}")),
        }
    }

    /// Fails unless every feature has a value per point.
    fn check_lengths(&self) -> Result<(), String> {
        let lengths = [
            ("intensity", self.intensity.as_ref().map(Vec::len)),
            ("ids", self.ids.as_ref().map(Vec::len)),
            ("channel", self.channel.as_ref().map(Vec::len)),
        ];
        let points = self.xyz.len();
        match lengths.into_iter().find(|(_, length)| length.is_some_and(|n| n != points)) {
            Some((name, length)) => {
                Err(format!("{} values of {name} for {points} points", length.unwrap_or(0)))
            }
            None => Ok(()),
        }
    }
}

/// Returns whether a feature of this name is read.
fn is_read(name: &str) -> bool {
    FEATURES.contains(&name)
}

/// Returns the maximum decoded bytes of a cell.
fn most_decoded(bytes: &[u8]) -> u64 {
    MIN_LIMIT_BYTES.max(MAX_EXPANSION.saturating_mul(bytes.len() as u64))
}

/// Codec of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::dataset::py123d) enum Codec {
    /// Arrow IPC stream.
    Ipc,
    /// Compressed LAS file.
    Laz,
    /// Draco point cloud.
    Draco,
}

impl Codec {
    /// Returns the codec of a cell by its first bytes.
    pub(in crate::dataset::py123d) fn of(bytes: &[u8]) -> Option<Self> {
        let magics = [(ipc::MARKER, Self::Ipc), (b"LASF", Self::Laz), (draco::MAGIC, Self::Draco)];
        magics.into_iter().find(|(magic, _)| bytes.starts_with(magic)).map(|(_, codec)| codec)
    }
}

/// Decodes the points of a cell.
///
/// # Errors
/// Returns a description of the content if it has no known codec, or is damaged.
pub(in crate::dataset::py123d) fn decode(bytes: &[u8]) -> Result<Points, String> {
    let points = match known(bytes)? {
        Codec::Ipc => ipc::decode(bytes),
        Codec::Laz => laz::decode(bytes),
        Codec::Draco => draco::decode(bytes),
    }?;
    points.check_lengths()?;
    Ok(points)
}

/// Returns how many points a cell has, after decoding it. A cell is a value of column `data` in a LiDAR
/// table that stores sweeps inside.
///
/// # Errors
/// Returns a description of the content if it has no known codec, or is damaged.
pub fn count_points(cell: &[u8]) -> Result<u64, String> {
    let (declared, points) = (declared_points(cell)?, decode(cell)?);
    let found = points.xyz.len() as u64;
    if found != declared {
        return Err(format!("{found} of {declared} points"));
    }
    Ok(found)
}

/// Returns the number of points that the headers of a cell declare.
///
/// # Errors
/// Fails as [`decode`], except for damage that headers do not show.
pub(in crate::dataset::py123d) fn declared_points(bytes: &[u8]) -> Result<u64, String> {
    match known(bytes)? {
        Codec::Ipc => ipc::declared_points(bytes),
        Codec::Laz => laz::declared_points(bytes),
        Codec::Draco => draco::declared_points(bytes),
    }
}

fn known(bytes: &[u8]) -> Result<Codec, String> {
    Codec::of(bytes).ok_or_else(|| match sniff::marked(bytes) {
        Some(found) => found.to_owned(),
        None => format!("{} bytes of an unknown codec", bytes.len()),
    })
}
