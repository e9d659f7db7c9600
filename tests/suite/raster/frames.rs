//! Frames: rendering all views and both clouds at once must equal rendering view by view, however the work is
//! divided.

use std::sync::Arc;

use glam::DVec2;
use point_skeleton::cloud::{Cloud, Point};
use point_skeleton::geometry::{ImageSize, View};
use point_skeleton::gpu::Device;
use point_skeleton::raster::reference::ReferenceRasterizer;
use point_skeleton::raster::{
    CloudSet, ComputeRasterizer, ComputeRasterizerDesc, Crop, FRAMES_IN_FLIGHT, FrameJob, Instance, MapKind,
    MapSet, Occlusion, RasterError, Rasterizer, SplatJob, SplatSchedule, ViewMaps,
};
use proptest::prelude::*;

use super::random::{Random, random_cloud, random_instances, random_schedule, random_view};
use pskel_testing::devices::{Division, rasterizers, with_compute_device, with_device};

/// Content of a random frame.
struct Scene {
    clouds: Vec<Vec<Point>>,
    schedule: SplatSchedule,
    views: Vec<View>,
    color: Vec<Instance>,
    geometry: Vec<Instance>,
    crop: Option<Crop>,
}

impl Scene {
    fn random(random: &mut Random, sizes: &[u64]) -> Self {
        let schedule = random_schedule(random);
        let clouds: Vec<_> = sizes.iter().map(|n| random_cloud(random, &schedule, *n)).collect();
        let mut scene = Self { clouds, schedule, views: vec![], color: vec![], geometry: vec![], crop: None };
        scene.change(random);
        scene
    }

    /// Changes cameras and instances, with the same clouds.
    fn change(&mut self, random: &mut Random) {
        let first = random_view(random);
        let views = 1 + random.below(3);
        self.views =
            (0..views).map(|_| View { camera: random_view(random).camera, ..first.clone() }).collect();
        let mut shared = random_instances(random, &first, self.clouds.len());
        shared.iter_mut().for_each(|instance| instance.number = 0);
        let list = |random: &mut Random| {
            let mut list = shared.clone();
            list.extend(random_instances(random, &first, self.clouds.len()));
            list
        };
        (self.color, self.geometry) = (list(random), list(random));
        if random.below(3) == 0 {
            self.geometry = self.color.clone();
        }
        let center = first.camera_from_world.inverse().translation;
        let center = DVec2::new(center.x.round(), center.y.round());
        self.crop = (random.below(2) == 0).then(|| Crop { center, radius_m: random.below(20) as f64 });
    }

    fn clouds(&self) -> CloudSet<'_> {
        self.clouds.iter().map(Cloud::from).collect()
    }

    fn job(&self, random: &mut Random) -> FrameJob<'_> {
        let bits = random.below(32);
        let kinds = [MapKind::Color, MapKind::Depth, MapKind::Class, MapKind::Instance, MapKind::Point];
        let kinds = kinds.into_iter().enumerate();
        let maps = kinds
            .fold(MapSet::NONE, |maps, (i, kind)| if bits >> i & 1 == 1 { maps.with(kind) } else { maps });
        let size = |random: &mut Random| ImageSize {
            height: 1 + random.below(70) as u32,
            width: 1 + random.below(100) as u32,
        };
        FrameJob {
            views: &self.views,
            schedule: &self.schedule,
            color: &self.color,
            geometry: &self.geometry,
            occlusion: if random.below(2) == 0 { Occlusion::Scene } else { Occlusion::Actors },
            crop: self.crop,
            maps: if random.below(3) == 0 { MapSet::SPLATTED } else { maps },
            out_size: (random.below(3) > 0).then(|| size(random)),
        }
    }
}

pub(super) fn frame(rasterizer: &mut dyn Rasterizer, job: &FrameJob<'_>) -> Vec<ViewMaps<'static>> {
    rasterizer.begin(job).unwrap();
    rasterizer.finish().unwrap().into_iter().map(owned).collect()
}

fn owned(maps: ViewMaps<'_>) -> ViewMaps<'static> {
    ViewMaps {
        size: maps.size,
        rgb_class: maps.rgb_class.into_owned().into(),
        depth_m: maps.depth_m.into_owned().into(),
        instance: maps.instance.into_owned().into(),
        point: maps.point.into_owned().into(),
    }
}

/// Returns how many values differ in any map; all of them if lengths differ.
fn differing(a: &ViewMaps<'_>, b: &ViewMaps<'_>) -> usize {
    fn count<T: PartialEq>(a: &[T], b: &[T]) -> usize {
        if a.len() == b.len() {
            a.iter().zip(b).filter(|(a, b)| a != b).count()
        } else {
            a.len().max(b.len())
        }
    }
    if a.size != b.size {
        return a.size.pixels();
    }
    count(&a.rgb_class, &b.rgb_class)
        .max(count(&a.depth_m, &b.depth_m))
        .max(count(&a.instance, &b.instance))
        .max(count(&a.point, &b.point))
}

pub(super) fn assert_same(expected: &[ViewMaps<'_>], found: &[ViewMaps<'_>], what: &str) {
    assert_eq!(expected.len(), found.len(), "{what}");
    for (view, (a, b)) in expected.iter().zip(found).enumerate() {
        let (count, pixels) = (differing(a, b), a.size.pixels());
        assert_eq!(count, 0, "{what}: {count} of {pixels} differ in view {view}");
    }
}

/// Compares frames of random scenes between all rasterizers of a device and the CPU rasterizer.
fn compare(seed: u64, sizes: &[u64], compute: ComputeRasterizerDesc, rounds: usize) {
    let random = &mut Random(seed);
    let scene = Scene::random(random, sizes);
    compare_scene(scene, random, compute, rounds);
}

/// Compares frames of a scene that changes randomly; returns how many of them used the `spread` stage.
fn compare_scene(
    mut scene: Scene,
    random: &mut Random,
    compute: ComputeRasterizerDesc,
    rounds: usize,
) -> usize {
    let seed = random.0;
    let mut spread = 0;
    with_device(|device| {
        let clouds = scene.clouds.clone();
        let set: CloudSet<'_> = clouds.iter().map(Cloud::from).collect();
        let division = Division { compute, ..Division::default() };
        let mut all = rasterizers(&device, &set, division);
        let mut cpu = ReferenceRasterizer::new(set.clone());
        for round in 0..rounds {
            let job = scene.job(random);
            let expected = frame(&mut cpu, &job);
            for rasterizer in &mut all {
                let what = format!(
                    "{} seed {seed} round {round} {} {:?} {:?} {:?} {compute:?}",
                    rasterizer.info().rasterizer,
                    job.schedule,
                    job.maps,
                    job.occlusion,
                    job.out_size,
                );
                assert_same(&expected, &frame(rasterizer.as_mut(), &job), &what);
                spread += usize::from(rasterizer.take_stages().0.contains_key("spread"));
            }
            scene.change(random);
        }
    });
    spread
}

/// Returns a description with the minimum memory for clouds of these sizes, and few rows.
fn divided(sizes: &[u64], key_rows: u32, page_rows: u32, streamed_rows: u32) -> ComputeRasterizerDesc {
    let chunks: u64 = sizes.iter().map(|n| n.div_ceil(4096)).sum();
    ComputeRasterizerDesc {
        memory_bytes: Some(chunks * 4096 * 4 + 2 * u64::from(streamed_rows) * 4096 * 16),
        page_rows: Some(page_rows),
        key_rows: Some(key_rows),
        streamed_rows: Some(streamed_rows),
        copies: false,
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_frames_agree(seed: u64, sizes in prop::collection::vec(0..6000_u64, 1..4)) {
        compare(seed, &sizes, ComputeRasterizerDesc::default(), 5);
    }

    #[test]
    fn batches_buffers_and_streams_do_not_change_the_maps(
        seed: u64,
        sizes in prop::collection::vec(0..15_000_u64, 2..5),
        key_rows in 70..400_u32,
        page_rows in 1..4_u32,
        streamed_rows in 1..3_u32,
    ) {
        compare(seed, &sizes, divided(&sizes, key_rows, page_rows, streamed_rows), 4);
    }
}

/// Many points with squares too large to gather: several radii at once, split into batches, streamed or not.
#[test]
fn large_squares_of_many_points_agree() {
    let mut spread = 0;
    for (seed, schedule) in
        (40..).zip(["16:31", "2:31,5:17,9:16,11:3,14:2,16:0", "3:5,16:1", "8:3,16:3", "1:8,2:7,3:6,4:5,16:4"])
    {
        let random = &mut Random(seed);
        let sizes = [9000, 500, 4000];
        let schedule: SplatSchedule = schedule.parse().unwrap();
        let clouds = sizes.iter().map(|n| random_cloud(random, &schedule, *n)).collect();
        let mut scene = Scene::random(random, &sizes);
        (scene.clouds, scene.schedule) = (clouds, schedule);
        scene.change(random);
        let whole = ComputeRasterizerDesc::default();
        let desc = if seed % 2 == 0 { whole } else { divided(&sizes, 80, 1, 2) };
        spread += compare_scene(scene, random, desc, 6);
    }
    with_compute_device(|_| assert!(spread >= 20, "{spread} frames were spread"));
}

/// If few of many rows remain, row strips of one view share a batch.
#[test]
fn row_strips_of_a_view_may_share_a_batch() {
    let sizes = [8031, 8811, 12753];
    compare(5_950_116_398_762_583_034, &sizes, divided(&sizes, 97, 1, 2), 4);
}

fn compute<'a>(device: &Arc<Device>, clouds: &CloudSet<'a>) -> ComputeRasterizer<'a> {
    ComputeRasterizer::new(device.clone(), clouds).unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn frames_in_flight_finish_in_order() {
    let random = &mut Random(11);
    let scene = Scene::random(random, &[5000, 300]);
    let full = FrameJob { maps: MapSet::SPLATTED, out_size: None, ..scene.job(random) };
    let reduced = FrameJob { out_size: Some(ImageSize { height: 9, width: 13 }), ..full };
    with_compute_device(|device| {
        let mut cpu = ReferenceRasterizer::new(scene.clouds());
        let mut rasterizer = compute(&device, &scene.clouds());
        assert!(matches!(rasterizer.finish(), Err(RasterError::NoFrame)));
        let expected = [frame(&mut cpu, &full), frame(&mut cpu, &reduced)];
        for _ in 0..3 {
            rasterizer.begin(&full).unwrap();
            rasterizer.begin(&reduced).unwrap();
            let error = rasterizer.begin(&reduced).unwrap_err();
            assert!(matches!(error, RasterError::TooManyFrames { max: FRAMES_IN_FLIGHT }), "{error}");
            // A synchronous splat does not disturb the frames in flight.
            let FrameJob { schedule, geometry: instances, crop, .. } = reduced;
            let alone =
                SplatJob { view: &reduced.views[0], schedule, instances, crop, maps: MapSet::SPLATTED };
            let (a, b) = (cpu.splat(&alone).unwrap(), rasterizer.splat(&alone).unwrap());
            pskel_testing::devices::assert_same(&a, &b, "at once");
            for expected in &expected {
                let found: Vec<_> = rasterizer.finish().unwrap().into_iter().map(owned).collect();
                assert_same(expected, &found, "in flight");
            }
        }
    });
}

#[test]
fn a_warm_rasterizer_allocates_nothing() {
    let random = &mut Random(5);
    let mut scene = Scene::random(random, &[20_000, 3000]);
    scene.color.truncate(2);
    with_compute_device(|device| {
        let clouds = scene.clouds.clone();
        let set: CloudSet<'_> = clouds.iter().map(Cloud::from).collect();
        let mut rasterizer = compute(&device, &set);
        let frames = |rasterizer: &mut ComputeRasterizer<'_>, scene: &mut Scene, count: usize| {
            for _ in 0..count {
                // Actors move while two frames are in flight.
                for instance in scene.color.iter_mut().chain(&mut scene.geometry) {
                    instance.world_from_local.translation.x += 0.01;
                }
                for out_size in [None, Some(ImageSize { height: 4, width: 5 })] {
                    let maps = MapSet::SPLATTED;
                    let occlusion = Occlusion::Actors;
                    let job = FrameJob { maps, occlusion, out_size, ..scene.job(&mut Random(1)) };
                    rasterizer.begin(&job).unwrap();
                }
                rasterizer.finish().unwrap();
                rasterizer.finish().unwrap();
            }
        };
        let before = device.made();
        frames(&mut rasterizer, &mut scene, 2);
        let warm = device.made();
        assert!(warm.allocations > before.allocations, "the counter counts");
        frames(&mut rasterizer, &mut scene, 5);
        assert_eq!(device.made(), warm);
    });
}

#[test]
fn too_little_memory_is_an_error() {
    let points = vec![Point::default(); 40_000];
    with_compute_device(|device| {
        let desc = ComputeRasterizerDesc { memory_bytes: Some(1 << 16), ..ComputeRasterizerDesc::default() };
        let error =
            ComputeRasterizer::with_desc(device, &vec![(&points).into()], desc).err().unwrap().to_string();
        assert!(error.contains("at least 1 MiB for points") && error.contains("0 MiB allowed"), "{error}");
    });
}

#[test]
fn positions_beyond_the_allowed_memory_are_streamed() {
    let random = &mut Random(21);
    let scene = Scene::random(random, &[60_000]);
    let job = FrameJob { maps: MapSet::SPLATTED, crop: None, ..scene.job(random) };
    with_compute_device(|device| {
        let streams = |memory_bytes| {
            let desc = ComputeRasterizerDesc { memory_bytes, streamed_rows: Some(2), ..Default::default() };
            let mut rasterizer = ComputeRasterizer::with_desc(device.clone(), &scene.clouds(), desc).unwrap();
            frame(&mut rasterizer, &job);
            rasterizer.take_stages();
            let maps = frame(&mut rasterizer, &job);
            (rasterizer.take_stages().0.contains_key("stream"), maps)
        };
        let chunks = 60_000_u64.div_ceil(4096);
        let (resident, expected) = streams(None);
        let (streamed, found) = streams(Some(chunks * 4096 * 4 + 5 * 4096 * 16));
        assert_eq!((resident, streamed), (false, true));
        assert!(expected.iter().any(|view| view.point.iter().any(|p| *p > 0)));
        assert_same(&expected, &found, "streamed");
    });
}
