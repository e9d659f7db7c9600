//! Random clouds and cameras: the rasterizers must agree on every pixel of every plane.

use glam::{DAffine3, DQuat, DVec2, DVec3};
use point_skeleton::cloud::{Cloud, Point};
use point_skeleton::geometry::{Camera, View};
use point_skeleton::raster::reference::ReferenceRasterizer;
use point_skeleton::raster::{
    CloudSet, ComputeRasterizerDesc, Crop, GraphicsRasterizerDesc, Instance, MapSet, Rasterizer, SplatJob,
    SplatSchedule, SplatStep,
};

use pskel_testing::devices::{Division, assert_same, rasterizers, with_device};

/// SplitMix64 (Steele, Lea, Flood 2014): the same numbers for the same seed on every platform.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub(crate) fn below(&mut self, end: u64) -> u64 {
        self.next() % end
    }

    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// Returns a point near the camera's frustum; sometimes on the border of a pixel or a depth step, sometimes
/// invalid.
fn random_point(random: &mut Random, schedule: &SplatSchedule) -> Point {
    let steps = schedule.steps();
    let far = f64::from(schedule.z_far_m());
    let mut z = random.between(-0.1 * far, 1.2 * far) as f32;
    match random.below(8) {
        0 => z = steps[random.below(steps.len() as u64) as usize].z_max_m,
        1 => z = z.round(),
        2 => z *= 1e-3,
        _ => {}
    }
    let side = |random: &mut Random| random.between(-1.3, 1.3) as f32 * z;
    let mut position = [side(random), side(random), z];
    match random.below(64) {
        0 => position[random.below(3) as usize] = f32::NAN,
        1 => position[random.below(3) as usize] = f32::INFINITY,
        2 => position[random.below(3) as usize] = f32::NEG_INFINITY,
        3 => position = position.map(|v| v * 1e30),
        4..12 => position = position.map(f32::round),
        _ => {}
    }
    Point { position, rgb_class: random.next() as u32 }
}

pub(crate) fn random_cloud(random: &mut Random, schedule: &SplatSchedule, count: u64) -> Vec<Point> {
    let mut points: Vec<Point> = Vec::new();
    for _ in 0..count {
        // Every eighth point copies an earlier position: an exact tie.
        let copy = (random.below(8) == 0 && !points.is_empty())
            .then(|| points[random.below(points.len() as u64) as usize].position);
        let point = random_point(random, schedule);
        points.push(Point { position: copy.unwrap_or(point.position), ..point });
    }
    points
}

pub(crate) fn random_schedule(random: &mut Random) -> SplatSchedule {
    let (long, wide) = (random.below(4) == 0, random.below(4) == 0);
    let count = 1 + random.below(if long { 16 } else { 4 });
    let mut radius = random.below(if wide { 32 } else { 5 }) as u32;
    let mut z_max_m = 0.0;
    let step = |_| {
        z_max_m += 0.5 + random.below(16) as f32;
        radius = radius.saturating_sub(random.below(3) as u32);
        SplatStep { z_max_m, radius }
    };
    SplatSchedule::new((0..count).map(step).collect()).unwrap()
}

pub(crate) fn random_view(random: &mut Random) -> View {
    let (width, height) = (1 + random.below(180) as u32, 1 + random.below(120) as u32);
    let focal = if random.below(2) == 0 { 64.0 } else { random.between(20.0, 200.0) };
    let center = [f64::from(width) / 2.0, f64::from(height) / 2.0];
    let skew = if random.below(4) == 0 { 3.0 } else { 0.0 };
    let rows = [[focal, skew, center[0]], [0.0, focal * 0.75, center[1]], [0.0, 0.0, 1.0]];
    let camera = Camera::new("random", width, height, rows).unwrap();
    let shift = if random.below(2) == 0 { DVec3::ZERO } else { DVec3::new(664_430.0, 3_997_650.0, 606.0) };
    View { camera, camera_from_world: DAffine3::from_translation(-shift) }
}

pub(crate) fn random_instances(random: &mut Random, view: &View, clouds: usize) -> Vec<Instance> {
    let world_from_camera = view.camera_from_world.inverse();
    let count = 1 + random.below(4);
    let instance = |_| {
        let turn = DQuat::from_rotation_z(random.between(-0.5, 0.5));
        let shift =
            DVec3::new(random.between(-2.0, 2.0), random.between(-2.0, 2.0), random.between(-3.0, 3.0));
        let still = random.below(2) == 0;
        let local = if still { DAffine3::IDENTITY } else { DAffine3::from_rotation_translation(turn, shift) };
        Instance {
            cloud: random.below(clouds as u64) as usize,
            world_from_local: world_from_camera * local,
            number: random.next() as u32,
        }
    };
    (0..count).map(instance).collect()
}

fn compare_random_splats(seed: u64, sizes: &[u64], division: Division) {
    let random = &mut Random(seed);
    let schedule = random_schedule(random);
    let clouds: Vec<Vec<Point>> = sizes.iter().map(|n| random_cloud(random, &schedule, *n)).collect();
    let set: CloudSet<'_> = clouds.iter().map(Cloud::from).collect();
    with_device(|device| {
        let mut all = rasterizers(&device, &set, division);
        let mut cpu = ReferenceRasterizer::new(set.clone());
        for round in 0..6 {
            let view = random_view(random);
            let instances = random_instances(random, &view, clouds.len());
            let center = view.camera_from_world.inverse().translation;
            let crop = (random.below(2) == 0).then(|| Crop {
                center: DVec2::new(center.x.round(), center.y.round()),
                radius_m: random.below(20) as f64,
            });
            let job = SplatJob {
                view: &view,
                schedule: &schedule,
                instances: &instances,
                crop,
                maps: MapSet::SPLATTED,
            };
            let expected = cpu.splat(&job).unwrap();
            for rasterizer in &mut all {
                let found = rasterizer.splat(&job).unwrap();
                let name = rasterizer.info().rasterizer;
                let what = format!("{name} seed {seed} round {round} {schedule} {division:?}");
                assert_same(&expected, &found, &what);
            }
        }
    });
}

#[test]
pub(crate) fn random_clouds_agree() {
    for seed in 0..8 {
        compare_random_splats(seed, &[3000, 1, 700], Division::default());
    }
}

#[test]
fn buffers_and_tiles_do_not_change_the_maps() {
    for seed in 100..106 {
        let page_points = Some([8192, 4096, 17][seed as usize % 3]);
        let tile_side = Some([40, 7, 1000][seed as usize % 3]);
        let raster = GraphicsRasterizerDesc { page_points, tile_side, memory_bytes: None };
        let compute = ComputeRasterizerDesc {
            page_rows: Some([1, 2, 3][seed as usize % 3]),
            // The largest radius requires 32 rows of padding on either side of a row strip.
            key_rows: Some([72, 100, 130][seed as usize % 3]),
            ..ComputeRasterizerDesc::default()
        };
        compare_random_splats(seed, &[400, 0, 1900, 5, 9000], Division { raster, compute });
    }
}

#[test]
fn two_rasterizers_and_two_runs_give_the_same_bytes() {
    let random = &mut Random(7);
    let schedule = random_schedule(random);
    let cloud = random_cloud(random, &schedule, 20_000);
    let view = random_view(random);
    let instances = random_instances(random, &view, 1);
    let maps = MapSet::SPLATTED;
    let job = SplatJob { view: &view, schedule: &schedule, instances: &instances, crop: None, maps };
    with_device(|device| {
        let mut maps = Vec::new();
        for _ in 0..2 {
            for mut rasterizer in rasterizers(&device, &vec![(&cloud).into()], Division::default()) {
                maps.push(rasterizer.splat(&job).unwrap());
                maps.push(rasterizer.splat(&job).unwrap());
            }
        }
        assert!(maps[0].point.iter().any(|p| *p > 0) && maps.iter().all(|m| *m == maps[0]));
    });
}
