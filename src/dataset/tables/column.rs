//! Column values, whatever the width of the numbers.

use std::path::Path;

use arrow_array::cast::AsArray;
use arrow_array::types::{
    ArrowPrimitiveType, Float16Type, Float32Type, Float64Type, Int8Type, Int16Type, Int32Type, Int64Type,
    UInt8Type, UInt16Type, UInt32Type, UInt64Type,
};
use arrow_array::{Array, ArrayRef};
use arrow_schema::DataType;

use crate::error::FileError;

/// Column of a table, in batches.
pub(in crate::dataset) struct Column<'a> {
    name: String,
    parts: Vec<&'a ArrayRef>,
    path: &'a Path,
}

impl<'a> Column<'a> {
    pub(in crate::dataset) fn new(name: String, parts: Vec<&'a ArrayRef>, path: &'a Path) -> Self {
        Self { name, parts, path }
    }

    /// Returns floating-point numbers or integers of any width as `f64`.
    ///
    /// # Errors
    /// Fails if values have another type or are null.
    pub(in crate::dataset) fn numbers(&self) -> Result<Vec<f64>, FileError> {
        self.parts()?;
        self.numbers_or_nan()
    }

    /// Returns numbers as [`Column::numbers`]; null is NaN.
    ///
    /// # Errors
    /// Fails if values have another type.
    pub(in crate::dataset) fn numbers_or_nan(&self) -> Result<Vec<f64>, FileError> {
        let mut values = Vec::new();
        for part in &self.parts {
            let before = values.len();
            if !extend_numbers(&mut values, part) {
                return Err(self.wrong_type("numbers", part.data_type()));
            }
            if part.null_count() > 0 {
                let read = values[before..].iter_mut().enumerate();
                read.filter(|(row, _)| part.is_null(*row)).for_each(|(_, value)| *value = f64::NAN);
            }
        }
        Ok(values)
    }

    /// Returns integers of any width, or floats that are whole, as `i64`.
    ///
    /// # Errors
    /// Fails if values have another type, are null or do not fit into `i64`.
    pub(in crate::dataset) fn integers(&self) -> Result<Vec<i64>, FileError> {
        let (mut values, mut too_much) = (Vec::new(), None);
        for part in self.parts()? {
            let narrow = |wide: i128| {
                i64::try_from(wide).unwrap_or_else(|_| {
                    too_much = Some(wide);
                    i64::MAX
                })
            };
            if !extend_integers(&mut values, part, narrow) {
                values.extend(self.whole_floats(part)?);
            }
        }
        if let Some(value) = too_much {
            let found = format!("{value} in column {}", self.name);
            return Err(FileError::content("integers below 2^63", found, self.path));
        }
        Ok(values)
    }

    /// Returns integers from 0 to 2³² − 1.
    ///
    /// # Errors
    /// Fails as [`Column::integers`], or if a value is out of range.
    pub(in crate::dataset) fn counts(&self) -> Result<Vec<u32>, FileError> {
        let count = |value: i64| {
            let found = || format!("{value} in column {}", self.name);
            u32::try_from(value)
                .map_err(|_| FileError::content("integers from 0 to 2^32 - 1", found(), self.path))
        };
        self.integers()?.into_iter().map(count).collect()
    }

    /// Returns whole numbers from 0 to 2³² − 1 of any type; `None` for other values.
    pub(in crate::dataset) fn known_counts(&self) -> Vec<Option<u32>> {
        let mut values = Vec::new();
        for part in &self.parts {
            let mut numbers = Vec::new();
            if !extend_numbers(&mut numbers, part) {
                numbers = vec![f64::NAN; part.len()];
            }
            values.extend(numbers.into_iter().enumerate().map(|(row, number)| {
                let is_count = number.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&number);
                (is_count && part.is_valid(row)).then_some(number as u32)
            }));
        }
        values
    }

    /// Returns strings.
    ///
    /// # Errors
    /// Fails if values have another type or are null.
    pub(in crate::dataset) fn texts(&self) -> Result<Vec<&'a str>, FileError> {
        let mut values = Vec::new();
        for part in self.parts()? {
            match part.data_type() {
                DataType::Utf8 => values.extend(part.as_string_opt::<i32>().into_iter().flatten().flatten()),
                DataType::LargeUtf8 => {
                    values.extend(part.as_string_opt::<i64>().into_iter().flatten().flatten());
                }
                DataType::Utf8View => {
                    values.extend(part.as_string_view_opt().into_iter().flatten().flatten())
                }
                other => return Err(self.wrong_type("texts", other)),
            }
        }
        Ok(values)
    }

    /// Returns the values of a float batch; all must be whole numbers up to 2⁵³.
    fn whole_floats(&self, part: &ArrayRef) -> Result<Vec<i64>, FileError> {
        let mut numbers = Vec::new();
        if !extend_numbers(&mut numbers, part) {
            return Err(self.wrong_type("integers", part.data_type()));
        }
        let is_whole = |number: &f64| number.fract() == 0.0 && number.abs() <= (1_i64 << 53) as f64;
        if let Some(other) = numbers.iter().find(|number| !is_whole(number)) {
            let found = format!("{other} in column {}", self.name);
            return Err(FileError::content("integers, or whole floats up to 2^53", found, self.path));
        }
        Ok(numbers.into_iter().map(|number| number as i64).collect())
    }

    /// The batches.
    pub(super) fn all(&self) -> &[&'a ArrayRef] {
        &self.parts
    }

    /// Returns the batches after checking that they contain no nulls.
    fn parts(&self) -> Result<&[&'a ArrayRef], FileError> {
        match self.parts.iter().map(|p| p.null_count()).sum::<usize>() {
            0 => Ok(&self.parts),
            empty => {
                let found = format!("{empty} empty ones");
                Err(FileError::content(
                    format!("a value in every row of column {}", self.name),
                    found,
                    self.path,
                ))
            }
        }
    }

    pub(super) fn wrong_type(&self, expected: &str, found: &DataType) -> FileError {
        self.wrong(expected.to_owned(), format!("type {found}"))
    }

    /// Creates an error about the column.
    pub(in crate::dataset) fn wrong(&self, expected: String, found: String) -> FileError {
        FileError::content(format!("{expected} in column {}", self.name), found, self.path)
    }
}

/// Appends numbers of any type. Returns `false` for values of other types.
pub(super) fn extend_numbers(values: &mut Vec<f64>, part: &dyn Array) -> bool {
    match part.data_type() {
        DataType::Float16 => extend::<Float16Type, _>(values, part, f64::from),
        DataType::Float32 => extend::<Float32Type, _>(values, part, f64::from),
        DataType::Float64 => extend::<Float64Type, _>(values, part, |v| v),
        _ => return extend_integers(values, part, |v| v as f64),
    }
    true
}

/// Appends integers of any width, converted by `to`. Returns `false` for values of other types.
pub(super) fn extend_integers<T>(
    values: &mut Vec<T>,
    part: &dyn Array,
    mut to: impl FnMut(i128) -> T,
) -> bool {
    match part.data_type() {
        DataType::Int8 => extend::<Int8Type, _>(values, part, |v| to(v.into())),
        DataType::Int16 => extend::<Int16Type, _>(values, part, |v| to(v.into())),
        DataType::Int32 => extend::<Int32Type, _>(values, part, |v| to(v.into())),
        DataType::Int64 => extend::<Int64Type, _>(values, part, |v| to(v.into())),
        DataType::UInt8 => extend::<UInt8Type, _>(values, part, |v| to(v.into())),
        DataType::UInt16 => extend::<UInt16Type, _>(values, part, |v| to(v.into())),
        DataType::UInt32 => extend::<UInt32Type, _>(values, part, |v| to(v.into())),
        DataType::UInt64 => extend::<UInt64Type, _>(values, part, |v| to(v.into())),
        _ => return false,
    }
    true
}

fn extend<P: ArrowPrimitiveType, T>(
    values: &mut Vec<T>,
    part: &dyn Array,
    mut to: impl FnMut(P::Native) -> T,
) {
    values.extend(part.as_primitive_opt::<P>().into_iter().flat_map(|p| p.values()).map(|v| to(*v)));
}
