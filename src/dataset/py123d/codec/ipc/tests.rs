use std::sync::Arc;

use arrow_array::types::Int8Type;
use arrow_array::{
    ArrayRef, BooleanArray, DictionaryArray, Float16Array, Float32Array, Float64Array, Int64Array,
    RecordBatch, StringArray, UInt8Array,
};
use arrow_ipc::CompressionType;
use arrow_ipc::writer::{IpcWriteOptions, StreamWriter};
use arrow_schema::Schema;

use super::super::tests::{cloud, decoded, one_point};
use super::super::{Points, declared_points, decode};

/// Oracle: the numbers that py123d was given.
#[test]
fn streams_of_py123d_are_lossless() {
    for cell in [
        &include_bytes!("../cells/ipc")[..],
        include_bytes!("../cells/ipc_lz4"),
        include_bytes!("../cells/ipc_zstd"),
    ] {
        assert_eq!(decoded(cell), cloud(60));
    }
    assert_eq!(decoded(include_bytes!("../cells/ipc_none")), cloud(0));
    assert_eq!(decoded(include_bytes!("../cells/ipc_one")), one_point());
}

type Columns = Vec<(&'static str, ArrayRef)>;

fn floats(values: &[f32]) -> ArrayRef {
    Arc::new(Float32Array::from(values.to_vec()))
}

fn axes(values: &[f32]) -> Columns {
    ["x", "y", "z"].map(|name| (name, floats(values))).to_vec()
}

/// Writes batches of the same columns.
fn stream(batches: &[Columns], compression: Option<CompressionType>) -> Vec<u8> {
    let batches = batches.iter().map(|columns| RecordBatch::try_from_iter(columns.clone()).unwrap());
    let batches: Vec<RecordBatch> = batches.collect();
    let options = IpcWriteOptions::default().try_with_compression(compression).unwrap();
    let schema = batches.first().map_or_else(|| Arc::new(Schema::empty()), RecordBatch::schema);
    let mut writer = StreamWriter::try_new_with_options(Vec::new(), &schema, options).unwrap();
    batches.iter().for_each(|batch| writer.write(batch).unwrap());
    writer.into_inner().unwrap()
}

#[test]
fn batches_follow_each_other_and_positions_may_be_nan() {
    let one = |value: f32, id: u8| {
        let mut columns = axes(&[value]);
        columns.insert(1, ("ids", Arc::new(UInt8Array::from(vec![id]))));
        columns
    };
    let cell = stream(&[one(1.5, 7), one(f32::NAN, 9)], Some(CompressionType::LZ4_FRAME));
    let points = decoded(&cell);
    assert_eq!((points.xyz[0], points.ids), ([1.5; 3], Some(vec![7, 9])));
    assert!(points.xyz[1].iter().all(|v| v.is_nan()));
}

#[test]
fn features_that_are_not_read_may_have_any_type() {
    let mut columns = axes(&[2.0]);
    columns.insert(0, ("name", Arc::new(StringArray::from(vec!["car"]))));
    columns.insert(2, ("flag", Arc::new(BooleanArray::from(vec![true]))));
    columns.push(("class", Arc::new(DictionaryArray::<Int8Type>::from_iter([Some("car")]))));
    columns.push(("time", Arc::new(Int64Array::from(vec![None]))));
    let skipped = ["name", "flag", "class", "time"].map(str::to_owned).to_vec();
    let expected = Points { xyz: vec![[2.0; 3]], skipped, ..Points::default() };
    assert_eq!(decoded(&stream(&[columns], None)), expected);
}

/// Values that all three types hold exactly.
#[test]
fn positions_of_every_float_type_are_the_same() {
    let values = [2.5, -1024.0, 0.125];
    let half: ArrayRef = Arc::new(Float16Array::from_iter_values(values.map(half::f16::from_f32)));
    let double: ArrayRef = Arc::new(Float64Array::from_iter_values(values.map(f64::from)));
    for column in [half, double, floats(&values)] {
        let columns = ["x", "y", "z"].map(|name| (name, column.clone())).to_vec();
        assert_eq!(decode(&stream(&[columns], None)).unwrap().xyz, values.map(|value| [value; 3]));
    }
}

#[test]
fn other_columns_are_refused() {
    let with = |at: usize, name: &'static str, column: ArrayRef| {
        let mut columns = axes(&[2.0]);
        columns.truncate(at);
        columns.push((name, column));
        columns
    };
    let whole: ArrayRef = Arc::new(Int64Array::from(vec![2]));
    let empty: ArrayRef = Arc::new(UInt8Array::from(vec![None]));
    let text: ArrayRef = Arc::new(StringArray::from(vec!["2"]));
    let large: ArrayRef = Arc::new(Int64Array::from(vec![256]));
    let cases = [
        (axes(&[2.0])[..2].to_vec(), "no column z"),
        (with(2, "z", whole), "a column z of type I64"),
        (with(2, "z", text.clone()), "a column z of type Utf8"),
        (with(3, "x", floats(&[2.0])), "two columns x"),
        (with(3, "ids", empty), "a column ids with 1 empty values"),
        (with(3, "intensity", text), "a column intensity of type Utf8"),
        (with(3, "ids", large), "a feature ids of 256"),
    ];
    for (columns, found) in cases {
        assert_eq!(decode(&stream(&[columns], None)), Err(found.to_owned()));
    }
    assert_eq!(decode(&stream(&[], None)), Err("a stream without rows".to_owned()));
}

/// Cuts streams at every byte, and changes every byte: nothing may panic.
#[test]
fn damaged_streams_are_errors_or_points() {
    for cell in [&include_bytes!("../cells/ipc_one")[..], include_bytes!("../cells/ipc_zstd")] {
        // 8 bytes are the mark of the end, which may be missing.
        for length in 0..cell.len() - 8 {
            assert!(decode(&cell[..length]).is_err(), "{length}");
        }
        for at in 0..cell.len() {
            let mut cell = cell.to_vec();
            cell[at] ^= 0x81;
            if let Ok(points) = decode(&cell) {
                assert_eq!(declared_points(&cell), Ok(points.xyz.len() as u64));
            }
        }
    }
}

/// Oracle: the limits of the module.
#[test]
fn more_bytes_than_a_cell_can_hold_are_refused() {
    let zeros = vec![0.0; 4 << 20];
    let cell = stream(&[axes(&zeros)], Some(CompressionType::ZSTD));
    let expected = format!("columns that declare more than {} bytes in ", 16 << 20);
    for found in [decode(&cell).unwrap_err(), declared_points(&cell).unwrap_err()] {
        assert!(found.starts_with(&expected), "{found}");
    }
}
