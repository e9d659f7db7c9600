//! Parquet files of one row group. Fields are required, and lists may be empty.

use std::sync::Arc;

use parquet::basic::Compression;
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::errors::Result;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::parser::parse_message_type;

/// Values of a schema leaf, in rows.
pub(super) enum Column {
    Bool(Vec<bool>),
    Int(Vec<i64>),
    Number(Vec<f64>),
    Text(Vec<String>),
    Numbers(Vec<Vec<f64>>),
    Texts(Vec<Vec<String>>),
}

/// Encodes a table. `columns` are the leaves of the schema in its order.
pub(super) fn encode(schema: &str, columns: &[Column]) -> Result<Vec<u8>> {
    let schema = Arc::new(parse_message_type(schema)?);
    let properties = WriterProperties::builder()
        .set_created_by("point-skeleton".to_owned())
        .set_compression(Compression::UNCOMPRESSED)
        .build();
    let mut file = SerializedFileWriter::new(Vec::new(), schema, Arc::new(properties))?;
    let mut rows = file.next_row_group()?;
    for column in columns {
        let Some(mut writer) = rows.next_column()? else { break };
        write(&mut writer, column)?;
        writer.close()?;
    }
    rows.close()?;
    file.into_inner()
}

fn write(writer: &mut SerializedColumnWriter<'_>, column: &Column) -> Result<()> {
    let text = |text: &String| ByteArray::from(text.as_bytes().to_vec());
    match column {
        Column::Bool(values) => writer.typed::<BoolType>().write_batch(values, None, None),
        Column::Int(values) => writer.typed::<Int64Type>().write_batch(values, None, None),
        Column::Number(values) => writer.typed::<DoubleType>().write_batch(values, None, None),
        Column::Text(values) => {
            let values: Vec<ByteArray> = values.iter().map(text).collect();
            writer.typed::<ByteArrayType>().write_batch(&values, None, None)
        }
        Column::Numbers(lists) => {
            let (defined, repeated) = levels(lists);
            let values = lists.concat();
            writer.typed::<DoubleType>().write_batch(&values, Some(&defined), Some(&repeated))
        }
        Column::Texts(lists) => {
            let (defined, repeated) = levels(lists);
            let values: Vec<ByteArray> = lists.iter().flatten().map(text).collect();
            writer.typed::<ByteArrayType>().write_batch(&values, Some(&defined), Some(&repeated))
        }
    }
    .map(|_| ())
}

/// Returns the definition and repetition levels of required lists: an empty list has one entry that is not
/// defined.
fn levels<T>(lists: &[Vec<T>]) -> (Vec<i16>, Vec<i16>) {
    let of_list = |list: &Vec<T>| {
        let defined = i16::from(!list.is_empty());
        (0..list.len().max(1)).map(move |i| (defined, i16::from(i > 0)))
    };
    lists.iter().flat_map(of_list).unzip()
}
