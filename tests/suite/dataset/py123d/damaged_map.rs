//! Maps with damaged objects: some of a layer are counted, a layer of nothing else is refused.

use std::collections::BTreeMap;
use std::sync::Arc;

use arrow_array::{Array, ArrayRef, BinaryArray, Int8Array};
use point_skeleton::dataset::{LogReader, VectorMap};
use pskel_testing::py123d_log::{
    MAP, Pack, START, Table, TinyPy123d, assert_message, binaries, integers, line, packed, polygon, texts,
};

/// Rows of the two lanes, and of the road line.
const LANES: [usize; 2] = [0, 1];
const ROAD_LINE: usize = 7;
const SKIPPED: &str = "records of lanes that cannot be read (skipped)";

fn read(made: &TinyPy123d) -> Result<VectorMap, String> {
    let read = made.open().unwrap().read_map();
    read.map(|map| map.unwrap()).map_err(|error| error.to_string())
}

/// Replaces cells of a column of bytes.
fn put(table: &mut Table, column: &str, rows: &[usize], bytes: Option<&[u8]>) {
    let (_, old) = table.columns.iter().find(|(name, _)| name == column).unwrap();
    let old = old.as_any().downcast_ref::<BinaryArray>().unwrap().clone();
    let cell = |row: usize| if rows.contains(&row) { bytes } else { Some(old.value(row)) };
    table.set(column, binaries((0..old.len()).map(cell)));
}

fn with(column: &str, rows: &[usize], bytes: Option<&[u8]>) -> TinyPy123d {
    let mut made = TinyPy123d::new();
    made.edit(MAP, |table| put(table, column, rows, bytes));
    made
}

/// Returns the number of lanes, of connectors and of road lines, and the notes.
fn counted(map: VectorMap) -> ([usize; 3], BTreeMap<String, usize>) {
    ([map.lanes.len(), map.lane_connectors.len(), map.dividers.len()], map.notes)
}

fn noted(note: &str) -> BTreeMap<String, usize> {
    BTreeMap::from([(note.to_owned(), 1)])
}

#[test]
fn broken_shapes_are_counted() {
    let at = |x: f64, y: f64| [START.x + x, START.y + y, 0.0];
    let whole = polygon(&[at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0)]);
    let nested = [&[1][..], &7_u32.to_le_bytes(), &1_u32.to_le_bytes()].concat().repeat(100_000);
    let many = |kind: u32| [&[1][..], &kind.to_le_bytes(), &u32::MAX.to_le_bytes()].concat();
    let point = [&[1][..], &1_u32.to_le_bytes(), &[0; 16]].concat();
    let broken = [
        None,
        Some(Vec::new()),
        Some(vec![1]),
        Some(vec![9; 40]),
        Some(whole[..whole.len() - 1].to_vec()),
        Some([&whole[..], &[0]].concat()),
        Some(nested),
        Some(many(2)),
        Some(many(3)),
        Some(many(6)),
        Some(point),
    ];
    for wkb in broken {
        let found = read(&with("wkb", &LANES[..1], wkb.as_deref())).unwrap();
        assert_eq!(counted(found), ([0, 1, 1], noted(SKIPPED)), "{wkb:?}");
        let message = read(&with("wkb", &LANES, wkb.as_deref())).unwrap_err();
        assert_message(&message, &["expected a map of py123d, found object 11 of lanes: "], "/map.arrow");
    }
    let flat = polygon(&[at(0.0, 0.0), at(1.0, 0.0), at(2.0, 0.0)]);
    let far = polygon(&[at(0.0, 0.0), at(1e9, 0.0), at(2.0, 3.0)]);
    let nan = polygon(&[at(0.0, 0.0), at(f64::NAN, 0.0), at(2.0, 3.0)]);
    for wkb in [flat, far, nan] {
        let found = read(&with("wkb", &LANES[..1], Some(&wkb))).unwrap();
        assert_eq!(counted(found), ([0, 1, 1], noted("lanes without an area (skipped)")));
    }
    let of = |row: usize, wkb: &[u8]| counted(read(&with("wkb", &[row], Some(wkb))).unwrap());
    let straight = line(&[at(0.0, 0.0), at(1.0, 0.0)]);
    assert_eq!(of(LANES[0], &straight), ([0, 1, 1], noted("lanes that are lines (skipped)")));
    assert_eq!(of(ROAD_LINE, &whole), ([1, 1, 0], noted("road lines that are areas (skipped)")));
    let dot = line(&[at(0.0, 0.0), at(0.0, 0.0)]);
    assert_eq!(of(ROAD_LINE, &dot), ([1, 1, 0], noted("road lines without a length (skipped)")));
}

#[test]
fn broken_features_are_counted() {
    let lane = |centerline: Pack| {
        packed(&Pack::map(&[("lane_group_id", Pack::Int(21)), ("centerline", centerline)]))
    };
    let six = [0.0; 6];
    let broken = [
        b"\xc1".to_vec(),
        b"{}".to_vec(),
        [&[0x81, 0xa1, b'a'][..], &[0x91; 100_000], &[0xc0]].concat(),
        packed(&Pack::map(&[("lane_group_id", Pack::text("21"))])),
        packed(&Pack::map(&[("successor_ids", Pack::Int(1))])),
        packed(&Pack::map(&[("successor_ids", Pack::List(vec![Pack::Nil]))])),
        lane(Pack::Int(1)),
        lane(Pack::ints(&[1, 2])),
        lane(Pack::array("<f4", &[2, 3], &six)),
        lane(Pack::array("<f8", &[3, 3], &six)),
        lane(Pack::array("<f8", &[6, 1], &six)),
        lane(Pack::array("<f8", &[6], &six)),
        lane(Pack::array("<f8", &[-2, -3], &six)),
        lane(Pack::array("<f8", &[1 << 62, 4], &six)),
        lane(Pack::array("<f8", &[0, 0], &[])),
    ];
    for features in broken {
        let found = read(&with("features", &LANES[..1], Some(&features))).unwrap();
        assert_eq!(counted(found), ([0, 1, 1], noted(SKIPPED)), "{features:?}");
        let message = read(&with("features", &LANES, Some(&features))).unwrap_err();
        assert_message(&message, &["expected a map of py123d, found object 11 of lanes: "], "/map.arrow");
    }
    // The shape of a lane without a group, a centerline or features is read.
    for features in [
        None,
        Some(packed(&Pack::map(&[]))),
        Some(lane(Pack::Nil)),
        Some(lane(Pack::array("<f8", &[2, 3], &six))),
    ] {
        let found = read(&with("features", &LANES[..1], features.as_deref())).unwrap();
        assert!(found.lanes[0].centerline.is_empty());
        let is_flat = features.as_ref().is_some_and(|bytes| bytes.len() > 60);
        let notes = if is_flat { noted("centerlines without a length (skipped)") } else { BTreeMap::new() };
        assert_eq!(counted(found), ([1, 1, 1], notes));
    }
    // Features of other layers are not read.
    assert_eq!(
        counted(read(&with("features", &[ROAD_LINE], Some(b"\xc1"))).unwrap()),
        ([1, 1, 1], BTreeMap::new())
    );
}

#[test]
fn unknown_layers_are_counted() {
    for layer in [11, -1] {
        let mut made = TinyPy123d::new();
        made.edit(MAP, |table| {
            table.set("map_layer", Arc::new(Int8Array::from(vec![0, 0, 1, 1, 2, 3, 6, layer])))
        });
        let note = format!("map objects of the unknown layer {layer} (not read)");
        assert_eq!(counted(read(&made).unwrap()), ([1, 1, 0], noted(&note)));
    }
    let mut made = TinyPy123d::new();
    made.edit(MAP, |table| table.columns.iter_mut().for_each(|column| column.1 = column.1.slice(0, 0)));
    assert_eq!(counted(read(&made).unwrap()), ([0; 3], BTreeMap::new()));
}

#[test]
fn damaged_columns_are_named() {
    for column in ["object_id", "map_layer", "features", "wkb"] {
        let mut made = TinyPy123d::new();
        made.edit(MAP, |table| table.remove(column));
        let expected = format!("expected a column {column}, found columns ");
        assert_message(&read(&made).unwrap_err(), &[&expected], "/map.arrow");
        let other: ArrayRef = if column == "wkb" { integers(0..8) } else { texts(["a"; 8]) };
        let mut made = TinyPy123d::new();
        made.edit(MAP, |table| table.set(column, other));
        assert_message(
            &read(&made).unwrap_err(),
            &[&format!(" in column {column}, found type ")],
            "/map.arrow",
        );
    }
}
