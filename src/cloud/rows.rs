use std::path::Path;

use glam::{DAffine3, DVec3};

use super::Point;
use crate::error::FileError;

/// Points of a file in row order: point `i` is row `i`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointFile {
    /// Points relative to [`PointFile::origin`]. A row with a non-finite coordinate has NaN in all three and is never
    /// rendered.
    pub points: Vec<Point>,
    /// Origin subtracted from the coordinates before conversion to `f32`, meters. Nonzero only for double precision
    /// far from zero.
    pub origin: DVec3,
    /// Number of rows with a NaN or infinite coordinate.
    pub non_finite: usize,
}

impl PointFile {
    /// Returns the translation by [`PointFile::origin`].
    pub fn world_from_local(&self) -> DAffine3 {
        DAffine3::from_translation(self.origin)
    }
}

/// Threshold for an origin, meters. From here on, the spacing of `f32` is about half a millimeter or more.
const FAR_FROM_ZERO_M: f64 = 4096.0;

/// Row of a file, not validated yet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Row {
    /// Meters.
    pub(super) position: [f64; 3],
    /// 0 to 255.
    pub(super) rgb: [f64; 3],
    /// Integer of 0 to 255.
    pub(super) class: f64,
}

/// Validates and collects rows.
pub(super) struct RowCollector<'a> {
    cloud: PointFile,
    path: &'a Path,
    /// `true` until the origin is chosen.
    choose_origin: bool,
}

impl<'a> RowCollector<'a> {
    /// Creates a collector. `double`: the file has more precision than `f32`, so coordinates far from zero need an
    /// origin.
    pub(super) fn new(rows: usize, double: bool, path: &'a Path) -> Self {
        let cloud = PointFile { points: Vec::with_capacity(rows), ..PointFile::default() };
        Self { cloud, path, choose_origin: double }
    }

    /// Validates and appends a row.
    pub(super) fn push(&mut self, row: &Row) -> Result<(), FileError> {
        let position = DVec3::from(row.position);
        if self.choose_origin && position.is_finite() {
            self.choose_origin = false;
            if position.abs().max_element() > FAR_FROM_ZERO_M {
                self.cloud.origin = position.round();
            }
        }
        let local = (position - self.cloud.origin).to_array().map(|v| v as f32);
        if !local.iter().all(|v| v.is_finite()) {
            // The color and class of a row that is never rendered do not matter.
            self.cloud.non_finite += 1;
            self.cloud.points.push(Point { position: [f32::NAN; 3], rgb_class: 0 });
            return Ok(());
        }
        let class = self.class(row.class)?;
        let [r, g, b] = row.rgb;
        let rgb = [self.level(r)?, self.level(g)?, self.level(b)?];
        self.cloud.points.push(Point::new(local, rgb, class));
        Ok(())
    }

    pub(super) fn finish(self) -> PointFile {
        self.cloud
    }

    fn level(&self, value: f64) -> Result<u8, FileError> {
        if (0.0..=255.0).contains(&value) {
            return Ok(value.round() as u8);
        }
        Err(self.off("colors of 0 to 255", value))
    }

    fn class(&self, value: f64) -> Result<u8, FileError> {
        if (0.0..=255.0).contains(&value) && value.fract() == 0.0 {
            return Ok(value as u8);
        }
        Err(self.off("an integer class of 0 to 255", value))
    }

    fn off(&self, expected: &str, value: f64) -> FileError {
        FileError::content(expected, format!("{value} in row {}", self.cloud.points.len()), self.path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn collect(double: bool, rows: &[Row]) -> Result<PointFile, FileError> {
        let mut collector = RowCollector::new(rows.len(), double, Path::new("p.npy"));
        rows.iter().try_for_each(|row| collector.push(row))?;
        Ok(collector.finish())
    }

    const ROW: Row = Row { position: [1.0, 2.0, 3.0], rgb: [0.4, 254.6, 127.5], class: 2.0 };

    #[test]
    fn colors_round_to_the_nearest_level() {
        let cloud = collect(false, &[ROW]).unwrap();
        assert_eq!(cloud.points, [Point::new([1.0, 2.0, 3.0], [0, 255, 128], 2)]);
    }

    #[test]
    fn bad_colors_and_classes_name_their_row() {
        for (row, found) in [
            (Row { class: 1.5, ..ROW }, "integer class of 0 to 255, found 1.5 in row 1"),
            (Row { class: f64::NAN, ..ROW }, "found NaN in row 1"),
            (Row { class: -1.0, ..ROW }, "found -1 in row 1"),
            (Row { rgb: [0.0, 256.0, 0.0], ..ROW }, "colors of 0 to 255, found 256 in row 1"),
            (Row { rgb: [0.0, 0.0, f64::NAN], ..ROW }, "found NaN in row 1"),
        ] {
            let message = collect(false, &[ROW, row]).unwrap_err().to_string();
            assert!(message.contains(found) && message.ends_with("p.npy"), "{message}");
        }
    }

    #[test]
    fn rows_that_are_not_finite_keep_their_place() {
        let broken = Row { position: [0.0, f64::INFINITY, 0.0], rgb: [f64::NAN; 3], class: f64::NAN };
        let cloud = collect(false, &[broken, ROW]).unwrap();
        assert_eq!((cloud.points.len(), cloud.non_finite), (2, 1));
        assert!(cloud.points[0].position.iter().all(|v| v.is_nan()));
        assert_eq!(cloud.points[1].position, [1.0, 2.0, 3.0]);
    }

    #[test]
    fn double_precision_keeps_millimeters_at_utm_coordinates() {
        let row = Row { position: [664_430.123, 3_997_650.456, 606.789], ..ROW };
        let cloud = collect(true, &[row, row]).unwrap();
        let world =
            cloud.world_from_local().transform_point3(DVec3::from(cloud.points[1].position.map(f64::from)));
        assert!((world - DVec3::from(row.position)).length() < 1e-6, "{world}");
        assert_eq!(collect(true, &[ROW]).unwrap().origin, DVec3::ZERO);
    }
}
