use std::path::Path;

use glam::Vec3;

use super::{TemplateCloud, TemplateKind};
use crate::cloud::{self, Bounds, Point};
use crate::error::FileError;
use crate::files::Checksum;
use crate::geometry::{MAX_SIDE_M, MIN_SIDE_M, is_size};
use crate::skeleton::Template;

/// Reads a template of a kind from an NPY or PLY file and centers its bounds on the origin, as boxes are.
/// Also returns sentences on unusual content, including [`PointFile::notes`](cloud::PointFile::notes).
///
/// # Errors
/// Fails if the file cannot be read, or if the bounds of its points do not form a box.
pub fn read_template(kind: TemplateKind, path: &Path) -> Result<(TemplateCloud, Vec<String>), FileError> {
    let cloud::PointFile { points: read, mut notes, non_finite, .. } = cloud::read(path)?;
    if non_finite > 0 {
        notes.push(format!("{non_finite} of {} points are not finite: left out", read.len()));
    }
    let bounds = Bounds::of(&read)
        .ok_or_else(|| FileError::content("points with finite coordinates", "none", path))?;
    let sides = (Vec3::from(bounds.max) - Vec3::from(bounds.min)).as_dvec3();
    if !is_size(sides) {
        let expected = format!("points within a box with sides of {MIN_SIDE_M} to {MAX_SIDE_M} m");
        return Err(FileError::content(expected, format!("sides of {:?} m", sides.to_array()), path));
    }
    let center = (Vec3::from(bounds.min) + Vec3::from(bounds.max)) / 2.0;
    let class = kind.class();
    let centered = |p: &Point| {
        let position = Vec3::from(p.position) - center;
        position.is_finite().then(|| Point::new(position.to_array(), p.rgb(), class as u8))
    };
    let points: Vec<Point> = read.iter().filter_map(centered).collect();
    let bounds = Bounds::of(&points)
        .ok_or_else(|| FileError::content("points with finite coordinates", "none", path))?;
    let size = (Vec3::from(bounds.max) - Vec3::from(bounds.min)).as_dvec3().to_array();
    let xxh3 = Checksum::of(&points);
    Ok(((Template { kind, class, size, points: points.len(), bounds, xxh3 }, points), notes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::npy;

    fn read(points: &[[f32; 3]]) -> Result<(TemplateCloud, Vec<String>), FileError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.npy");
        let points: Vec<Point> = points.iter().map(|p| Point::new(*p, [9; 3], 0)).collect();
        npy::write(&path, &points, false).unwrap();
        read_template(TemplateKind::Sedan, &path)
    }

    #[test]
    fn bounds_are_centered_and_lost_points_noted() {
        let nan = [f32::NAN; 3];
        let ((template, points), notes) = read(&[[1.0, 2.0, 3.0], nan, [5.0, 4.0, 4.0]]).unwrap();
        assert_eq!((template.size, points[0].position), ([4.0, 2.0, 1.0], [-2.0, -1.0, -0.5]));
        assert_eq!(notes, ["1 of 3 points are not finite: left out"]);
    }

    #[test]
    fn rejects_points_without_the_bounds_of_a_box() {
        for (points, found) in [
            ([[-3e38, 0.0, 0.0], [3e38, 1.0, 1.0]], "sides of [inf, 1.0, 1.0] m"),
            ([[0.0; 3], [3e30, 1.0, 1.0]], "sides of [2.99"),
            ([[0.0; 3], [1.0, 1.0, 0.0]], "sides of [1.0, 1.0, 0.0] m"),
        ] {
            let message = read(&points).unwrap_err().to_string();
            let expected = "expected points within a box with sides of 0.0001 to 100000 m, found ";
            assert!(message.starts_with(&format!("{expected}{found}")), "{message}");
        }
        assert!(
            read(&[[f32::NAN; 3]; 2]).unwrap_err().to_string().contains("points with finite coordinates")
        );
    }
}
