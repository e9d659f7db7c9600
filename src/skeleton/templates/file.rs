use std::path::Path;

use glam::Vec3;

use super::{TemplateCloud, TemplateKind};
use crate::cloud::{self, Bounds, Point};
use crate::error::FileError;
use crate::skeleton::{Checksum, Template};

/// Reads a template of a kind from an NPY or PLY file and centers its bounds on the origin, like those of a box.
///
/// # Errors
/// Fails if the file cannot be read or has no point with finite coordinates.
pub fn read_template(kind: TemplateKind, path: &Path) -> Result<TemplateCloud, FileError> {
    let read = cloud::read(path)?.points;
    let no_points = || FileError::content("points with finite coordinates", "none", path);
    let bounds = Bounds::of(&read).ok_or_else(no_points)?;
    let center = (Vec3::from(bounds.min) + Vec3::from(bounds.max)) / 2.0;
    let class = kind.class();
    let centered = |p: &Point| {
        let position = Vec3::from(p.position) - center;
        position.is_finite().then(|| Point::new(position.to_array(), p.rgb(), class as u8))
    };
    let points: Vec<Point> = read.iter().filter_map(centered).collect();
    let bounds = Bounds::of(&points).ok_or_else(no_points)?;
    let size = (Vec3::from(bounds.max) - Vec3::from(bounds.min)).as_dvec3().to_array();
    let xxh3 = Checksum::of(&points);
    Ok((Template { kind, class, size, points: points.len(), bounds, xxh3 }, points))
}
