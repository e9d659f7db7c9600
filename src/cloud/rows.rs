use std::path::Path;

use glam::{DAffine3, DVec3};

use super::Point;
use crate::error::FileError;

/// Points of a file, in the order of its rows: point `i` is row `i`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointFile {
    /// Relative to [`PointFile::origin`]. A row with a coordinate that is not finite has NaN in all three, and so is
    /// never drawn.
    pub points: Vec<Point>,
    /// What was taken off the coordinates before they became `f32`, metres. Zero but for double precision far from
    /// zero.
    pub origin: DVec3,
    /// Rows with a coordinate that is NaN or infinite.
    pub non_finite: usize,
}

impl PointFile {
    /// Where the points stand: the translation by [`PointFile::origin`].
    pub fn world_from_local(&self) -> DAffine3 {
        DAffine3::from_translation(self.origin)
    }
}

/// Beyond this a step of `f32` is over half a millimetre, metres.
const FAR_FROM_ZERO_M: f64 = 4096.0;

/// One row as the file has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Row {
    /// Metres.
    pub(super) position: [f64; 3],
    /// 0 to 255.
    pub(super) rgb: [f64; 3],
    /// An integer of 0 to 255.
    pub(super) class: f64,
}

/// Checks rows and gathers them.
pub(super) struct RowCollector<'a> {
    cloud: PointFile,
    path: &'a Path,
    /// The origin is yet to be chosen.
    choose_origin: bool,
}

impl<'a> RowCollector<'a> {
    /// `double`: the file holds more than `f32`, so coordinates far from zero need an origin.
    pub(super) fn new(rows: usize, double: bool, path: &'a Path) -> Self {
        let cloud = PointFile { points: Vec::with_capacity(rows), ..PointFile::default() };
        Self { cloud, path, choose_origin: double }
    }

    /// Adds a row.
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
            // Color and class of a row that nobody sees are not worth an error.
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
    fn double_precision_keeps_millimetres_at_utm_coordinates() {
        let row = Row { position: [664_430.123, 3_997_650.456, 606.789], ..ROW };
        let cloud = collect(true, &[row, row]).unwrap();
        let world =
            cloud.world_from_local().transform_point3(DVec3::from(cloud.points[1].position.map(f64::from)));
        assert!((world - DVec3::from(row.position)).length() < 1e-6, "{world}");
        assert_eq!(collect(true, &[ROW]).unwrap().origin, DVec3::ZERO);
    }
}
