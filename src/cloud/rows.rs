use std::path::Path;

use glam::{DAffine3, DVec3};

use super::Point;
use super::colors::{ColorRange, ColorScale, ColorValues};
use super::origin::{Precision, Votes, local_position};
use crate::error::FileError;
use crate::memory::{Need, Reservation, reserve};

/// Points of a file in row order: point `i` is row `i`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointFile {
    /// Points relative to [`PointFile::origin`]. A row with a non-finite coordinate has NaN in all three and
    /// is never rendered.
    pub points: Vec<Point>,
    /// Origin subtracted from the coordinates before conversion to `f32`, meters: see
    /// [`origin_of`](super::origin_of). Nonzero only for double precision far from zero.
    pub origin: DVec3,
    /// Number of rows with a NaN or infinite coordinate.
    pub non_finite: usize,
    /// Points whose coordinates lost more than 0.5 mm.
    pub precision: Precision,
    /// Sentences on content that is not plainly as the format says: scaled, renamed or missing colors, and
    /// points that lost precision.
    pub notes: Vec<String>,
}

impl PointFile {
    /// Returns the translation by [`PointFile::origin`].
    pub fn world_from_local(&self) -> DAffine3 {
        DAffine3::from_translation(self.origin)
    }
}

/// Row of a file, not validated yet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Row {
    /// Meters.
    pub(super) position: [f64; 3],
    /// Values as in the file.
    pub(super) rgb: [f64; 3],
    /// Integer of 0 to 255.
    pub(super) class: f64,
}

/// What a file declares of its rows.
#[derive(Clone, Copy, Debug)]
pub(super) struct RowFormat<'a> {
    /// Number of rows.
    pub(super) rows: usize,
    /// The coordinates have more precision than `f32`, so they need an origin far from zero.
    pub(super) double: bool,
    /// Color values.
    pub(super) colors: ColorValues,
    /// The file, for messages.
    pub(super) path: &'a Path,
}

/// Function that takes a row and returns whether it wants more.
pub(super) type Visit<'v> = dyn FnMut(&Row) -> Result<bool, FileError> + 'v;

/// Validates and converts the rows of a file. `each` passes all rows in order to a function, as long as it
/// wants more. It is called twice, since the origin and the range of colors depend on all rows.
///
/// # Errors
/// Returns any error of `each`. Fails if the points do not fit into memory, or if a color or a class is out
/// of range.
pub(super) fn collect(
    format: &RowFormat<'_>,
    mut each: impl FnMut(&mut Visit<'_>) -> Result<(), FileError>,
) -> Result<PointFile, FileError> {
    let _points = reserve_points(format)?;
    let (mut votes, mut range) = (Votes::default(), ColorRange::new(format.colors));
    let mut survey = |row: &Row| {
        let position = DVec3::from(row.position);
        if position.as_vec3().is_finite() {
            range.add(row.rgb);
            if format.double {
                votes.add(position);
            }
        }
        Ok(format.double || !range.is_settled())
    };
    if format.double || !ColorRange::new(format.colors).is_settled() {
        each(&mut survey)?;
    }
    let cloud =
        PointFile { points: Vec::with_capacity(format.rows), origin: votes.origin(), ..PointFile::default() };
    let mut collector = Collector { cloud, colors: range.scale(), bad_colors: 0, path: format.path };
    each(&mut |row| collector.push(row).map(|()| true))?;
    let Collector { mut cloud, bad_colors, .. } = collector;
    let origin = format.double.then_some(cloud.origin);
    cloud.notes.extend(range.note());
    if bad_colors > 0 {
        let (count, max) = (cloud.points.len(), range.scale().max());
        cloud.notes.push(format!(
            "colors of {bad_colors} of {count} points are not finite or just beyond 0 to {max}: black, or \
                the nearest level"
        ));
    }
    cloud.notes.extend(cloud.precision.note(cloud.points.len(), origin));
    Ok(cloud)
}

/// Reserves the memory of the points that a file declares.
fn reserve_points(format: &RowFormat<'_>) -> Result<Reservation, FileError> {
    let bytes = (size_of::<Point>() as u64).saturating_mul(format.rows as u64);
    let what = || format!("a cloud of {} points", format.rows);
    let need = || Need { what: what(), bytes, advice: "a file of fewer points needs less" };
    reserve(bytes, need).map_err(|error| FileError::io("read", format.path)(error.into()))
}

/// Converts rows to points.
struct Collector<'a> {
    cloud: PointFile,
    colors: ColorScale,
    /// Number of points with colors that are not finite, or out of range by less than half a level.
    bad_colors: usize,
    path: &'a Path,
}

impl Collector<'_> {
    /// Validates and appends a row.
    fn push(&mut self, row: &Row) -> Result<(), FileError> {
        let Some(local) = local_position(DVec3::from(row.position), self.cloud.origin) else {
            // The color and class of a row that is never rendered do not matter.
            self.cloud.non_finite += 1;
            self.cloud.points.push(Point { position: [f32::NAN; 3], rgb_class: 0 });
            return Ok(());
        };
        let class = self.class(row.class)?;
        let levels = row.rgb.map(|value| self.colors.level(value));
        let rgb = match levels {
            [Some(r), Some(g), Some(b)] => [r, g, b],
            _ => {
                self.bad_colors += 1;
                let [r, g, b] = row.rgb;
                [self.near_level(r)?, self.near_level(g)?, self.near_level(b)?]
            }
        };
        self.cloud.precision.add(local);
        self.cloud.points.push(Point::new(local, rgb, class));
        Ok(())
    }

    /// Returns the level of a value; values that are not finite count as black.
    fn near_level(&self, value: f64) -> Result<u8, FileError> {
        let expected = || format!("colors of 0 to {}", self.colors.max());
        let level = if value.is_finite() { self.colors.near_level(value) } else { Some(0) };
        level.ok_or_else(|| self.off(expected(), value))
    }

    fn class(&self, value: f64) -> Result<u8, FileError> {
        if (0.0..=255.0).contains(&value) && value.fract() == 0.0 {
            return Ok(value as u8);
        }
        Err(self.off("an integer class of 0 to 255".to_owned(), value))
    }

    fn off(&self, expected: String, value: f64) -> FileError {
        FileError::content(expected, format!("{value} in row {}", self.cloud.points.len()), self.path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn collected(double: bool, rows: &[Row]) -> Result<PointFile, FileError> {
        let path = Path::new("p.npy");
        let format = RowFormat { rows: rows.len(), double, colors: ColorValues::Levels, path };
        collect(&format, |visit| {
            for row in rows {
                if !visit(row)? {
                    break;
                }
            }
            Ok(())
        })
    }

    const ROW: Row = Row { position: [1.0, 2.0, 3.0], rgb: [0.4, 254.6, 127.5], class: 2.0 };

    #[test]
    fn colors_round_to_the_nearest_level() {
        let cloud = collected(false, &[ROW]).unwrap();
        assert_eq!(cloud.points, [Point::new([1.0, 2.0, 3.0], [0, 255, 128], 2)]);
    }

    #[test]
    fn bad_colors_and_classes_name_their_row() {
        for (row, found) in [
            (Row { class: 1.5, ..ROW }, "integer class of 0 to 255, found 1.5 in row 1"),
            (Row { class: f64::NAN, ..ROW }, "found NaN in row 1"),
            (Row { class: -1.0, ..ROW }, "found -1 in row 1"),
            (Row { rgb: [0.0, 256.0, 0.0], ..ROW }, "colors of 0 to 255, found 256 in row 1"),
            (Row { rgb: [0.0, -1.0, f64::NAN], ..ROW }, "colors of 0 to 255, found -1 in row 1"),
        ] {
            let message = collected(false, &[ROW, row]).unwrap_err().to_string();
            assert!(message.contains(found) && message.ends_with("p.npy"), "{message}");
        }
    }

    #[test]
    fn bad_colors_of_few_points_are_counted() {
        let rows = [
            Row { rgb: [1.0, 0.5, -1e-9], ..ROW },
            Row { rgb: [f64::NAN, 0.25, f64::INFINITY], ..ROW },
            Row { rgb: [0.0, 0.25, 1.0], ..ROW },
        ];
        let cloud = collected(false, &rows).unwrap();
        let colors: Vec<[u8; 3]> = cloud.points.iter().map(Point::rgb).collect();
        assert_eq!(colors, [[255, 128, 0], [0, 64, 0], [0, 64, 255]]);
        let note =
            "colors of 2 of 3 points are not finite or just beyond 0 to 1: black, or the nearest level";
        assert_eq!(cloud.notes, ["colors of 0 to 1, scaled to 0 to 255", note]);
        for (value, level) in [(255.4, Some(255)), (-0.4, Some(0)), (255.6, None), (-0.6, None)] {
            let cloud = collected(false, &[Row { rgb: [9.0, 9.0, value], ..ROW }]);
            assert_eq!(cloud.ok().map(|cloud| cloud.points[0].rgb()[2]), level, "{value}");
        }
    }

    #[test]
    fn rejects_more_points_than_fit_into_memory() {
        let format =
            RowFormat { rows: 1 << 50, double: true, colors: ColorValues::Levels, path: Path::new("p.npy") };
        let message = collect(&format, |_| panic!("read")).unwrap_err().to_string();
        let expected = "cannot read: a cloud of 1125899906842624 points needs 16.0 PiB of memory, but ";
        assert!(message.starts_with(expected) && message.ends_with(": p.npy"), "{message}");
    }

    #[test]
    fn colors_from_0_to_1_are_scaled_and_noted() {
        let rows = [Row { rgb: [1.0, 0.5, 0.0], ..ROW }, Row { rgb: [0.0, 0.25, 1.0], ..ROW }];
        let cloud = collected(false, &rows).unwrap();
        assert_eq!(cloud.points.iter().map(Point::rgb).collect::<Vec<_>>(), [[255, 128, 0], [0, 64, 255]]);
        assert_eq!(cloud.notes, ["colors of 0 to 1, scaled to 0 to 255"]);
        let bright = Row { rgb: [200.0, 0.0, 0.0], ..ROW };
        let cloud = collected(false, &[rows[0], rows[1], bright]).unwrap();
        assert_eq!((cloud.points[0].rgb(), cloud.notes.len()), ([1, 1, 0], 0));
    }

    #[test]
    fn non_finite_rows_keep_their_position() {
        let broken = Row { position: [0.0, f64::INFINITY, 0.0], rgb: [f64::NAN; 3], class: f64::NAN };
        let cloud = collected(false, &[broken, ROW]).unwrap();
        assert_eq!((cloud.points.len(), cloud.non_finite), (2, 1));
        assert!(cloud.points[0].position.iter().all(|v| v.is_nan()));
        assert_eq!(cloud.points[1].position, [1.0, 2.0, 3.0]);
    }

    #[test]
    fn double_precision_keeps_millimeters_at_utm_coordinates() {
        let row = Row { position: [664_430.123, 3_997_650.456, 606.789], ..ROW };
        let zero = Row { position: [0.0; 3], ..ROW };
        for rows in [[row, row], [zero, row]] {
            let cloud = collected(true, &rows).unwrap();
            let local = DVec3::from(cloud.points[1].position.map(f64::from));
            let world = cloud.world_from_local().transform_point3(local);
            assert!((world - DVec3::from(row.position)).length() < 1e-6, "{world}");
            assert_eq!(cloud.notes.len(), usize::from(rows[0] == zero), "{:?}", cloud.notes);
        }
        assert_eq!(collected(true, &[ROW]).unwrap().origin, DVec3::ZERO);
    }

    #[test]
    fn points_far_from_the_origin_are_counted() {
        let far = Row { position: [664_430.123, 3_997_650.456, 606.789], ..ROW };
        let cloud = collected(false, &[ROW, far]).unwrap();
        assert_eq!((cloud.origin, cloud.precision.far_points), (DVec3::ZERO, 1));
        assert!(cloud.notes[0].contains("1 of 2 points lie more than 16384 m from zero in single precision"));
    }
}
