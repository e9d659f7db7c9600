//! Tables of Arrow columns with MessagePack as metadata.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use arrow_array::builder::{FixedSizeListBuilder, Float64Builder, ListBuilder, StringBuilder};
use arrow_array::types::{ArrowPrimitiveType, Float64Type};
use arrow_array::{
    ArrayRef, BinaryArray, FixedSizeListArray, Int64Array, ListArray, RecordBatch, StringArray,
};
use arrow_ipc::CompressionType;
use arrow_ipc::writer::{FileWriter, IpcWriteOptions};
use serde_json::Value;

use super::packed;

/// Columns of a table, with their names.
pub type Columns = Vec<(String, ArrayRef)>;

/// Table of a log. The names of its columns begin with its key.
#[derive(Clone, Debug)]
pub struct Table {
    pub columns: Columns,
    /// MessagePack of the schema; `None` for a table without metadata.
    pub metadata: Option<Vec<u8>>,
    pub compression: Option<CompressionType>,
    /// Number of batches into which rows are divided.
    pub batches: usize,
}

impl Table {
    /// Returns an uncompressed table of one batch; names are completed by `prefix`.
    pub fn new(prefix: &str, columns: Vec<(&str, ArrayRef)>, metadata: &Value) -> Self {
        let columns = columns.into_iter().map(|(name, values)| (format!("{prefix}{name}"), values)).collect();
        Self { columns, metadata: Some(packed(metadata)), compression: None, batches: 1 }
    }

    /// Replaces the column whose name ends with a text.
    #[track_caller]
    pub fn set(&mut self, ending: &str, values: ArrayRef) {
        self.columns.iter_mut().find(|(name, _)| name.ends_with(ending)).unwrap().1 = values;
    }

    /// Removes the column whose name ends with a text.
    #[track_caller]
    pub fn remove(&mut self, ending: &str) {
        let at = self.columns.iter().position(|(name, _)| name.ends_with(ending)).unwrap();
        self.columns.remove(at);
    }

    /// Changes the metadata, which must have texts as keys.
    pub fn about(&mut self, edit: impl FnOnce(&mut Value)) {
        let mut value = rmp_serde::from_slice(self.metadata.as_ref().unwrap()).unwrap();
        edit(&mut value);
        self.metadata = Some(packed(&value));
    }

    /// Writes the table.
    ///
    /// # Errors
    /// Fails if columns have different lengths or equal names.
    pub fn write(&self, path: &Path) -> Result<(), Box<dyn std::error::Error>> {
        let batch = RecordBatch::try_from_iter(self.columns.clone())?;
        let blank = self.metadata.as_ref().map(|bytes| "\u{7f}".repeat(bytes.len()));
        let entries = blank.iter().map(|text| ("metadata".to_owned(), text.clone()));
        let schema = batch.schema().as_ref().clone().with_metadata(entries.collect::<HashMap<_, _>>());
        let options = IpcWriteOptions::default().try_with_compression(self.compression)?;
        let mut writer = FileWriter::try_new_with_options(Vec::new(), &schema, options)?;
        for part in 0..self.batches {
            let at = |part: usize| batch.num_rows() * part / self.batches;
            writer.write(&batch.slice(at(part), at(part + 1) - at(part)))?;
        }
        writer.finish()?;
        let mut file = writer.into_inner()?;
        if let (Some(blank), Some(metadata)) = (blank, &self.metadata) {
            replace(&mut file, blank.as_bytes(), metadata);
        }
        Ok(std::fs::write(path, file)?)
    }
}

/// Replaces the text in the schema and in the footer of a file: Arrow's writer takes only UTF-8.
fn replace(file: &mut [u8], blank: &[u8], metadata: &[u8]) {
    // Texts follow their length.
    let stored = |text: &[u8]| [&(text.len() as u32).to_le_bytes(), text].concat();
    let (old, new) = (stored(blank), stored(metadata));
    let places: Vec<usize> =
        (0..=file.len() - old.len()).filter(|at| file[*at..].starts_with(&old)).collect();
    assert_eq!(places.len(), 2, "places of the metadata");
    places.into_iter().for_each(|at| file[at..at + new.len()].copy_from_slice(&new));
}

pub fn integers<T: Into<Option<i64>>>(values: impl IntoIterator<Item = T>) -> ArrayRef {
    Arc::new(Int64Array::from_iter(values.into_iter().map(Into::into)))
}

pub fn texts<'a, T: Into<Option<&'a str>>>(values: impl IntoIterator<Item = T>) -> ArrayRef {
    Arc::new(StringArray::from_iter(values.into_iter().map(Into::into)))
}

pub fn binaries<'a, T: Into<Option<&'a [u8]>>>(values: impl IntoIterator<Item = T>) -> ArrayRef {
    Arc::new(BinaryArray::from_iter(values.into_iter().map(Into::into)))
}

/// Returns vectors of `N` numbers.
pub fn vectors<const N: usize, T: Into<Option<[f64; N]>>>(values: impl IntoIterator<Item = T>) -> ArrayRef {
    let rows = values.into_iter().map(|row| row.into().map(|row| row.map(Some)));
    Arc::new(FixedSizeListArray::from_iter_primitive::<Float64Type, _, _>(rows, N as i32))
}

pub fn vector_lists<const N: usize>(rows: &[Vec<[f64; N]>]) -> ArrayRef {
    let mut lists = ListBuilder::new(FixedSizeListBuilder::new(Float64Builder::new(), N as i32));
    for row in rows {
        for vector in row {
            lists.values().values().append_slice(vector);
            lists.values().append(true);
        }
        lists.append(true);
    }
    Arc::new(lists.finish())
}

pub fn integer_lists<T: ArrowPrimitiveType>(rows: impl IntoIterator<Item = Vec<T::Native>>) -> ArrayRef {
    let rows = rows.into_iter().map(|row| Some(row.into_iter().map(Some)));
    Arc::new(ListArray::from_iter_primitive::<T, _, _>(rows))
}

pub fn text_lists(rows: &[Vec<&str>]) -> ArrayRef {
    let mut lists = ListBuilder::new(StringBuilder::new());
    rows.iter().for_each(|row| lists.append_value(row.iter().copied().map(Some)));
    Arc::new(lists.finish())
}
