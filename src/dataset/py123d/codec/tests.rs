//! Cells of logs that py123d wrote, and of a made-up cloud. `cells/` has the latter: 60 points that py123d
//! 0.7.0 encoded in each codec, of which [`cloud`] knows the numbers.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_buffer::Buffer;
use arrow_ipc::reader::RecordBatchDecoder;
use arrow_ipc::root_as_message;
use arrow_schema::{DataType, Field, Schema};
use pskel_testing::shared::shared;
use serde_json::Value;
use sha2::{Digest, Sha256};

use super::{Codec, Points, declared_points, decode};

/// Returns the first points of the made-up cloud, with all its features.
pub(super) fn cloud(rows: u16) -> Points {
    let rows = 0..rows;
    let position = |i: u16| [f32::from(i) * 0.25, f32::from(i) * -0.125, f32::from(i % 5)];
    Points {
        xyz: rows.clone().map(position).collect(),
        intensity: Some(rows.clone().map(|i| f32::from(i * 4)).collect()),
        ids: Some(rows.clone().map(|i| 2 + (i % 2) as u8).collect()),
        channel: Some(rows.map(|i| i * 7).collect()),
        skipped: vec!["timestamps".to_owned(), "range".to_owned()],
    }
}

/// Returns the second point of the cloud, without features.
pub(super) fn one_point() -> Points {
    Points { xyz: vec![[0.25, -0.125, 1.0]], ..Points::default() }
}

/// Decodes a cell and checks the declared number of points.
#[track_caller]
pub(super) fn decoded(cell: &[u8]) -> Points {
    let points = decode(cell).unwrap();
    assert_eq!(declared_points(cell), Ok(points.xyz.len() as u64));
    points
}

/// Fails unless points are equal, positions within a distance.
#[track_caller]
pub(super) fn assert_near(points: &Points, expected: &Points, most_m: f32) {
    assert_eq!(points.xyz.len(), expected.xyz.len());
    for (at, (found, position)) in points.xyz.iter().zip(&expected.xyz).enumerate() {
        let is_near = found.iter().zip(position).all(|(a, b)| (a - b).abs() <= most_m);
        assert!(is_near, "point {at}: {found:?} for {position:?}");
    }
    let features = |points: &Points| (points.intensity.clone(), points.ids.clone(), points.channel.clone());
    assert_eq!(features(points), features(expected));
    assert_eq!(points.skipped, expected.skipped);
}

#[test]
fn codecs_are_told_by_their_first_bytes() {
    for (bytes, codec) in [
        (&b"\xff\xff\xff\xff\x10"[..], Some(Codec::Ipc)),
        (b"LASF\0", Some(Codec::Laz)),
        (b"DRACO\x02", Some(Codec::Draco)),
        (b"DRAC", None),
        (b"", None),
        (b"/some/path", None),
    ] {
        assert_eq!(Codec::of(bytes), codec);
    }
    for (bytes, found) in [
        (&b""[..], "an empty file"),
        (b"\xff\xd8\xff\xe0", "a JPEG image"),
        (b"1234", "4 bytes of an unknown codec"),
    ] {
        assert_eq!(decode(bytes), Err(found.to_owned()));
        assert_eq!(declared_points(bytes), Err(found.to_owned()));
    }
}

/// Oracle: the hashes of positions and features that py123d reads.
fn holds(log: &str, sweeps: usize) {
    let Some(shared) = shared("a log of py123d") else { return };
    let folder = shared.join("data/123d").join(log);
    let expected: Value =
        serde_json::from_slice(&std::fs::read(folder.join("expected.json")).unwrap()).unwrap();
    let mut found = 0;
    for frame in expected["frames"].as_array().unwrap() {
        for (key, sweep) in frame["lidars"].as_object().into_iter().flatten() {
            let row = frame["rows"][format!("lidar.{key}")].as_u64().unwrap();
            let cell = cell(&table(&folder, key), row as usize);
            assert_eq!(cell.len() as u64, sweep["stored"]["bytes"].as_u64().unwrap());
            check(&decoded(&cell), sweep);
            found += 1;
        }
    }
    assert_eq!(found, sweeps);
}

/// Returns the table of a LiDAR, the only one of its name in the folder.
fn table(folder: &Path, key: &str) -> std::path::PathBuf {
    let below =
        |folder: std::path::PathBuf| std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let logs = below(folder.join("logs")).flat_map(below);
    let tables: Vec<_> = logs.map(|log| log.join(format!("lidar.{key}.arrow"))).collect();
    assert_eq!(tables.len(), 1);
    tables[0].clone()
}

/// Returns the bytes in a row of a LiDAR table: times of begin and end, then the cell. The metadata of the
/// schema are no text, so that no reader of whole files accepts it.
fn cell(table: &Path, row: usize) -> Vec<u8> {
    let bytes = std::fs::read(table).unwrap();
    let data_types = [DataType::Int64, DataType::Int64, DataType::Binary];
    let fields = ["begin", "end", "data"].into_iter().zip(data_types);
    let schema = Schema::new(fields.map(|(name, kind)| Field::new(name, kind, true)).collect::<Vec<_>>());
    let (schema, dictionaries) = (Arc::new(schema), HashMap::new());
    let (mut at, mut before) = (b"ARROW1\0\0".len(), 0);
    loop {
        let length = u32::from_le_bytes(bytes[at + 4..at + 8].try_into().unwrap()) as usize;
        let header = Buffer::from_slice_ref(&bytes[at + 8..at + 8 + length]);
        at += 8 + length;
        let Ok(message) = root_as_message(&header) else { continue };
        let body = Buffer::from_slice_ref(&bytes[at..at + message.bodyLength() as usize]);
        at += body.len();
        let (batch, version) = (message.header_as_record_batch().unwrap(), message.version());
        let decoder = RecordBatchDecoder::try_new(&body, batch, schema.clone(), &dictionaries, &version);
        let batch = decoder.unwrap().read_record_batch().unwrap();
        if row < before + batch.num_rows() {
            return batch.column(2).as_binary::<i32>().value(row - before).to_vec();
        }
        before += batch.num_rows();
    }
}

fn check(points: &Points, sweep: &Value) {
    assert_eq!(points.xyz.len() as u64, sweep["points"].as_u64().unwrap());
    let bytes: Vec<u8> = points.xyz.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
    assert_eq!(sha256(&bytes), sweep["xyz_f32_sha256"].as_str().unwrap());
    check_features(points, &sweep["features"]);
}

/// Features that are read are compared in the type of the file, one byte; the others are named.
fn check_features(points: &Points, features: &Value) {
    let bytes = |name: &str| -> Option<Vec<u8>> {
        match name {
            "intensity" => points.intensity.as_ref().map(|values| values.iter().map(|v| *v as u8).collect()),
            "ids" => points.ids.clone(),
            "channel" => points.channel.as_ref().map(|values| values.iter().map(|v| *v as u8).collect()),
            _ => None,
        }
    };
    let mut skipped = Vec::new();
    for (name, feature) in features.as_object().unwrap() {
        match bytes(name) {
            None => skipped.push(name.clone()),
            Some(bytes) => {
                assert_eq!(feature["type"], "|u1");
                assert_eq!(sha256(&bytes), feature["sha256"].as_str().unwrap(), "{name}");
            }
        }
    }
    let mut names = points.skipped.clone();
    names.sort();
    skipped.sort();
    assert_eq!(names, skipped);
    let read = ["intensity", "ids", "channel"].map(|name| bytes(name).is_some());
    assert_eq!(read, ["intensity", "ids", "channel"].map(|name| features.get(name).is_some()));
}

fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

#[test]
fn sweeps_of_uncompressed_streams_equal_those_of_py123d() {
    holds("pandaset-mp4-ipc", 6);
}

#[test]
fn sweeps_of_lz4_streams_equal_those_of_py123d() {
    holds("pandaset-jpeg-lz4", 6);
}

#[test]
fn sweeps_of_zstd_streams_equal_those_of_py123d() {
    holds("pandaset-noimage-zstd", 6);
}

#[test]
fn sweeps_of_two_lidars_equal_those_of_py123d() {
    holds("made-variety", 7);
}

#[test]
fn sweeps_of_laz_files_equal_those_of_py123d() {
    holds("pandaset-jpeg-laz", 6);
}

#[test]
fn sweeps_of_old_laz_files_equal_those_of_py123d() {
    holds("pandaset-v0.2.1", 3);
}

#[test]
fn sweeps_of_laz_files_in_chunks_equal_those_of_py123d() {
    holds("av2-laz", 2);
}

#[test]
fn sweeps_of_draco_clouds_equal_those_of_py123d() {
    holds("pandaset-png-draco", 2);
}

/// Cuts a cell at every byte, and changes every byte: the rest is an error, or has as many points as it
/// declares.
pub(super) fn assert_damage_is_survived(cell: &[u8]) {
    for at in 0..cell.len() {
        let mut changed = cell.to_vec();
        changed[at] ^= 0x81;
        for cell in [&cell[..at], &changed] {
            if let Ok(points) = decode(cell) {
                assert_eq!(declared_points(cell), Ok(points.xyz.len() as u64));
            }
        }
    }
}
