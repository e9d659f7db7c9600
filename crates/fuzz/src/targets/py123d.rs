//! Logs of py123d: files, columns and metadata of their tables, and maps.

use std::cell::RefCell;
use std::sync::Arc;

use arrow_array::types::{Int32Type, UInt8Type};
use arrow_array::{
    Array, ArrayRef, BinaryArray, BooleanArray, Float64Array, Int64Array, NullArray, UInt16Array, UInt64Array,
};
use arrow_ipc::CompressionType;
use point_skeleton::dataset::py123d::{FORMAT, Py123d};
use point_skeleton::dataset::{LogLocator, LogReader};
use pskel_testing::py123d_log::{
    BOXES, Columns, EGO, FRAMES, FRONT, LEFT, LIDAR, LIGHTS, LOG, MAP, SPLIT, SYNC, Table, TinyPy123d,
    binaries, integer_lists, sweep, text_lists, texts, vector_lists, vectors,
};

use super::{LARGE, seed};
use crate::check::{assert_names_file_in, check_map, dataset};
use crate::choices::Choices;
use crate::folder::Folder;
use crate::{Memory, Seed, Target};

/// A small file may declare 16 MiB; each byte may become an eight-byte number, and part of a pose.
const UNPACKED: Memory = Memory { fixed: 512 << 20, factor: 1000 };

pub(super) const TARGETS: [Target; 3] = [
    Target { name: "py123d_files", run: files, seeds: file_seeds, max_len: 16_384, memory: UNPACKED },
    Target { name: "py123d_columns", run: columns, seeds: column_seeds, max_len: 512, memory: LARGE },
    Target { name: "py123d_map", run: map, seeds: map_seeds, max_len: 4096, memory: LARGE },
];

/// Tables in the order in which inputs choose them.
const TABLES: [&str; 8] = [SYNC, EGO, BOXES, LIGHTS, FRONT, LEFT, LIDAR, MAP];

/// Points of a sweep.
const POINTS: usize = 4;

/// Files of a log, and what they are written from.
struct Log {
    folder: Folder,
    made: TinyPy123d,
}

thread_local! {
    static LOG_FILES: RefCell<Log> = RefCell::new(log());
}

/// Returns a log of small files.
fn log() -> Log {
    let mut made = TinyPy123d::new();
    let sweeps: Vec<Vec<u8>> = (0..FRAMES).map(|frame| sweep(frame, POINTS)).collect();
    made.edit(LIDAR, |table| table.set("data", binaries(sweeps.iter().map(Vec::as_slice))));
    Log { folder: Folder::copy_of(made.root()), made }
}

fn file(table: &str) -> String {
    format!("logs/{SPLIT}/{LOG}/{table}.arrow")
}

fn open(folder: &Folder, data: &[u8]) {
    let path = folder.path(&format!("logs/{SPLIT}/{LOG}"));
    let sensor_root = Some(folder.path("sensors"));
    match Py123d::open(&LogLocator { sensor_root, ..LogLocator::new(&FORMAT, path) }) {
        // A log without poses has no frames.
        Ok(log) if log.recording().frames.is_empty() => assert!(!log.recording().gaps.is_empty()),
        Ok(log) => dataset(&log, folder.root(), data),
        Err(error) => assert_names_file_in(error, folder.root(), data),
    }
}

/// Replaces the file selected by the first byte with the remaining bytes.
fn files(data: &[u8]) {
    LOG_FILES.with_borrow_mut(|Log { folder, .. }| {
        let (number, bytes) = data.split_first().unwrap_or((&0, &[]));
        folder.put(&file(TABLES[usize::from(*number) % TABLES.len()]), bytes);
        open(folder, data);
        folder.reset();
    });
}

fn file_seeds() -> Vec<Seed> {
    let Log { folder, .. } = log();
    let of = |(number, table): (usize, &&str)| {
        seed(&table.replace('.', "_"), [&[number as u8], folder.base(&file(table))].concat())
    };
    TABLES.iter().enumerate().map(of).collect()
}

/// Changes the columns, the metadata and the form of a table.
fn columns(data: &[u8]) {
    LOG_FILES.with_borrow_mut(|Log { folder, made }| {
        let mut choices = Choices::new(data);
        let name = TABLES[choices.below(TABLES.len())];
        let mut table = made.tables[name].clone();
        table.compression =
            choices.of(&[None, Some(CompressionType::LZ4_FRAME), Some(CompressionType::ZSTD)]);
        table.batches = choices.below(3) + 1;
        let mut left = 8;
        while !choices.is_empty() && left > 0 {
            change(&mut table, &mut choices);
            left -= 1;
        }
        if table.write(&folder.touch(&file(name))).is_ok() {
            open(folder, data);
        }
        folder.reset();
    });
}

fn column_seeds() -> Vec<Seed> {
    let kinds = 18;
    let all = (0..3 * kinds).map(|i| {
        let down = [i % 8, i % 3, i % 2, i, i % kinds];
        seed(&format!("change{i}"), [&down[..], &[1, i, 200, 1, 2, 3, 4, 5, 6, 7, 8]].concat())
    });
    all.collect()
}

/// Changes the type, the values or the name of a column, sets a null, removes the column, or changes the
/// metadata.
fn change(table: &mut Table, choices: &mut Choices<'_>) {
    if table.columns.is_empty() {
        return;
    }
    let at = choices.below(table.columns.len());
    let rows = table.columns[at].1.len();
    match choices.byte() % 18 {
        0 => drop(table.columns.remove(at)),
        1 => table.columns[at].0 = String::from_utf8_lossy(choices.bytes()).into_owned(),
        2 => splice(&mut table.metadata, choices),
        3 => table.metadata = Some(choices.bytes().to_vec()).filter(|bytes| !bytes.is_empty()),
        4 => {
            let other = choices.below(table.columns.len());
            table.columns[at].1 = table.columns[other].1.clone();
        }
        5 => {
            let rows = choices.below(rows + 1);
            table
                .columns
                .iter_mut()
                .for_each(|(_, values)| *values = values.slice(0, rows.min(values.len())));
        }
        6 => number(&mut table.columns, at, choices),
        _ => table.columns[at].1 = values(rows, choices),
    }
}

/// Replaces some bytes.
fn splice(bytes: &mut Option<Vec<u8>>, choices: &mut Choices<'_>) {
    let bytes = bytes.get_or_insert_default();
    let start = choices.below(bytes.len() + 1);
    let end = (start + choices.below(16)).min(bytes.len());
    bytes.splice(start..end, choices.bytes().iter().copied());
    if bytes.is_empty() {
        bytes.push(0x80);
    }
}

/// Changes one number of a column; another column becomes one of integers.
fn number(columns: &mut Columns, at: usize, choices: &mut Choices<'_>) {
    let rows = columns[at].1.len();
    let (row, value) = (choices.below(rows), Some(choices.integer()).filter(|value| *value != 3));
    let old = columns[at].1.as_any().downcast_ref::<Int64Array>().map(|old| old.iter().collect::<Vec<_>>());
    let mut values = old.unwrap_or_else(|| (0..rows as i64).map(Some).collect());
    if let Some(place) = values.get_mut(row) {
        *place = value;
    }
    columns[at].1 = Arc::new(Int64Array::from(values));
}

/// Returns a column of another type.
fn values(rows: usize, choices: &mut Choices<'_>) -> ArrayRef {
    let lengths = |choices: &mut Choices<'_>| (0..rows).map(|_| choices.below(4)).collect::<Vec<_>>();
    let vector = |choices: &mut Choices<'_>| {
        let mut vector = [0.0; 10];
        (vector[3], vector[7], vector[8], vector[9]) = (1.0, 4.0, 2.0, 1.5);
        vector[choices.below(10)] = choices.number();
        vector
    };
    match choices.byte() % 11 {
        0 => Arc::new(NullArray::new(rows)),
        1 => Arc::new(BooleanArray::from(vec![true; rows])),
        2 => Arc::new(UInt64Array::from_value(choices.integer() as u64, rows)),
        3 => Arc::new(UInt16Array::from_value(choices.byte().into(), rows)),
        4 => Arc::new(Float64Array::from_value(choices.number(), rows)),
        5 => {
            let text = String::from_utf8_lossy(choices.bytes());
            texts((0..rows).map(|row| (row != 1).then_some(&*text)))
        }
        6 => {
            let bytes = choices.bytes();
            binaries((0..rows).map(|row| (row != 1).then_some(bytes)))
        }
        7 => vectors((0..rows).map(|_| *vector(choices).first_chunk::<7>().expect("ten numbers"))),
        8 => {
            let lists =
                lengths(choices).into_iter().map(|length| (0..length).map(|_| vector(choices)).collect());
            vector_lists(&lists.collect::<Vec<Vec<[f64; 10]>>>())
        }
        9 => text_lists(&lengths(choices).into_iter().map(|length| vec!["a"; length]).collect::<Vec<_>>()),
        10 if choices.byte() > 127 => integer_lists::<UInt8Type>(
            lengths(choices).into_iter().map(|length| vec![choices.byte(); length]).collect::<Vec<_>>(),
        ),
        _ => integer_lists::<Int32Type>(
            lengths(choices)
                .into_iter()
                .map(|length| vec![choices.integer() as i32; length])
                .collect::<Vec<_>>(),
        ),
    }
}

/// Splices bytes into shapes and features of a map.
fn map(data: &[u8]) {
    LOG_FILES.with_borrow_mut(|Log { folder, made }| {
        let mut choices = Choices::new(data);
        let mut table = made.tables[MAP].clone();
        let mut left = 8;
        while !choices.is_empty() && left > 0 {
            let column = choices.of(&["wkb", "features"]);
            let (_, values) =
                table.columns.iter().find(|(name, _)| name == column).expect("a column of ours");
            let old = values.as_any().downcast_ref::<BinaryArray>().expect("bytes of ours");
            let mut cells: Vec<Option<Vec<u8>>> = old.iter().map(|cell| cell.map(<[u8]>::to_vec)).collect();
            let row = choices.below(cells.len());
            splice(&mut cells[row], &mut choices);
            table.set(column, binaries(cells.iter().map(Option::as_deref)));
            left -= 1;
        }
        table.write(&folder.touch(&file(MAP))).expect("a map of ours");
        let path = folder.path(&format!("logs/{SPLIT}/{LOG}"));
        let sensor_root = Some(folder.path("sensors"));
        let log = Py123d::open(&LogLocator { sensor_root, ..LogLocator::new(&FORMAT, path) }).expect("a log");
        match log.read_map() {
            Ok(map) => check_map(&map.expect("a map"), log.recording()),
            Err(error) => assert_names_file_in(error, folder.root(), data),
        }
        folder.reset();
    });
}

fn map_seeds() -> Vec<Seed> {
    let splices = |i: u8| [[i % 2, i % 8, i, 4, 4, i, 0, 255, 1].as_slice(), &[0, 0, 1, 1, 1, 0x81]].concat();
    let mut seeds: Vec<Seed> = (0..24).map(|i| seed(&format!("splice{i}"), splices(i))).collect();
    seeds.push(seed("none", []));
    seeds
}
