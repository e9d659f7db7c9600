use super::super::tests::{assert_damage_is_survived, assert_near, cloud, decoded, one_point};
use super::super::{Points, declared_points, decode};

/// Half a step of 16 bits over the cloud's extent of 14.75 m, and the rounding of `f32`, meters.
const HALF_STEP_M: f32 = 14.75 / 65_535.0 / 2.0 + 1e-6;

/// Oracle: the numbers that py123d was given.
#[test]
fn clouds_of_every_level_hold_the_points() {
    for cell in [
        &include_bytes!("../cells/draco_0")[..],
        include_bytes!("../cells/draco_4"),
        include_bytes!("../cells/draco_7"),
        include_bytes!("../cells/draco_10"),
    ] {
        assert_near(&decoded(cell), &cloud(60), HALF_STEP_M);
    }
    assert_near(&decoded(include_bytes!("../cells/draco_one")), &one_point(), HALF_STEP_M);
}

/// Intensities as `f64`, numbers of LiDARs as `i8`, which Draco lacks; 11 bits.
#[test]
fn numbers_of_other_types_are_stored_as_bytes() {
    assert_near(&decoded(include_bytes!("../cells/draco_double")), &cloud(60), 14.75 / 2047.0 / 2.0 + 1e-6);
}

/// Fractional intensities as `f32`, numbers of LiDARs as `u32`; 30 bits over 200 m.
#[test]
fn floats_are_not_quantized() {
    let whole = cloud(60);
    let intensity = whole.intensity.map(|values| values.iter().map(|v| v / 4.0).collect());
    let expected = Points { intensity, channel: None, skipped: Vec::new(), ..whole };
    assert_near(&decoded(include_bytes!("../cells/draco_float")), &expected, 1e-5);
}

/// A tree changes the order of the points; an intensity names its point.
#[test]
fn trees_hold_the_points_in_another_order() {
    let points = decoded(include_bytes!("../cells/draco_tree"));
    let (intensity, ids, channel) =
        (points.intensity.clone().unwrap(), points.ids.clone().unwrap(), points.channel.clone().unwrap());
    let mut order: Vec<usize> = (0..60).collect();
    order.sort_by(|a, b| intensity[*a].total_cmp(&intensity[*b]));
    let sorted = Points {
        xyz: order.iter().map(|at| points.xyz[*at]).collect(),
        intensity: Some(order.iter().map(|at| intensity[*at]).collect()),
        ids: Some(order.iter().map(|at| ids[*at]).collect()),
        channel: Some(order.iter().map(|at| channel[*at]).collect()),
        skipped: points.skipped.clone(),
    };
    assert_ne!(order, (0..60).collect::<Vec<_>>());
    assert_near(&sorted, &Points { skipped: Vec::new(), ..cloud(60) }, HALF_STEP_M);
}

/// Cuts clouds at every byte, and changes every byte: nothing may panic.
#[test]
fn damaged_clouds_are_errors_or_points() {
    for cell in [&include_bytes!("../cells/draco_7")[..], include_bytes!("../cells/draco_tree")] {
        assert_damage_is_survived(cell);
    }
}

/// Places of the header: version 5, geometry 7, number of points 11 where no metadata are before it.
#[test]
fn other_clouds_are_refused() {
    let cell = include_bytes!("../cells/draco_one");
    for (place, bytes, found) in [
        (5, &[1][..], "Draco 1.3"),
        (6, &[4], "Draco 2.4"),
        (7, &[1], "a Draco mesh"),
        (11, &[0, 0, 0, 1], "16777216 points in a Draco cloud of 58 bytes"),
    ] {
        let mut cell = cell.to_vec();
        cell[place..place + bytes.len()].copy_from_slice(bytes);
        assert_eq!(decode(&cell), Err(found.to_owned()));
        assert_eq!(declared_points(&cell), Err(found.to_owned()));
    }
    assert!(decode(b"DRACO\x02\x03").is_err_and(|found| found.starts_with("a damaged Draco cloud")));
}
