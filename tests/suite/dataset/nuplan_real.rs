//! The nuPlan reader on a real log that is also available in nuScenes layout, with another origin.

use std::path::{Path, PathBuf};

use glam::{DVec2, DVec3};
use point_skeleton::cloud::Point;
use point_skeleton::dataset::nuplan::NuPlan;
use point_skeleton::dataset::nuscenes::NuScenes;
use point_skeleton::dataset::{ImageRecord, LogLocator, LogReader, VectorMap};
use point_skeleton::geometry::{Camera, View};
use point_skeleton::skeleton::{BuildOptions, Chunk, Part, Skeleton, Splitter, Trajectories};
use rstar::{PointDistance, RTree};
use serde_json::Value;

use pskel_testing::shared::{WithLog, shared, skeleton_of};

const NAME: &str = "2020.01.01.00.00.00_veh-02_00000_00079";
/// Global coordinates here minus the nuScenes layout's, meters.
const OFFSET: DVec3 = DVec3::new(663_830.25, 3_996_050.75, 606.5);
/// Channel names of the same cameras in both layouts.
const CAMERAS: [(&str, &str); 6] = [
    ("CAM_F0", "CAM_FRONT"),
    ("CAM_R0", "CAM_FRONT_RIGHT"),
    ("CAM_R1", "CAM_BACK_RIGHT"),
    ("CAM_B0", "CAM_BACK"),
    ("CAM_L1", "CAM_BACK_LEFT"),
    ("CAM_L0", "CAM_FRONT_LEFT"),
];
/// Frames whose sensor files exist.
const RETAINED: [usize; 6] = [0, 4, 8, 16, 24, 34];

fn folder() -> Option<PathBuf> {
    Some(shared("the PandaSet drive")?.join("data/pandaset-002"))
}

fn open_nuplan(folder: &Path) -> NuPlan {
    let path = folder.join(format!("nuplan/nuplan-v1.1/splits/mini/{NAME}.db"));
    NuPlan::open(&LogLocator::new(&point_skeleton::dataset::nuplan::FORMAT, path)).unwrap()
}

fn open_nuscenes(folder: &Path) -> NuScenes {
    NuScenes::open(&LogLocator::new(&point_skeleton::dataset::nuscenes::FORMAT, folder.join("nuscenes")))
        .unwrap()
}

#[test]
fn the_recording_matches_its_readme() {
    let Some(folder) = folder() else { return };
    let dataset = open_nuplan(&folder);
    let log = dataset.recording();
    assert_eq!((log.name.as_str(), log.location.as_str()), (NAME, "us-ca-pandaset-002"));
    assert_eq!((log.frames.len(), log.tracks.len()), (38, 98));
    assert_eq!(log.cameras, CAMERAS.map(|(name, _)| name));
    let boxes = |category: &str| {
        let of = |b: &&point_skeleton::dataset::TrackBox| log.tracks[b.track].category == category;
        log.frames.iter().flat_map(|f| &f.boxes).filter(of).count()
    };
    let counts = ["vehicle", "pedestrian", "traffic_cone", "bicycle", "barrier"].map(boxes);
    assert_eq!(counts, [3089, 297, 152, 38, 0]);
    let scenarios: usize = log.scenarios.values().map(Vec::len).sum();
    assert_eq!((scenarios, log.scenarios["near_multiple_vehicles"].len(), log.lights.len()), (105, 38, 152));
    let red = log.lights.iter().filter(|light| light.color == "red").count();
    assert_eq!((red, log.lights[0].frame, log.lights[0].lane_connector.as_str()), (38, 0, "68001"));
    // Six scenes; the last one has no goal.
    assert_eq!(log.routes.len(), 6);
    assert!(log.routes.iter().all(|route| route.roadblocks == ["66001", "69001", "66004"]));
    assert!(log.routes.windows(2).all(|pair| pair[0].frame < pair[1].frame) && log.routes[0].frame == 0);
    let goal = log.routes[0].goal.unwrap().translation;
    assert!(goal.distance(log.frames[37].global_from_ego.translation) < 0.1, "{goal}");
    assert_eq!(log.routes.iter().filter(|route| route.goal.is_none()).count(), 1);
    let maps = log.map_files.as_ref().unwrap();
    assert_eq!(maps.name, "us-ca-pandaset-002");
    assert!(maps.root.is_absolute() && maps.root.join(&maps.name).is_dir());
    let notes: Vec<_> = log.notes.iter().map(|(kind, n)| (kind.as_str(), *n)).collect();
    assert_eq!(notes, [("missing image files", 192), ("missing sweep files", 32)]);
    let with = |has: fn(&point_skeleton::dataset::Frame) -> bool| -> Vec<usize> {
        (0..38).filter(|i| has(&log.frames[*i])).collect()
    };
    assert_eq!(with(|f| f.sweeps.len() == 1), RETAINED);
    assert_eq!(with(|f| f.images.len() == 6), RETAINED);
    assert!(log.frames.iter().all(|f| f.images.len() % 6 == 0 && f.between_images.is_empty()));
    for frame in &log.frames {
        for image in &frame.images {
            assert!(image.t_us.abs_diff(frame.t_us) <= 50_000 && image.camera.lens.is_none());
            assert_eq!((image.camera.width, image.camera.height), (1920, 1080));
        }
    }
    let points: Option<u64> =
        log.frames.iter().flat_map(|f| &f.sweeps).map(|s| dataset.check_sweep(s).unwrap()).sum();
    assert_eq!(points, Some(1_001_556));
}

/// Poses, boxes, calibration and images equal the other layout's, up to the offset.
#[test]
fn both_layouts_describe_the_same_world() {
    let Some(folder) = folder() else { return };
    let (nuplan, nuscenes) = (open_nuplan(&folder), open_nuscenes(&folder));
    let (a, b) = (nuplan.recording(), nuscenes.recording());
    let mut compared = [0; 2];
    for (one, other) in a.frames.iter().zip(&b.frames) {
        assert_eq!(one.t_us + 50_000, other.t_us);
        assert_eq!(one.boxes.len(), other.boxes.len());
        for item in &one.boxes {
            // A track's token is a prefix of the instance's.
            let id = &a.tracks[item.track].id;
            let track = b.tracks.iter().position(|t| t.id.starts_with(id.as_str())).unwrap();
            let twin = other.cuboid_of(track).unwrap();
            let moved = item.cuboid.pose.translation - OFFSET - twin.pose.translation;
            assert!(moved.length() < 1e-6 && item.cuboid.size == twin.size, "{id}: {moved}");
            assert!((item.cuboid.pose.rotation * twin.pose.rotation.inverse()).w.abs() > 1.0 - 1e-12);
            compared[0] += 1;
        }
        for image in &one.images {
            let channel = b.cameras.iter().position(|c| c == CAMERAS[image.channel].1).unwrap();
            let twin = other.images.iter().find(|i| i.channel == channel).unwrap();
            assert_eq!((image.t_us, &image.camera.intrinsics), (twin.t_us, &twin.camera.intrinsics));
            assert!(std::fs::read(&image.path).unwrap() == std::fs::read(&twin.path).unwrap());
            compared[1] += project_alike(image, twin, one);
        }
    }
    assert_eq!(compared[0], 3576);
    assert!(compared[1] > 2000, "{} corners", compared[1]);
}

/// Checks that the corners of the boxes project to the same pixels; returns how many lie in the image.
fn project_alike(image: &ImageRecord, twin: &ImageRecord, frame: &point_skeleton::dataset::Frame) -> usize {
    let view = |record: &ImageRecord| View {
        camera: Camera::clone(&record.camera),
        camera_from_world: record.camera_from_global().affine(),
    };
    let (view, twin) = (view(image), view(twin));
    let mut seen = 0;
    for corner in frame.boxes.iter().flat_map(|b| b.cuboid.corners()) {
        let (Some((p, z)), Some((q, w))) = (view.project(corner), twin.project(corner - OFFSET)) else {
            continue;
        };
        let (x, y) = (0.0..1920.0, 0.0..1080.0);
        if z > 1.0 && x.contains(&p.x) && y.contains(&p.y) {
            assert!(p.distance(q) < 1e-3 && (z - w).abs() < 1e-6, "{p} {q}");
            seen += 1;
        }
    }
    seen
}

/// Builds a skeleton that retains the ego's own returns: which points count as such depends on the LiDAR's
/// origin, which differs between the layouts.
fn skeleton(out: &Path, drive: &dyn LogReader) -> Skeleton {
    let mut options = BuildOptions { voxel_m: 0.0, ..BuildOptions::default() };
    options.split.ego_clearance_m = 0.0;
    let frames: Vec<usize> = (0..drive.recording().frames.len()).collect();
    skeleton_of(out, &WithLog::grey(drive, &RETAINED), &frames, &options)
}

fn background(skeleton: &Skeleton, offset: DVec3) -> Vec<[f64; 3]> {
    let chunk = |(chunk, points): (&Chunk, &[Point])| -> Vec<[f64; 3]> {
        let origin = DVec3::from(chunk.origin) - offset;
        points.iter().map(|p| (origin + DVec3::from(p.position.map(f64::from))).to_array()).collect()
    };
    skeleton.manifest.background.iter().zip(skeleton.background().unwrap()).flat_map(chunk).collect()
}

/// Both sweeps are rounded to 1 mm, in two frames: at most 0.87 mm each. No other loss is allowed.
const PRECISION_M: f64 = 2e-3;

/// Returns the points of one cloud that have no point of the other within 2 mm.
fn lonely(of: &[[f64; 3]], among: &[[f64; 3]]) -> Vec<DVec3> {
    let tree = RTree::bulk_load(among.to_vec());
    let squared = |p: &[f64; 3]| tree.nearest_neighbor(*p).unwrap().distance_2(p);
    of.iter().filter(|p| squared(p) > PRECISION_M * PRECISION_M).map(|p| DVec3::from(*p)).collect()
}

#[test]
fn background_points_are_within_two_millimeters_of_the_other_layout() {
    let Some(folder) = folder() else { return };
    let (nuplan, nuscenes) = (open_nuplan(&folder), open_nuscenes(&folder));
    let scratch = tempfile::tempdir().unwrap();
    let (a, b) =
        (skeleton(&scratch.path().join("a"), &nuplan), skeleton(&scratch.path().join("b"), &nuscenes));
    let reports = [&a.manifest.report, &b.manifest.report];
    assert_eq!(reports.map(|r| r.points_read), [1_001_556; 2]);
    let (near, far) = (background(&a, OFFSET), background(&b, DVec3::ZERO));
    let lonely_ones = [lonely(&near, &far), lonely(&far, &near)];
    println!(
        "{} and {} background points, without a partner {} and {}; ghosts {} and {}",
        near.len(),
        far.len(),
        lonely_ones[0].len(),
        lonely_ones[1].len(),
        reports[0].dropped_ghost,
        reports[1].dropped_ghost
    );
    assert!(near.len() > 750_000);
    // The comparison can fail: moved by 5 mm, most points have no match.
    let moved: Vec<[f64; 3]> = near.iter().step_by(50).map(|[x, y, z]| [*x, *y, z + 0.005]).collect();
    assert!(lonely(&moved, &far).len() > moved.len() / 2);
    // A point near the side of a box, or of the volume it sweeps, may be inside in one layout and outside in
    // the other.
    let log = nuscenes.recording();
    let frames: Vec<_> = log.frames.iter().collect();
    let trajectories = Trajectories::new(log, &frames);
    let splitters = RETAINED.map(|i| {
        Splitter::new(&frames[i].boxes, &trajectories, frames[i].t_us, &BuildOptions::default().split)
    });
    let near_a_side = |point: DVec3| splitters.iter().any(|splitter| is_at_a_side(splitter, point));
    for point in lonely_ones.iter().flatten() {
        assert!(near_a_side(*point), "{point}");
    }
    // Few points are near a side.
    let near_one = near.iter().step_by(50).filter(|p| near_a_side(DVec3::from(**p))).count();
    assert!(near_one * 50 < near.len() / 10, "{near_one} of {}", near.len() / 50);
}

/// Returns whether the classification of a sweep changes within 2 mm of a point.
fn is_at_a_side(splitter: &Splitter, point: DVec3) -> bool {
    let corner = |bits: i32| {
        let side = |bit: i32| if bits >> bit & 1 == 1 { PRECISION_M } else { -PRECISION_M };
        point + DVec3::new(side(0), side(1), side(2))
    };
    let is_background = |p: DVec3| splitter.part(p, true) == Part::Background;
    (0..8).any(|bits| is_background(corner(bits)) != is_background(point))
}

/// Returns the corners of a map's areas by kind.
fn corners(map: &VectorMap) -> Vec<(&'static str, Vec<DVec2>)> {
    let lanes = map.lanes.iter().chain(&map.lane_connectors);
    let of =
        |areas: &[point_skeleton::dataset::Area]| areas.iter().flat_map(|a| a.exterior.clone()).collect();
    vec![
        ("lanes", lanes.flat_map(|lane| lane.outline.exterior.clone()).collect()),
        ("crossings", of(&map.crossings)),
        ("stop lines", of(&map.stop_lines)),
    ]
}

#[test]
fn the_map_matches_the_other_layout() {
    let Some(folder) = folder() else { return };
    let map = open_nuplan(&folder).read_map().unwrap().unwrap();
    assert_eq!((map.lanes.len(), map.lane_connectors.len()), (8, 4));
    assert_eq!((map.crossings.len(), map.stop_lines.len(), map.dividers.len()), (2, 1, 22));
    assert_eq!(map.walkways.len(), 8);
    assert!(map.lanes.iter().chain(&map.lane_connectors).all(|lane| lane.centerline.len() > 1));
    // Lanes, stop lines and crossings consist of the other map's nodes.
    let file = folder.join("nuscenes/maps/expansion/pandaset-002.json");
    let json: Value = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
    let node = |n: &Value| [n["x"].as_f64().unwrap(), n["y"].as_f64().unwrap()];
    let nodes: Vec<[f64; 2]> = json["node"].as_array().unwrap().iter().map(node).collect();
    let tree = RTree::bulk_load(nodes);
    for (kind, points) in corners(&map) {
        let off = |p: &DVec2| {
            let at = (*p - OFFSET.truncate()).to_array();
            tree.nearest_neighbor(at).unwrap().distance_2(&at).sqrt()
        };
        let worst = points.iter().map(off).fold(0.0, f64::max);
        println!("{kind}: {} corners, at most {worst:.2e} m off", points.len());
        assert!(!points.is_empty() && worst < 1e-6, "{kind}: {worst} m");
    }
    let connector = map.lane_connectors.iter().find(|lane| lane.id == "68001").unwrap();
    assert_eq!(connector.successors, ["67005"]);
    assert_eq!(map.lanes.iter().find(|lane| lane.id == "67001").unwrap().successors, ["68001"]);
    // The lane connector through the intersection starts where the lane ends.
    let end = map.lanes.iter().find(|lane| lane.id == "67001").unwrap().centerline.last().unwrap();
    assert!(end.distance(connector.centerline[0]) < 1e-6);
}

/// Returns whether a point lies in a ring, from the number of edges that a ray to the right crosses.
fn is_in_ring(point: DVec2, ring: &[DVec2]) -> bool {
    let crosses = |i: usize| {
        let (a, b) = (ring[i], ring[(i + 1) % ring.len()]);
        (a.y > point.y) != (b.y > point.y) && point.x < a.x + (point.y - a.y) / (b.y - a.y) * (b.x - a.x)
    };
    (0..ring.len()).filter(|i| crosses(*i)).count() % 2 == 1
}

fn is_in_area(point: DVec2, exterior: &[DVec2], holes: &[Vec<DVec2>]) -> bool {
    is_in_ring(point, exterior) && !holes.iter().any(|hole| is_in_ring(point, hole))
}

/// The drivable area of the other layout is one polygon; here it consists of four layers, and one layer is
/// the whole junction.
#[test]
fn the_drivable_area_covers_the_other_layouts() {
    let Some(folder) = folder() else { return };
    let map = open_nuplan(&folder).read_map().unwrap().unwrap();
    let file = folder.join("nuscenes/maps/expansion/pandaset-002.json");
    let json: Value = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
    let find = |table: &str, token: &Value| -> Value {
        json[table].as_array().unwrap().iter().find(|r| &r["token"] == token).unwrap().clone()
    };
    let ring = |tokens: &Value| -> Vec<DVec2> {
        let node = |token: &Value| find("node", token);
        let at =
            |n: Value| DVec2::new(n["x"].as_f64().unwrap(), n["y"].as_f64().unwrap()) + OFFSET.truncate();
        tokens.as_array().unwrap().iter().map(node).map(at).collect()
    };
    let tokens = &json["drivable_area"][0]["polygon_tokens"];
    assert_eq!(tokens.as_array().unwrap().len(), 1);
    let polygon = find("polygon", &tokens[0]);
    let exterior = ring(&polygon["exterior_node_tokens"]);
    let holes: Vec<_> =
        polygon["holes"].as_array().unwrap().iter().map(|h| ring(&h["node_tokens"])).collect();
    let (min, max) =
        (exterior.iter().copied().reduce(DVec2::min), exterior.iter().copied().reduce(DVec2::max));
    let (min, size) = (min.unwrap(), max.unwrap() - min.unwrap());
    let [mut here, mut there, mut both] = [0; 3];
    for (i, j) in (0..size.x as u32).flat_map(|i| (0..size.y as u32).map(move |j| (i, j))) {
        let point = min + DVec2::new(f64::from(i), f64::from(j));
        let is_there = is_in_area(point, &exterior, &holes);
        let is_here = map.drivable_area.iter().any(|a| is_in_area(point, &a.exterior, &a.holes));
        here += u32::from(is_here);
        there += u32::from(is_there);
        both += u32::from(is_here && is_there);
    }
    println!("{here} m² here, {there} m² there, {both} m² in both");
    assert!(there > 3000 && f64::from(both) > 0.97 * f64::from(there), "{both} of {there}");
    assert!(f64::from(both) > 0.93 * f64::from(here), "{both} of {here}");
}
