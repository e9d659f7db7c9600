//! Columns of lists, of vectors, and of values that may be empty.

use arrow_array::cast::AsArray;
use arrow_array::{Array, ArrayRef};
use arrow_schema::DataType;

use super::column::{Column, extend_integers, extend_numbers};
use crate::error::FileError;

impl<'a> Column<'a> {
    /// Returns integers of any width, those above 2⁶³ − 1 as that number; `None` for empty rows.
    ///
    /// # Errors
    /// Fails if values have another type.
    pub(in crate::dataset) fn integers_or_none(&self) -> Result<Vec<Option<i64>>, FileError> {
        self.rows("integers", integers)
    }

    /// Returns vectors of `N` numbers; `None` for empty rows.
    ///
    /// # Errors
    /// Fails if values have another type or length.
    pub(in crate::dataset) fn vectors<const N: usize>(&self) -> Result<Vec<Option<[f64; N]>>, FileError> {
        self.rows(&format!("vectors of {N} numbers"), vectors)
    }

    /// Returns lists of vectors; an empty row is an empty list.
    ///
    /// # Errors
    /// Fails if values have another type or length.
    pub(in crate::dataset) fn vector_lists<const N: usize>(
        &self,
    ) -> Result<Vec<Vec<Option<[f64; N]>>>, FileError> {
        self.rows(&format!("lists of vectors of {N} numbers"), |part| lists(part, vectors))
    }

    /// Returns lists of integers; an empty row is an empty list.
    ///
    /// # Errors
    /// Fails if values have another type.
    pub(in crate::dataset) fn integer_lists(&self) -> Result<Vec<Vec<Option<i64>>>, FileError> {
        self.rows("lists of integers", |part| lists(part, integers))
    }

    /// Returns lists of texts; an empty row is an empty list.
    ///
    /// # Errors
    /// Fails if values have another type.
    pub(in crate::dataset) fn text_lists(&self) -> Result<Vec<Vec<Option<String>>>, FileError> {
        self.rows("lists of texts", |part| lists(part, texts))
    }

    /// Returns texts; `None` for empty rows.
    ///
    /// # Errors
    /// Fails if values have another type.
    pub(in crate::dataset) fn texts_or_none(&self) -> Result<Vec<Option<String>>, FileError> {
        self.rows("texts", texts)
    }

    /// Returns the bytes in a row of the first batch; `None` if it is empty.
    ///
    /// # Errors
    /// Fails if the column does not hold bytes, or has no such row.
    pub(in crate::dataset) fn bytes(&self, row: usize) -> Result<Option<&'a [u8]>, FileError> {
        let Some(part) = self.all().first().filter(|part| row < part.len()) else {
            return Err(self.wrong(format!("a row {row}"), "fewer rows".to_owned()));
        };
        if part.is_null(row) {
            return Ok(None);
        }
        match part.data_type() {
            DataType::Binary => Ok(part.as_binary_opt::<i32>().map(|all| all.value(row))),
            DataType::LargeBinary => Ok(part.as_binary_opt::<i64>().map(|all| all.value(row))),
            DataType::BinaryView => Ok(part.as_binary_view_opt().map(|all| all.value(row))),
            other => Err(self.wrong_type("bytes", other)),
        }
    }

    /// Converts all batches; `None` of `convert` means another type.
    fn rows<T>(
        &self,
        expected: &str,
        convert: impl Fn(&ArrayRef) -> Option<Vec<T>>,
    ) -> Result<Vec<T>, FileError> {
        let mut rows = Vec::new();
        for part in self.all() {
            rows.extend(convert(part).ok_or_else(|| self.wrong_type(expected, part.data_type()))?);
        }
        Ok(rows)
    }
}

fn integers(part: &ArrayRef) -> Option<Vec<Option<i64>>> {
    let mut values = Vec::with_capacity(part.len());
    let narrow = |wide: i128| Some(i64::try_from(wide).unwrap_or(i64::MAX));
    extend_integers(&mut values, part, narrow).then_some(())?;
    values.iter_mut().enumerate().filter(|(row, _)| part.is_null(*row)).for_each(|(_, value)| *value = None);
    Some(values)
}

fn texts(part: &ArrayRef) -> Option<Vec<Option<String>>> {
    let owned = |text: Option<&str>| text.map(str::to_owned);
    match part.data_type() {
        DataType::Utf8 => Some(part.as_string_opt::<i32>()?.iter().map(owned).collect()),
        DataType::LargeUtf8 => Some(part.as_string_opt::<i64>()?.iter().map(owned).collect()),
        DataType::Utf8View => Some(part.as_string_view_opt()?.iter().map(owned).collect()),
        _ => None,
    }
}

fn vectors<const N: usize>(part: &ArrayRef) -> Option<Vec<Option<[f64; N]>>> {
    let all = part.as_fixed_size_list_opt()?;
    if usize::try_from(all.value_length()) != Ok(N) {
        return None;
    }
    let mut numbers = Vec::new();
    extend_numbers(&mut numbers, all.values()).then_some(())?;
    let vector = |row: usize| {
        let start = all.value_offset_at(row);
        let whole = all.is_valid(row) && (start..start + N).all(|i| all.values().is_valid(i));
        numbers.get(start..start + N)?.try_into().ok().filter(|_| whole)
    };
    Some((0..all.len()).map(vector).collect())
}

fn lists<T>(part: &ArrayRef, convert: impl Fn(&ArrayRef) -> Option<Vec<T>>) -> Option<Vec<Vec<T>>> {
    let (offsets, values) = match part.data_type() {
        DataType::List(_) => {
            let all = part.as_list_opt::<i32>()?;
            (positions(all.value_offsets())?, all.values())
        }
        DataType::LargeList(_) => {
            let all = part.as_list_opt::<i64>()?;
            (positions(all.value_offsets())?, all.values())
        }
        _ => return None,
    };
    let (first, last) = (*offsets.first()?, *offsets.last()?);
    // Rows in a part of the batch: only their values.
    let mut values = convert(&values.slice(first, last.checked_sub(first)?))?.into_iter();
    let list = |(row, pair): (usize, &[usize])| {
        let list: Vec<T> = values.by_ref().take(pair[1].saturating_sub(pair[0])).collect();
        if part.is_null(row) { Vec::new() } else { list }
    };
    Some(offsets.windows(2).enumerate().map(list).collect())
}

fn positions<O: Copy + TryInto<usize>>(offsets: &[O]) -> Option<Vec<usize>> {
    offsets.iter().map(|offset| (*offset).try_into().ok()).collect()
}
