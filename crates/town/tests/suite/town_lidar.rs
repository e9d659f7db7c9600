//! Sweeps of a skeleton against beams that are cast through the town itself, from other poses than recorded.

use std::collections::{HashMap, HashSet};
use std::sync::LazyLock;

use glam::DVec3;
use point_skeleton::dataset::{EgoTrack, LogReader};
use point_skeleton::lidar::{LidarSpec, LidarSweep, Motion};
use point_skeleton::raster::RasterizerKind;
use point_skeleton::scene::{EgoOffset, SceneClouds, SceneState, Substitutes, state_at};
use point_skeleton::skeleton::{BuildOptions, Skeleton};
use point_skeleton::{RenderOptions, Renderer};
use pskel_testing::devices::{Division, rasterizers, with_device};
use pskel_testing::shared::{WithLog, skeleton_of};
use pskel_testing::synthetic_town::other_town;
use pskel_town::{Town, TownRay};

/// Greatest range that is compared, meters.
const FAR_M: f64 = 60.0;
/// Distance of points that agree, meters.
const NEAR_M: f64 = 0.1;
/// Distance behind the plane of the true surface from which on a point is behind it, meters.
const BEHIND_M: f64 = 0.1;
/// Angle between the rays that find the plane of the true surface, radians.
const TILT_RAD: f64 = 2e-4;

/// A town, and a skeleton of all its frames in gray.
struct Built {
    town: Town,
    skeleton: Skeleton,
    _folder: tempfile::TempDir,
}

static BUILT: LazyLock<Built> = LazyLock::new(|| {
    let town = other_town("seed=7,frames=16,size=90x160");
    let frames: Vec<usize> = (0..town.recording().frames.len()).collect();
    let folder = tempfile::tempdir().unwrap();
    let gray = WithLog::grey(&town, &frames);
    let skeleton = skeleton_of(&folder.path().join("s"), &gray, &frames, &BuildOptions::default());
    Built { town, skeleton, _folder: folder }
});

/// Returns the states of a frame and 0.1 s before it, moved by 2 m and 5 degrees.
fn states(town: &Town, frame: usize) -> [SceneState; 2] {
    let (log, offset) = (town.recording(), EgoOffset { left_m: 2.0, yaw_deg: 5.0, ..EgoOffset::default() });
    let track = EgoTrack::new(log);
    let t_us = log.frames[frame].t_us;
    [t_us, t_us - 100_000].map(|t_us| state_at(log, &track, t_us, offset).unwrap())
}

fn spec(name: &str) -> LidarSpec {
    let mut spec = LidarSpec::named(name).unwrap().mounted_at(DVec3::new(0.94, 0.0, 1.84));
    spec.devices.iter_mut().for_each(|device| device.range_m[1] = FAR_M);
    spec
}

/// Where a ray meets the town: its range, and the unit normal of the surface toward the sensor, both in the
/// frame of the device at the time of the ray.
#[derive(Clone, Copy)]
struct Truth {
    direction: DVec3,
    range_m: f64,
    normal: DVec3,
}

/// Returns where each ray of a single device meets the town, beam by beam.
fn truth(town: &Town, spec: &LidarSpec, motion: &Motion<'_>) -> Vec<Option<Truth>> {
    let (device, t_us) = (&spec.devices[0], motion.state().t_us);
    let (mut rays, mut directions) = (Vec::new(), Vec::new());
    for beam in 0..device.elevations_deg.len() {
        for column in 0..device.columns {
            let after_s = device.offset_s(column);
            let global_from_lidar = motion.ego(after_s) * device.ego_from_lidar();
            let direction = device.direction(beam, column);
            let across = direction.any_orthonormal_vector();
            let tilted = [across, direction.cross(across)].map(|to| (direction + to * TILT_RAD).normalize());
            for direction in [direction, tilted[0], tilted[1]] {
                rays.push(TownRay {
                    t_us: t_us + (after_s * 1e6).round() as i64,
                    origin: global_from_lidar.translation,
                    direction: global_from_lidar.rotation * direction,
                });
                directions.push(direction);
            }
        }
    }
    let ranges = town.ranges_m(t_us, &rays);
    let meet = |(ranges, directions): (&[Option<f64>], &[DVec3])| {
        let range_m = ranges[0].filter(|range_m| *range_m <= FAR_M)?;
        let at = [0, 1, 2].map(|i| directions[i] * ranges[i].unwrap_or(range_m));
        let normal = (at[1] - at[0]).cross(at[2] - at[0]).normalize_or(directions[0]);
        let normal = normal * -normal.dot(directions[0]).signum();
        Some(Truth { direction: directions[0], range_m, normal })
    };
    ranges.chunks(3).zip(directions.chunks(3)).map(meet).collect()
}

impl Truth {
    /// Returns how far a range along the ray is behind the plane of the surface, meters.
    fn behind_m(&self, range_m: f64) -> f64 {
        (range_m - self.range_m) * -self.normal.dot(self.direction)
    }
}

/// Returns the share of points with another one within [`NEAR_M`].
fn matched(points: &[DVec3], others: &[DVec3]) -> f64 {
    let cell = |at: DVec3| (at / NEAR_M).floor().as_ivec3().to_array();
    let mut cells: HashMap<[i32; 3], Vec<DVec3>> = HashMap::new();
    others.iter().for_each(|at| cells.entry(cell(*at)).or_default().push(*at));
    let around: Vec<[i32; 3]> =
        (-1..=1).flat_map(|x| (-1..=1).flat_map(move |y| (-1..=1).map(move |z| [x, y, z]))).collect();
    let is_near = |at: &&DVec3| {
        let own = cell(**at);
        let near = around.iter().filter_map(|step| cells.get(&[0, 1, 2].map(|i| own[i] + step[i])));
        near.flatten().any(|other| other.distance(**at) <= NEAR_M)
    };
    points.iter().filter(is_near).count() as f64 / points.len() as f64
}

/// Returns the points of ranges along the rays of a device, in the frame of the device at each time: enough
/// to compare points of the same rays.
fn points(spec: &LidarSpec, range_m: impl Iterator<Item = Option<f64>>) -> Vec<DVec3> {
    let device = &spec.devices[0];
    let at = |(index, range_m): (usize, Option<f64>)| {
        Some(device.direction(index / device.columns, index % device.columns) * range_m?)
    };
    range_m.enumerate().filter_map(at).collect()
}

/// The sensor is moved by 2 m and 5 degrees, and drives while it turns. What is behind is seen where the
/// skeleton has few points of a car nearby.
#[test]
fn sweeps_agree_with_beams_through_the_town() {
    let Built { town, skeleton, .. } = &*BUILT;
    let options = RenderOptions { rasterizer: RasterizerKind::Cpu.into(), ..RenderOptions::default() };
    let mut renderer = Renderer::new(skeleton, options).unwrap();
    let (name, frame) = ("hdl-32e", 8);
    let (spec, [now, before]) = (spec(name), states(town, frame));
    let motion = Motion::new(&now, Some(&before));
    let sweep = renderer.lidar(&spec, &motion).unwrap();
    let truth = truth(town, &spec, &motion);
    let found = |range_m: &f32| (*range_m > 0.0).then(|| f64::from(*range_m));
    let ranges: Vec<Option<f64>> = sweep.devices[0].range_m.iter().map(found).collect();
    let both: Vec<(f64, Truth)> =
        ranges.iter().zip(&truth).filter_map(|(found, truth)| Some(((*found)?, (*truth)?))).collect();
    let mut errors: Vec<f64> = both.iter().map(|(found, truth)| found - truth.range_m).collect();
    let returns = ranges.iter().flatten().count();
    let is_behind = |(found, truth): &&(f64, Truth)| truth.behind_m(*found) > BEHIND_M;
    let behind = both.iter().filter(is_behind).count() as f64 / returns as f64;
    errors.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    let median_m = errors[errors.len() / 2].abs();
    let true_ranges = truth.iter().map(|truth| truth.map(|truth| truth.range_m));
    let (own, true_points) = (points(&spec, ranges.iter().copied()), points(&spec, true_ranges));
    let (precision, recall) = (matched(&own, &true_points), matched(&true_points, &own));
    let f_score = 2.0 * precision * recall / (precision + recall);
    println!(
        "{name}: {returns} returns, {} true; median {median_m:.4} m, precision {precision:.4}, recall \
         {recall:.4}, F {f_score:.4}, behind {behind:.4}",
        true_points.len()
    );
    assert!(median_m <= 0.03 && f_score >= 0.9 && behind <= 0.05);
}

/// The same bytes on all rasterizers and with any number of threads.
#[test]
fn sweeps_do_not_depend_on_rasterizers_and_threads() {
    let Built { town, skeleton, .. } = &*BUILT;
    let (mut spec, [now, before]) = (spec("av2"), states(town, 6));
    spec.devices.iter_mut().for_each(|device| device.columns = 120);
    let motion = Motion::new(&now, Some(&before));
    let render = |mut renderer: Renderer<'_>| renderer.lidar(&spec, &motion).unwrap();
    let cpu = || {
        let options = RenderOptions { rasterizer: RasterizerKind::Cpu.into(), ..RenderOptions::default() };
        render(Renderer::new(skeleton, options).unwrap())
    };
    let with = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(cpu);
    let expected: LidarSweep = with(1);
    assert!(expected.count() > 5000 && expected == with(3), "{}", expected.count());
    let actors: HashSet<u32> = expected.returns().map(|r| r.instance).collect();
    assert!(actors.len() > 2 && actors.iter().all(|actor| *actor as usize <= now.actors.len()));
    with_device(|device| {
        let clouds = || SceneClouds::with(skeleton, &town.recording().name, Substitutes::built_in());
        for rasterizer in rasterizers(&device, &clouds().cloud_set(), Division::default()) {
            let name = rasterizer.info().rasterizer;
            let renderer = Renderer::with_rasterizer(clouds(), rasterizer, Default::default());
            assert!(render(renderer) == expected, "{name}");
        }
    });
}
