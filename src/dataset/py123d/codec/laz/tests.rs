use super::super::tests::{assert_damage_is_survived, assert_near, cloud, decoded, one_point};
use super::super::{declared_points, decode};

/// Half a step of the positions, and the rounding of `f32`, meters.
const HALF_CENTIMETER_M: f32 = 0.005_01;

/// Oracle: the numbers that py123d was given; steps of 1 cm.
#[test]
fn files_of_every_kind_of_compression_hold_the_points() {
    assert_near(&decoded(include_bytes!("../cells/laz_3")), &cloud(60), HALF_CENTIMETER_M);
    assert_near(&decoded(include_bytes!("../cells/laz_6")), &cloud(60), HALF_CENTIMETER_M);
    assert_near(&decoded(include_bytes!("../cells/laz_8")), &cloud(60), HALF_CENTIMETER_M);
    assert_near(&decoded(include_bytes!("../cells/laz_none")), &cloud(0), 0.0);
    assert_near(&decoded(include_bytes!("../cells/laz_one")), &one_point(), HALF_CENTIMETER_M);
}

/// Steps of 1, 2 and 5 mm, offsets of meters, intensities as floats.
#[test]
fn steps_and_offsets_are_applied() {
    assert_near(&decoded(include_bytes!("../cells/laz_offset")), &cloud(60), 0.001_01);
}

/// Cuts files at every byte, and changes every byte: nothing may panic.
#[test]
fn damaged_files_are_errors_or_points() {
    for cell in [&include_bytes!("../cells/laz_3")[..], include_bytes!("../cells/laz_8")] {
        assert_damage_is_survived(cell);
    }
}

fn edited(cell: &[u8], place: usize, bytes: &[u8]) -> Vec<u8> {
    let mut cell = cell.to_vec();
    cell[place..place + bytes.len()].copy_from_slice(bytes);
    cell
}

/// Places of the header: version 24, format 104, record length 105, number of points 247.
#[test]
fn other_files_are_refused() {
    let cell = include_bytes!("../cells/laz_3");
    for (place, bytes, found) in [
        (25, &[9][..], "LAS 1.9"),
        (104, &[3], "LAS points that are not compressed"),
        (104, &[0x84], "LAS points of format 4"),
        (105, &[0, 8], "LAS points of format 3 and 2048 bytes"),
        (247, &[0, 0, 0, 1], "16777216 points of 50 bytes in a file of 2733 bytes"),
    ] {
        assert_eq!(decode(&edited(cell, place, bytes)), Err(found.to_owned()));
        assert_eq!(declared_points(&edited(cell, place, bytes)), Err(found.to_owned()));
    }
    assert!(decode(&edited(cell, 247, &[61])).is_err_and(|found| found.ends_with("in 61 points")));
    assert!(decode(&cell[..300]).is_err_and(|found| found == "a header of 375 bytes"));
}
