//! Features of points: columns of numbers.

use half::f16;

/// Number types of features.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F16,
    F32,
    F64,
}

impl Kind {
    /// Bytes of a number.
    pub(super) fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 | Self::F16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    /// Decodes little-endian bytes of this type's length.
    fn decode(self, bytes: &[u8]) -> f64 {
        let mut wide = [0; 8];
        wide[..bytes.len()].copy_from_slice(bytes);
        let number = u64::from_le_bytes(wide);
        match self {
            Self::U8 | Self::U16 | Self::U32 | Self::U64 => number as f64,
            Self::I8 => f64::from(number as i8),
            Self::I16 => f64::from(number as i16),
            Self::I32 => f64::from(number as i32),
            Self::I64 => number as i64 as f64,
            Self::F16 => f16::from_bits(number as u16).to_f64(),
            Self::F32 => f64::from(f32::from_bits(number as u32)),
            Self::F64 => f64::from_bits(number),
        }
    }
}

/// Little-endian numbers at equal distances, one per point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Column<'a> {
    kind: Kind,
    /// From the first number; shorter by whole numbers where rows are missing.
    bytes: &'a [u8],
    /// Bytes from a number to the next.
    stride: usize,
}

impl<'a> Column<'a> {
    /// Creates a column of numbers that follow each other.
    pub(super) fn new(kind: Kind, bytes: &'a [u8]) -> Self {
        Self { kind, bytes, stride: kind.bytes() }
    }

    /// Creates a column of numbers that lie `stride` bytes apart, at least their length.
    pub(super) fn strided(kind: Kind, bytes: &'a [u8], stride: usize) -> Self {
        Self { kind, bytes, stride }
    }

    /// Returns the numbers.
    pub(super) fn numbers(self) -> impl Iterator<Item = f64> {
        let width = self.kind.bytes();
        let rows = self.bytes.chunks(self.stride).filter_map(move |row| row.get(..width));
        rows.map(move |bytes| self.kind.decode(bytes))
    }
}

/// Appends numbers that are integers in the range of `T`.
///
/// # Errors
/// Returns the first number that is not.
pub(super) fn extend_integers<T: TryFrom<u32>>(values: &mut Vec<T>, column: &Column<'_>) -> Result<(), f64> {
    for number in column.numbers() {
        // The cast saturates, and NaN becomes 0.
        let integer = number as u32;
        let is_exact = f64::from(integer) == number;
        let value = is_exact.then(|| T::try_from(integer).ok()).flatten();
        values.push(value.ok_or(number)?);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Oracle: Rust's own conversions of the same numbers.
    #[test]
    fn numbers_of_every_type_are_decoded() {
        let bytes = |kind: Kind| match kind {
            Kind::U8 => vec![7, 250],
            Kind::I8 => [7_i8, -6].map(i8::to_le_bytes).concat(),
            Kind::U16 => [7_u16, 65_530].map(u16::to_le_bytes).concat(),
            Kind::I16 => [7_i16, -6].map(i16::to_le_bytes).concat(),
            Kind::U32 => [7, u32::MAX].map(u32::to_le_bytes).concat(),
            Kind::I32 => [7, i32::MIN].map(i32::to_le_bytes).concat(),
            Kind::U64 => [7, 1_u64 << 63].map(u64::to_le_bytes).concat(),
            Kind::I64 => [7, i64::MIN].map(i64::to_le_bytes).concat(),
            Kind::F16 => [7.0, -0.5].map(|v| f16::from_f64(v).to_le_bytes()).concat(),
            Kind::F32 => [7.0_f32, -0.1].map(f32::to_le_bytes).concat(),
            Kind::F64 => [7.0, -0.1].map(f64::to_le_bytes).concat(),
        };
        let second = [
            (Kind::U8, 250.0),
            (Kind::I8, -6.0),
            (Kind::U16, 65_530.0),
            (Kind::I16, -6.0),
            (Kind::U32, 4_294_967_295.0),
            (Kind::I32, -2_147_483_648.0),
            (Kind::U64, 9_223_372_036_854_775_808.0),
            (Kind::I64, -9_223_372_036_854_775_808.0),
            (Kind::F16, -0.5),
            (Kind::F32, f64::from(-0.1_f32)),
            (Kind::F64, -0.1),
        ];
        for (kind, value) in second {
            let numbers: Vec<f64> = Column::new(kind, &bytes(kind)).numbers().collect();
            assert_eq!(numbers, [7.0, value], "{kind:?}");
        }
    }

    #[test]
    fn integers_out_of_range_are_refused() {
        let of = |values: &[f64]| {
            let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
            let mut integers = Vec::<u8>::new();
            extend_integers(&mut integers, &Column::new(Kind::F64, &bytes)).map(|()| integers)
        };
        assert_eq!(of(&[0.0, 255.0]), Ok(vec![0, 255]));
        for value in [-1.0, 256.0, 0.5, 4_294_967_296.0, f64::INFINITY] {
            assert_eq!(of(&[3.0, value]), Err(value));
        }
        assert!(of(&[f64::NAN]).is_err_and(f64::is_nan));
    }
}
