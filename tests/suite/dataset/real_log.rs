//! Skeletons of a real log: where the split assigns points, and how well the sweeps of a car agree.

use std::collections::BTreeMap;

use glam::DVec3;
use point_skeleton::cloud::Point;
use point_skeleton::dataset::nuscenes::NuScenes;
use point_skeleton::dataset::{Class, Frame, LogLocator, LogReader};
use point_skeleton::skeleton::{BuildOptions, Skeleton};
use rstar::{PointDistance, RTree};
use tempfile::TempDir;

use pskel_testing::shared::{WithLog, shared, skeleton_of};

const FRAMES: [usize; 6] = [0, 2, 4, 6, 8, 10];

/// Returns the log, and a skeleton of each frame's sweep with all its points, in a folder.
fn single_sweeps() -> Option<(NuScenes, Vec<Skeleton>, TempDir)> {
    let path = shared("the PandaSet drive")?.join("data/pandaset-002/nuscenes");
    let drive = NuScenes::open(&LogLocator::new(&point_skeleton::dataset::nuscenes::FORMAT, path)).unwrap();
    let options = BuildOptions { voxel_m: 0.0, ..BuildOptions::default() };
    let all: Vec<usize> = (0..drive.recording().frames.len()).collect();
    let folder = tempfile::tempdir().unwrap();
    let skeleton = |retained: usize| {
        skeleton_of(
            &folder.path().join(retained.to_string()),
            &WithLog::grey(&drive, &[retained]),
            &all,
            &options,
        )
    };
    let built = FRAMES.map(skeleton);
    Some((drive, built.into(), folder))
}

/// Counts the background points of a sweep, and those in a box of its frame more than `ground_m` above the
/// floor.
fn background_in_boxes(skeleton: &Skeleton, frame: &Frame, ground_m: f64) -> [usize; 2] {
    // Half a millimeter for the rounding of f32.
    const ROUNDING_M: f64 = 5e-4;
    let inside = |global: DVec3| {
        frame.boxes.iter().any(|item| {
            let local = item.cuboid.pose.inverse().transform_point(global);
            let above = local.z > ground_m - item.cuboid.size.z / 2.0 + ROUNDING_M;
            above && item.cuboid.contains_local(local, -ROUNDING_M)
        })
    };
    let mut counts = [0; 2];
    for (chunk, points) in skeleton.manifest.background.iter().zip(skeleton.background().unwrap()) {
        for point in points {
            let global = DVec3::from(chunk.origin) + DVec3::from(point.position.map(f64::from));
            counts[0] += 1;
            counts[1] += usize::from(inside(global));
        }
    }
    counts
}

#[test]
fn no_background_point_lies_in_a_box_above_the_ground() {
    let Some((dataset, skeletons, _folder)) = single_sweeps() else { return };
    for (index, skeleton) in FRAMES.into_iter().zip(&skeletons) {
        let frame = &dataset.recording().frames[index];
        let [checked, inside] = background_in_boxes(skeleton, frame, 0.2);
        assert!(checked > 50_000 && inside == 0, "frame {index}: {inside} of {checked} background points");
        // The count can fail: the road under the cars is in the boxes.
        assert!(background_in_boxes(skeleton, frame, 0.0)[1] > 0, "frame {index}");
    }
}

/// Points of a car, by frame.
type Views<'a> = Vec<(usize, &'a [Point])>;

/// Minimum points of a sweep; fewer show too little of a car.
const WELL_SEEN: usize = 200;

fn well_seen_cars(skeletons: &[Skeleton]) -> BTreeMap<&str, Views<'_>> {
    let mut cars: BTreeMap<&str, Views> = BTreeMap::new();
    for (index, skeleton) in FRAMES.into_iter().zip(skeletons) {
        for (asset, points) in skeleton.manifest.actors.iter().zip(skeleton.actors().unwrap()) {
            if asset.class == Class::MotorVehicle && points.len() >= WELL_SEEN {
                cars.entry(&asset.track).or_default().push((index, points));
            }
        }
    }
    cars.retain(|_, views| views.len() >= 3);
    cars
}

/// Returns the median distance from a point of one sweep to the nearest point of the others, meters.
fn median_distance_m(views: &Views) -> f64 {
    let mut distances = Vec::new();
    for (one, (_, points)) in views.iter().enumerate() {
        let others = views.iter().enumerate().filter(|(i, _)| *i != one);
        let rows: Vec<[f32; 3]> =
            others.flat_map(|(_, (_, points))| points.iter().map(|p| p.position)).collect();
        let tree = RTree::bulk_load(rows);
        let squared = |p: &Point| tree.nearest_neighbor(p.position).unwrap().distance_2(&p.position);
        distances.extend(points.iter().map(|p| squared(p).sqrt()));
    }
    distances.sort_by(f32::total_cmp);
    f64::from(distances[distances.len() / 2])
}

/// Returns a point moved up by `by_m` meters.
fn raised(point: &Point, by_m: f32) -> Point {
    let [x, y, z] = point.position;
    Point { position: [x, y, z + by_m], ..*point }
}

/// Returns the distance between a track's first and last box within the frames, meters.
fn travel_m(dataset: &NuScenes, track: &str) -> f64 {
    let log = dataset.recording();
    let track = log.tracks.iter().position(|t| t.id == track).unwrap();
    let at = |i: usize| log.frames[i].cuboid_of(track).map(|c| c.pose.translation);
    let places: Vec<DVec3> = FRAMES.into_iter().filter_map(at).collect();
    places[0].distance(places[places.len() - 1])
}

#[test]
fn the_sweeps_of_a_car_agree() {
    let Some((dataset, skeletons, _folder)) = single_sweeps() else { return };
    let cars = well_seen_cars(&skeletons);
    assert!(cars.len() >= 5, "{} well-seen cars", cars.len());
    let mut off = Vec::new();
    for (track, views) in &cars {
        let median_m = median_distance_m(views);
        let points: usize = views.iter().map(|(_, p)| p.len()).sum();
        let travel_m = travel_m(&dataset, track);
        println!(
            "{track} {points:6} points, {} sweeps, moved {travel_m:5.1} m: {:5.1} mm",
            views.len(),
            median_m * 1e3
        );
        if median_m > 0.05 {
            off.push(format!("{track} (moved {travel_m:.1} m): {median_m:.3} m"));
        }
    }
    // The distance can fail: for a car with one sweep raised by 0.3 m.
    let mut views = cars.into_values().next().unwrap();
    let raised: Vec<Point> = views[0].1.iter().map(|p| raised(p, 0.3)).collect();
    views[0].1 = &raised;
    let lone = [views[0], views[1]];
    assert!(median_distance_m(&lone.to_vec()) > 0.05);
    assert!(off.is_empty(), "expected at most 0.05 m, found {}", off.join(", "));
}
