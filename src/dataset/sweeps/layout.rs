//! Layout of rows without a header, from their values.
//!
//! # How it works
//! A column has values of one kind: of both signs, whole, large. So the kinds repeat with the number of
//! columns as their period. With any other period, each column is a mixture of all kinds. Rows of one value
//! (zeros in place of returns) are left out, and the others come from the whole file (`sample`). `multiples`
//! tells wide rows from several points. Numbers of another type, read as floats, are of absurd sizes.

use std::path::Path;

use super::multiples::multiple;
use super::sample::{ReadAt, Sample, is_uniform};
use crate::error::FileError;
use crate::files::sniff;

/// Columns of a sweep in nuScenes layout: x, y, z, intensity, ring.
const COLUMNS: usize = 5;
/// Columns of a sweep without rings, as in KITTI.
const WITHOUT_RING: usize = 4;
/// Numbers of columns that are recognized, apart from multiples of four and five.
const PERIODS: [usize; 7] = [3, 4, 5, 6, 7, 8, 9];
/// Minimum number of values for a judgement.
const MIN_VALUES: usize = 320;
/// A period is certain if it explains this share of the differences, and this many times as much as five
/// columns.
const CLEAR_SHARE: f64 = 0.05;
const CLEAR_RATIO: f64 = 2.0;
/// Share of the explanation that a divisor of a period gives: six columns also repeat after twelve.
const SAME_SHARE: f64 = 0.8;

/// Sizes of numbers that a LiDAR measures, apart from zero: meters, intensities, times.
const PLAUSIBLE: std::ops::Range<f64> = 1e-10..1e5;
/// Sizes of integers, like millimeters.
const PLAUSIBLE_INTEGERS: std::ops::Range<f64> = 1.0..1e8;
/// Share of plausible numbers above which floats are certain, another type is certain, and floats are
/// possible.
const FLOATS: f64 = 0.95;
const OTHER_TYPE: f64 = 0.99;
const POSSIBLE: f64 = 0.5;

const EXPECTED: &str = "rows of 5 little-endian floats of 4 bytes (x y z intensity ring)";

/// Returns the number of `f32` columns in a file of `length` bytes, 5 or 4, from parts of it, or all of it if
/// these say too little.
///
/// # Errors
/// Fails if the file is empty or has one value only, its values have another layout or type or do not tell,
/// or its length is not a number of rows. Returns any error of `read`.
pub(in crate::dataset) fn columns(read: &ReadAt<'_>, length: u64, path: &Path) -> Result<usize, FileError> {
    if length == 0 {
        return Err(FileError::content("at least one point of 20 bytes", "an empty file", path));
    }
    let wrong = |found: String| Err(FileError::content(EXPECTED, found, path));
    let is_told = |sample: &Sample| sample.rows(COLUMNS).count() * COLUMNS >= MIN_VALUES;
    let mut sample = Sample::spread(read, length)?;
    if !sample.is_whole && !is_told(&sample) {
        sample = Sample::whole(read, length)?;
    }
    let values: Vec<u32> = sample.words().collect();
    if let Some(found) = single_value(&values, length) {
        return wrong(found);
    }
    // Few rows are judged by their length.
    let is_judged = values.len() >= MIN_VALUES;
    if let Some(found) = other_type(&sample).filter(|_| is_judged) {
        return wrong(found);
    }
    let found = if is_judged { period(&sample).filter(|_| is_told(&sample)) } else { Some(COLUMNS) };
    let is_whole = |columns: usize| length.is_multiple_of(4 * columns as u64);
    match found {
        None => wrong(format!("{length} bytes whose values do not tell the number of columns")),
        Some(COLUMNS) if is_whole(COLUMNS) => Ok(COLUMNS),
        Some(WITHOUT_RING) if is_whole(WITHOUT_RING) => Ok(WITHOUT_RING),
        Some(COLUMNS) => {
            let expected = "a multiple of 20 bytes (x y z intensity ring as f32)";
            Err(FileError::content(expected, format!("{length} bytes"), path))
        }
        Some(other) => wrong(format!("values that repeat every {other} floats, in {length} bytes")),
    }
}

/// Names the content of a file that repeats one value; `None` for others.
fn single_value(values: &[u32], length: u64) -> Option<String> {
    let value = *values.first().filter(|_| is_uniform(values))?;
    let zeros = || sniff::marked(&[0; sniff::HEAD_BYTES]).map(str::to_owned);
    let other = || Some(format!("nothing but the value {} in {length} bytes", f32::from_bits(value)));
    match value {
        0 if length.is_multiple_of(4) => zeros(),
        0 => None,
        _ => other().filter(|_| values.len() >= MIN_VALUES),
    }
}

/// Returns the number of columns: [`COLUMNS`] unless another one is certain; `None` if there are no columns.
fn period(sample: &Sample) -> Option<usize> {
    let shares = PERIODS.map(|columns| explained(sample, columns));
    let best = shares.into_iter().fold(0.0, f64::max);
    if best < CLEAR_SHARE {
        return None;
    }
    let own = PERIODS.iter().position(|columns| *columns == COLUMNS).map_or(0.0, |i| shares[i]);
    let fitting = PERIODS.iter().zip(shares).find(|(_, share)| *share >= SAME_SHARE * best);
    let is_own = best < CLEAR_RATIO * own;
    let columns = fitting.map_or(COLUMNS, |(columns, _)| if is_own { COLUMNS } else { *columns });
    let is_read = [COLUMNS, WITHOUT_RING].contains(&columns);
    Some(multiple(sample, columns).filter(|_| is_read).unwrap_or(columns))
}

/// Properties that tell columns apart.
fn traits(value: f32) -> [f64; 4] {
    let is = |yes: bool| f64::from(u8::from(yes));
    let size = if value.is_finite() { f64::from(value.abs().max(1e-2)).log2().min(8.0) / 8.0 } else { 0.0 };
    [is(value < 0.0), is(value.is_finite() && value.fract() == 0.0), is(value.is_finite()), size]
}

/// Returns the share of the differences in traits that are differences between columns, 0 to 1.
fn explained(sample: &Sample, columns: usize) -> f64 {
    let mut sums = vec![[0.0; 4]; columns];
    let (mut rows, mut squares) = (0.0, [0.0; 4]);
    for row in sample.rows(columns) {
        rows += 1.0;
        for (sum, word) in sums.iter_mut().zip(row) {
            for (t, value) in traits(f32::from_bits(*word)).into_iter().enumerate() {
                sum[t] += value;
                squares[t] += value * value;
            }
        }
    }
    let count = rows * columns as f64;
    let (mut between, mut all) = (0.0, 0.0);
    for t in 0..4 {
        let mean = sums.iter().map(|sum| sum[t]).sum::<f64>() / count;
        all += squares[t] / count - mean * mean;
        between += sums.iter().map(|sum| (sum[t] / rows - mean).powi(2)).sum::<f64>() / columns as f64;
    }
    if all > 1e-9 { between / all } else { 0.0 }
}

/// Returns the type of the numbers if it is certainly not little-endian `f32`.
fn other_type(sample: &Sample) -> Option<String> {
    let floats = plausible(sample.words().map(|bits| f64::from(f32::from_bits(bits))), PLAUSIBLE);
    if floats >= FLOATS {
        return None;
    }
    let double = |[low, high]: [u32; 2]| f64::from_bits(u64::from(high) << 32 | u64::from(low));
    let big = sample.words().map(|bits| f64::from(f32::from_bits(bits.swap_bytes())));
    let integers = sample.words().map(|bits| f64::from(bits.cast_signed()));
    if plausible(sample.pairs().map(double), PLAUSIBLE) >= OTHER_TYPE {
        return Some("floats of 8 bytes".to_owned());
    }
    if plausible(big, PLAUSIBLE) >= OTHER_TYPE {
        return Some("big-endian floats".to_owned());
    }
    if plausible(integers, PLAUSIBLE_INTEGERS) >= OTHER_TYPE {
        return Some("integers of 4 bytes".to_owned());
    }
    let percent = 100.0 * (1.0 - floats);
    (floats < POSSIBLE)
        .then(|| format!("values that no LiDAR measures ({percent:.0} % of all), of another type?"))
}

/// Returns the share of numbers that have a plausible size. Zeros and values that are not finite say nothing.
fn plausible(values: impl Iterator<Item = f64>, sizes: std::ops::Range<f64>) -> f64 {
    let (mut yes, mut all) = (0, 0);
    for value in values.filter(|v| v.is_finite() && *v != 0.0) {
        all += 1;
        yes += usize::from(sizes.contains(&value.abs()));
    }
    if all == 0 { 1.0 } else { yes as f64 / all as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns rows of points around a LiDAR: x y z intensity ring time, and further columns of whole
    /// numbers.
    fn rows(count: i64, columns: usize) -> Vec<f32> {
        let number =
            |i: i64, axis: i64, low: f64, high: f64| crate::hash::between(3, &[i, axis], low, high) as f32;
        let row = |i: i64| {
            let (x, y, z) = (number(i, 0, -60.0, 60.0), number(i, 1, -60.0, 60.0), number(i, 2, -2.0, 8.0));
            let whole = |axis: i64, most: f64| number(i, axis, 0.0, most).floor();
            [x, y, z, whole(3, 255.0), whole(4, 32.0), number(i, 5, 0.0, 0.1), whole(6, 4.0), whole(7, 9.0)]
        };
        (0..count).flat_map(|i| row(i).into_iter().take(columns)).collect()
    }

    fn bytes(values: &[f32]) -> Vec<u8> {
        values.iter().flat_map(|v| v.to_le_bytes()).collect()
    }

    fn judge(bytes: &[u8]) -> Result<usize, String> {
        let read = |start: u64, length: usize| Ok(bytes[start as usize..start as usize + length].to_vec());
        columns(&read, bytes.len() as u64, Path::new("a.bin")).map_err(|error| error.to_string())
    }

    #[test]
    fn five_and_four_columns_are_recognized_at_any_length() {
        for count in [500, 501, 502, 503, 504] {
            assert_eq!(judge(&bytes(&rows(count, 5))), Ok(5));
            assert_eq!(judge(&bytes(&rows(count, 4))), Ok(4));
        }
    }

    #[test]
    fn rejects_other_numbers_of_columns() {
        for columns in [3, 6, 7, 8] {
            for count in [500, 503] {
                let message = judge(&bytes(&rows(count, columns))).unwrap_err();
                assert!(message.contains(&format!("repeat every {columns} floats")), "{message}");
            }
        }
    }

    #[test]
    fn rejects_other_types() {
        let values = rows(500, 5);
        let double: Vec<u8> = values.iter().flat_map(|v| f64::from(*v).to_le_bytes()).collect();
        let exact: Vec<u8> = values.iter().flat_map(|v| (f64::from(*v) / 3.0).to_le_bytes()).collect();
        let big: Vec<u8> = values.iter().flat_map(|v| v.to_be_bytes()).collect();
        let whole: Vec<u8> = values.iter().flat_map(|v| ((*v * 1000.0) as i32).to_le_bytes()).collect();
        let half: Vec<u8> = values.iter().flat_map(|v| half::f16::from_f32(*v).to_le_bytes()).collect();
        for (bytes, found) in [
            (double, "floats of 8 bytes"),
            (exact, "floats of 8 bytes"),
            (big, "big-endian floats"),
            (whole, "integers of 4 bytes"),
            (half, "another type?"),
        ] {
            let message = judge(&bytes).unwrap_err();
            assert!(message.contains(found) && message.ends_with(": a.bin"), "{found}: {message}");
        }
    }

    #[test]
    fn unusual_columns_are_still_five() {
        let column = |i: usize, change: &dyn Fn(i64) -> f32| {
            let mut values = rows(600, 5);
            values.chunks_exact_mut(5).enumerate().for_each(|(row, v)| v[i] = change(row as i64));
            judge(&bytes(&values))
        };
        for (i, change) in [
            (4, &(|_| f32::NAN) as &dyn Fn(i64) -> f32),
            (3, &|_| f32::NAN),
            (4, &|_| -1.0),
            (4, &|_| 1.0),
            (3, &|_| 100.0),
            (4, &|row| (row % 4) as f32),
            (4, &|row| row as f32 * 1e-4),
            (3, &|row| (row % 100) as f32 / 100.0),
            (4, &|row| if row % 2 == 0 { f32::NAN } else { 3.0 }),
        ] {
            assert_eq!(column(i, change), Ok(5));
        }
        // Points without a return, far away.
        let mut values = rows(600, 5);
        values.chunks_exact_mut(10).for_each(|v| v[..3].fill(1e30));
        assert_eq!(judge(&bytes(&values)), Ok(5));
    }

    #[test]
    fn few_rows_are_judged_by_their_length() {
        assert_eq!(judge(&bytes(&rows(3, 5))), Ok(5));
        assert!(judge(&[0; 33]).unwrap_err().contains("a multiple of 20 bytes"));
        assert!(judge(&[]).unwrap_err().contains("an empty file"));
    }

    /// Zeros in place of returns, in front of the points or between them.
    #[test]
    fn rows_of_zeros_do_not_decide() {
        for (count, zeros) in [(3000, 9000), (3000, 20_000), (300, 60_000)] {
            for columns in [4, 5] {
                let head = vec![0.0; zeros * columns];
                let own = rows(count, columns);
                assert_eq!(judge(&bytes(&[head.clone(), own.clone()].concat())), Ok(columns));
                assert_eq!(judge(&bytes(&[own, head].concat())), Ok(columns));
            }
            let message = judge(&bytes(&[vec![0.0; zeros * 6], rows(count, 6)].concat())).unwrap_err();
            assert!(message.contains("repeat every 6 floats"), "{message}");
            let double = rows(count, 5).into_iter().flat_map(|v| f64::from(v).to_le_bytes());
            let message = judge(&[vec![0; zeros * 40], double.collect()].concat()).unwrap_err();
            assert!(message.contains("floats of 8 bytes"), "{message}");
        }
        for share in [0.5, 0.8, 0.9] {
            let mut values = rows(20_000, 4);
            let is_zero = |row: usize| crate::hash::between(9, &[row as i64], 0.0, 1.0) < share;
            values
                .chunks_exact_mut(4)
                .enumerate()
                .filter(|(row, _)| is_zero(*row))
                .for_each(|(_, v)| v.fill(0.0));
            assert_eq!(judge(&bytes(&values)), Ok(4), "{share}");
        }
    }

    #[test]
    fn rejects_inconclusive_values() {
        let message = judge(&[0; 20_000]).unwrap_err();
        assert!(message.contains("zero bytes (a download that was cut off?)"), "{message}");
        let message = judge(&[0xff; 20_000]).unwrap_err();
        assert!(message.contains("nothing but the value NaN in 20000 bytes"), "{message}");
        // A few points in a large file.
        let message = judge(&bytes(&[vec![0.0; 90_000], rows(20, 5)].concat())).unwrap_err();
        assert!(message.contains("do not tell the number of columns"), "{message}");
        // One kind of values everywhere.
        let alike: Vec<f32> = (0..5000).map(|i| crate::hash::between(3, &[i], -9.0, 9.0) as f32).collect();
        let message = judge(&bytes(&alike)).unwrap_err();
        assert!(message.contains("do not tell the number of columns"), "{message}");
    }
}
