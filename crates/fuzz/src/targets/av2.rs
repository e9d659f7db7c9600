//! Argoverse 2: Feather files and maps.

use std::cell::RefCell;
use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use arrow_array::{
    ArrayRef, BooleanArray, Float16Array, Float32Array, Float64Array, Int64Array, NullArray, RecordBatch,
    StringArray, UInt8Array, UInt64Array,
};
use arrow_ipc::CompressionType;
use arrow_ipc::writer::{FileWriter, IpcWriteOptions};
use half::f16;
use point_skeleton::dataset::av2::{Argoverse, read_map_file};
use point_skeleton::dataset::{LogLocator, LogReader};
use serde_json::Value;

use super::{LARGE, Scratch, edit_seeds, seed};
use crate::check::{assert_names_file, assert_names_file_in, check_map, dataset};
use crate::choices::Choices;
use crate::edits::json_file;
use crate::folder::Folder;
use crate::synthetic_log::SyntheticLog;
use crate::{Memory, Seed, Target};
use pskel_testing::av2_log::{Columns, LOG_ID, TinyAv2, map as map_json, read, sweep};

/// A small file may declare 16 MiB; each byte may become an eight-byte number, and part of a pose.
const UNPACKED: Memory = Memory { fixed: 512 << 20, factor: 1000 };

pub(super) const TARGETS: [Target; 3] = [
    Target { name: "av2_files", run: files, seeds: file_seeds, max_len: 16_384, memory: UNPACKED },
    Target { name: "av2_columns", run: columns, seeds: column_seeds, max_len: 512, memory: LARGE },
    Target { name: "av2_map", run: map, seeds: map_seeds, max_len: 16_384, memory: LARGE },
];

thread_local! {
    static LOG: RefCell<Folder> = RefCell::new(log());
    static MAP: RefCell<(Scratch, Value, SyntheticLog)> =
        RefCell::new((Scratch::new(), map_json(), SyntheticLog::new(3)));
}

fn names() -> [String; 5] {
    let names = [
        "annotations.feather",
        "city_SE3_egovehicle.feather",
        "calibration/intrinsics.feather",
        "calibration/egovehicle_SE3_sensor.feather",
        &sweep(0),
    ];
    names.map(|name| format!("{LOG_ID}/{name}"))
}

/// Returns a log whose sweeps have few points.
fn log() -> Folder {
    let synthetic = TinyAv2::new();
    let path = synthetic.path(&sweep(0));
    let few = read(&path).into_iter().map(|(name, values)| (name, values.slice(0, 20))).collect();
    write(&path, few, Some(CompressionType::ZSTD), 1).expect("a sweep to write");
    Folder::copy_of(synthetic.root())
}

fn open(folder: &Folder, data: &[u8]) {
    match Argoverse::open(&LogLocator::new(&point_skeleton::dataset::av2::FORMAT, folder.path(LOG_ID))) {
        Ok(log) => dataset(&log, folder.root(), data),
        Err(error) => assert_names_file_in(error, folder.root(), data),
    }
}

/// Replaces the file selected by the first byte with the remaining bytes.
fn files(data: &[u8]) {
    LOG.with_borrow_mut(|folder| {
        let (number, bytes) = data.split_first().unwrap_or((&0, &[]));
        folder.put(&names()[usize::from(*number) % 5], bytes);
        open(folder, data);
        folder.reset();
    });
}

fn file_seeds() -> Vec<Seed> {
    let folder = log();
    let of = |(number, name): (usize, &String)| {
        let stem = Path::new(name).file_stem().map(|stem| stem.to_string_lossy().into_owned());
        seed(&stem.unwrap_or_default(), [&[number as u8], folder.base(name)].concat())
    };
    names().iter().enumerate().map(of).collect()
}

/// Changes the columns of a file.
fn columns(data: &[u8]) {
    LOG.with_borrow_mut(|folder| {
        let mut choices = Choices::new(data);
        let path = folder.touch(&names()[choices.below(5)]);
        let mut columns = read(&path);
        let compression = choices.of(&[None, Some(CompressionType::LZ4_FRAME), Some(CompressionType::ZSTD)]);
        let batches = choices.below(3) + 1;
        let mut left = 8;
        while !choices.is_empty() && left > 0 {
            change(&mut columns, &mut choices);
            left -= 1;
        }
        if write(&path, columns, compression, batches).is_ok() {
            open(folder, data);
        }
        folder.reset();
    });
}

fn column_seeds() -> Vec<Seed> {
    let all = (0..24_u8).map(|i| {
        seed(&format!("change{i}"), [i % 5, i % 3, i % 2, i, i % 12, 1, i, 200, 1, 2, 3, 4, 5, 6, 7, 8])
    });
    all.collect()
}

fn write(
    path: &Path,
    columns: Columns,
    compression: Option<CompressionType>,
    batches: usize,
) -> Result<(), Box<dyn std::error::Error>> {
    let batch = RecordBatch::try_from_iter(columns)?;
    let options = IpcWriteOptions::default().try_with_compression(compression)?;
    let mut writer = FileWriter::try_new_with_options(File::create(path)?, &batch.schema(), options)?;
    let rows = batch.num_rows();
    for part in 0..batches {
        let start = rows * part / batches;
        writer.write(&batch.slice(start, rows * (part + 1) / batches - start))?;
    }
    Ok(writer.finish()?)
}

/// Changes the type, the values or the name of a column, sets a null, or removes the column.
fn change(columns: &mut Columns, choices: &mut Choices<'_>) {
    if columns.is_empty() {
        return;
    }
    let at = choices.below(columns.len());
    let rows = columns[at].1.len();
    let row = |choices: &mut Choices<'_>| choices.below(rows);
    match choices.byte() % 12 {
        0 => drop(columns.remove(at)),
        1 => columns[at].0 = String::from_utf8_lossy(choices.bytes()).into_owned(),
        2 => columns[at].1 = Arc::new(NullArray::new(rows)),
        3 => {
            let other = choices.below(columns.len());
            columns[at].1 = columns[other].1.clone();
        }
        4 => columns[at].1 = Arc::new(StringArray::from_iter_values((0..rows).map(|_| "car"))),
        5 => columns[at].1 = Arc::new(BooleanArray::from(vec![true; rows])),
        6 => columns[at].1 = Arc::new(UInt64Array::from_value(choices.integer() as u64, rows)),
        7 => columns[at].1 = Arc::new(UInt8Array::from_value(choices.byte(), rows)),
        8 => columns[at].1 = Arc::new(Float16Array::from_value(f16::from_f64(choices.number()), rows)),
        9 => columns[at].1 = Arc::new(Float32Array::from_value(choices.number() as f32, rows)),
        10 => {
            let (row, value) = (row(choices), Some(choices.integer()).filter(|v| *v != 3));
            let old =
                columns[at].1.as_any().downcast_ref::<Int64Array>().map(|old| old.iter().collect::<Vec<_>>());
            let mut values = old.unwrap_or_else(|| (0..rows as i64).map(Some).collect());
            if let Some(place) = values.get_mut(row) {
                *place = value;
            }
            columns[at].1 = Arc::new(Int64Array::from(values)) as ArrayRef;
        }
        _ => {
            let (row, value) = (row(choices), choices.number());
            let old = columns[at].1.as_any().downcast_ref::<Float64Array>().map(|old| old.values().to_vec());
            let mut values = old.unwrap_or_else(|| vec![1.0; rows]);
            if let Some(place) = values.get_mut(row) {
                *place = value;
            }
            columns[at].1 = Arc::new(Float64Array::from(values));
        }
    }
}

fn map(data: &[u8]) {
    MAP.with_borrow_mut(|(scratch, base, synthetic)| {
        let path = scratch.put("map.json", &json_file(data, base));
        match read_map_file(&path, "PIT") {
            Ok(map) => check_map(&map, synthetic.recording()),
            Err(error) => assert_names_file(error, &path, data),
        }
    });
}

fn map_seeds() -> Vec<Seed> {
    let mut seeds = edit_seeds();
    seeds.iter_mut().for_each(|(_, edits)| edits.insert(0, 0));
    seeds.push(seed("file", map_json().to_string().into_bytes()));
    seeds
}
