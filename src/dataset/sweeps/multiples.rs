//! Rows of ten or more columns that look like two or more points: their parts are of other kinds, or copies.

use super::sample::{Sample, is_uniform};

/// Numbers of points as which a row may be read.
const POINTS: std::ops::RangeInclusive<usize> = 2..=4;
/// Number of rows for a judgement.
const MIN_ROWS: usize = 20;
/// Difference between shares of whole numbers, and of points near the LiDAR, that points of one sweep do not
/// have.
const OTHER_SHARE: f64 = 0.4;
/// Planar distance below which a point is near, meters: closer than the ego's own surface.
const NEAR_M: f32 = 1.5;
/// Share of rows that consist of copies.
const COPIES: f64 = 0.99;

/// Values of the points at one place of their rows.
#[derive(Default)]
struct Place {
    rows: usize,
    near: usize,
    columns: [Column; 5],
}

#[derive(Clone, Copy, Default)]
struct Column {
    finite: usize,
    whole: usize,
    first: Option<u32>,
    varies: bool,
}

/// Returns the number of columns if rows of `columns` values are certainly parts of wider rows.
pub(super) fn multiple(sample: &Sample, columns: usize) -> Option<usize> {
    POINTS.map(|points| points * columns).find(|wide| is_wide(sample, *wide, columns))
}

/// Returns whether the parts of wide rows are not points of one sweep. Beams of a LiDAR may alternate, so
/// their heights and the sizes of their rings do not count.
fn is_wide(sample: &Sample, wide: usize, columns: usize) -> bool {
    let mut places: Vec<Place> = (0..wide / columns).map(|_| Place::default()).collect();
    let (mut rows, mut copies) = (0, 0);
    for row in sample.rows(wide) {
        rows += 1;
        copies += usize::from(row.chunks_exact(columns).all(|part| part == &row[..columns]));
        places.iter_mut().zip(row.chunks_exact(columns)).for_each(|(place, part)| place.add(part));
    }
    let is_copied = rows >= MIN_ROWS && copies as f64 >= COPIES * rows as f64;
    is_copied || places[1..].iter().any(|place| place.differs(&places[0]))
}

impl Place {
    /// Adds a point, unless one value stands in place of its coordinates.
    fn add(&mut self, part: &[u32]) {
        let value = |i: usize| f32::from_bits(part[i]);
        if is_uniform(&part[..3]) || !(0..3).all(|i| value(i).is_finite()) {
            return;
        }
        self.rows += 1;
        self.near += usize::from(value(0).hypot(value(1)) < NEAR_M);
        for (column, word) in self.columns.iter_mut().zip(part) {
            let value = f32::from_bits(*word);
            column.finite += usize::from(value.is_finite());
            column.whole += usize::from(value.is_finite() && value.fract() == 0.0);
            column.varies |= *column.first.get_or_insert(*word) != *word;
        }
    }

    fn differs(&self, other: &Self) -> bool {
        let share = |part: usize, all: usize| part as f64 / all as f64;
        if self.rows < MIN_ROWS || other.rows < MIN_ROWS {
            return false;
        }
        // x, y and the intensity of a LiDAR vary at all of its beams, or at none.
        let is_fixed = |i: usize| self.columns[i].varies != other.columns[i].varies;
        let is_whole = |i: usize| {
            let (a, b) = (&self.columns[i], &other.columns[i]);
            a.finite.min(b.finite) >= MIN_ROWS
                && (share(a.whole, a.finite) - share(b.whole, b.finite)).abs() > OTHER_SHARE
        };
        [0, 1, 3].into_iter().any(is_fixed)
            || [0, 1, 3, 4].into_iter().any(is_whole)
            || (share(self.near, self.rows) - share(other.near, other.rows)).abs() > OTHER_SHARE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns rows of points around a LiDAR of four beams in turn, and what `more` adds to a row.
    fn sample(columns: usize, more: impl Fn(i64, &[f32]) -> Vec<f32>) -> Sample {
        let number =
            |i: i64, axis: i64, low: f64, high: f64| crate::hash::between(3, &[i, axis], low, high) as f32;
        let row = |i: i64| {
            let (x, y) = (number(i, 0, -60.0, 60.0), number(i, 1, -60.0, 60.0));
            let elevation = [-0.2, -0.1, 0.0, 0.1][i.rem_euclid(4) as usize];
            let ring = i.rem_euclid(4) as f32;
            [x, y, elevation * x.hypot(y), number(i, 3, 0.0, 255.0).floor(), ring][..columns].to_vec()
        };
        let rows = (0..500).map(row).enumerate();
        let all: Vec<f32> = rows.flat_map(|(i, row)| [row.clone(), more(i as i64, &row)].concat()).collect();
        let bytes: Vec<u8> = all.iter().flat_map(|v| v.to_le_bytes()).collect();
        let read = move |_: u64, _: usize| Ok(bytes.clone());
        Sample::whole(&read, all.len() as u64 * 4).unwrap()
    }

    #[test]
    fn points_of_a_sweep_are_not_wide_rows() {
        for columns in [4, 5] {
            assert_eq!(multiple(&sample(columns, |_, _| Vec::new()), columns), None);
        }
    }

    #[test]
    fn further_columns_are_not_points() {
        let normal = |i: i64, axis: i64| crate::hash::between(5, &[i, axis], -1.0, 1.0) as f32;
        type More<'a> = &'a dyn Fn(i64, &[f32]) -> Vec<f32>;
        let kinds: [More<'_>; 5] = [
            &|_, row| row.to_vec(),
            &|i, row| vec![i as f32 * 1e-5, 1.0, 0.0, 0.0, 17.0][..row.len()].to_vec(),
            &|i, row| (0..row.len() as i64).map(|axis| normal(i, axis)).collect(),
            &|i, row| {
                (0..row.len() as i64).map(|axis| normal(i, axis).abs() * 255.0).map(f32::floor).collect()
            },
            &|_, row| [&[row[0] * 0.9, row[1] * 0.9, row[2], 5.0], &row[4..]].concat(),
        ];
        for (k, more) in kinds.iter().enumerate() {
            for columns in [4, 5] {
                let two = sample(columns, more);
                assert_eq!(multiple(&two, columns), Some(2 * columns), "{k}");
            }
        }
        let three = sample(5, |_, row| [row, row].concat());
        assert_eq!(multiple(&three, 5), Some(15));
    }
}
