//! Clouds in files and small budgets: the maps are those of everything in memory.
//!
//! `PSKEL_STREAMED_FACTOR=650` does the same with 50 million points.

use std::path::Path;

use glam::{DAffine3, DMat3, DVec3};
use point_skeleton::cloud::paged::{PagedFile, PagedWriter};
use point_skeleton::cloud::{Cloud, Point, sort_in_space};
use point_skeleton::error::FileError;
use point_skeleton::geometry::{Camera, ImageSize, View};
use point_skeleton::gpu::Device;
use point_skeleton::raster::reference::ReferenceRasterizer;
use point_skeleton::raster::{
    CloudSet, ComputeRasterizer, ComputeRasterizerDesc, CpuRasterizer, CpuRasterizerDesc, FrameJob,
    GraphicsRasterizer, GraphicsRasterizerDesc, Instance, MapSet, Occlusion, RasterError, Rasterizer,
    SplatSchedule,
};
use std::sync::Arc;

use super::random::Random;
use pskel_testing::devices::with_device;

/// Side of a cloud, and distance to the next one, meters.
const SIDE_M: f64 = 30.0;
/// A place with city coordinates.
const CITY: DVec3 = DVec3::new(664_000.0, 3_997_000.0, 10.0);

/// Factor of the numbers of points of a drive, and of its budgets.
fn drive_factor() -> u64 {
    std::env::var("PSKEL_STREAMED_FACTOR").map_or(1, |factor| factor.parse().unwrap())
}

/// Clouds along a street: a file, the same points in memory, and their instances.
struct Street {
    file: PagedFile,
    points: Vec<Vec<Point>>,
    instances: Vec<Instance>,
}

fn street(folder: &Path, random: &mut Random, factor: u64) -> Street {
    let cloud = |count: u64, random: &mut Random| {
        let side = |random: &mut Random| random.between(0.0, SIDE_M) as f32;
        let point = |random: &mut Random| {
            let low = random.between(0.0, 3.0) as f32;
            Point { position: [side(random), side(random), low], rgb_class: random.next() as u32 }
        };
        let mut points: Vec<Point> = (0..count).map(|_| point(random)).collect();
        sort_in_space(&mut points);
        points
    };
    let sizes = [9000, 20_000, 4096, 0, 14_000, 300, 17_000, 12_000].map(|size| size * factor);
    let points: Vec<Vec<Point>> = sizes.iter().map(|count| cloud(*count, random)).collect();
    let mut writer = PagedWriter::create(&folder.join("points"), &folder.join("pages")).unwrap();
    points.iter().for_each(|points| writer.add(points).unwrap());
    let xxh3 = writer.finish().unwrap();
    let clouds = points.iter().enumerate().map(|(i, points)| (format!("cloud {i}"), points.len()));
    let file = PagedFile::open(&folder.join("points"), &folder.join("pages"), clouds, xxh3).unwrap();
    let instance = |(cloud, x): (usize, usize)| Instance {
        cloud,
        world_from_local: DAffine3::from_translation(
            CITY + DVec3::new(x as f64 * SIDE_M, -SIDE_M / 2.0, 0.0),
        ),
        number: 0,
    };
    // The last cloud is an actor that stands at two places.
    let mut instances: Vec<Instance> = (0..7).map(|cloud| instance((cloud, cloud))).collect();
    instances
        .extend([(1, instance((7, 2))), (2, instance((7, 5)))].map(|(number, i)| Instance { number, ..i }));
    Street { file, points, instances }
}

/// Two cameras at a place on the street that look in opposite directions.
fn views(x_m: f64, yaw: f64) -> [View; 2] {
    [yaw, yaw + std::f64::consts::PI].map(|yaw| {
        let rows = [[60.0, 0.0, 50.0], [0.0, 60.0, 30.0], [0.0, 0.0, 1.0]];
        let (sin, cos) = yaw.sin_cos();
        let rotation = DMat3::from_cols(DVec3::new(sin, -cos, 0.0), DVec3::NEG_Z, DVec3::new(cos, sin, 0.0));
        let eye = CITY + DVec3::new(x_m, 0.0, 1.5);
        let camera_from_world =
            DAffine3::from_mat3_translation(rotation.transpose(), -(rotation.transpose() * eye));
        View { camera: Camera::new("camera", 100, 60, rows).unwrap(), camera_from_world }
    })
}

fn job<'a>(street: &'a Street, views: &'a [View], schedule: &'a SplatSchedule) -> FrameJob<'a> {
    FrameJob {
        views,
        schedule,
        color: &street.instances[..8],
        geometry: &street.instances,
        occlusion: Occlusion::Scene,
        crop: None,
        maps: MapSet::SPLATTED,
        out_size: None,
    }
}

/// Rasterizers with budgets, in chunks of 4096 points.
fn rasterizers<'a>(
    device: &Arc<Device>,
    clouds: &CloudSet<'a>,
    chunks: u64,
    factor: u64,
) -> Vec<Result<Box<dyn Rasterizer + 'a>, RasterError>> {
    let chunks = chunks * factor;
    let cpu = CpuRasterizerDesc { memory_bytes: Some(chunks * 4096 * 17), ..CpuRasterizerDesc::default() };
    let cpu = CpuRasterizer::with_desc(clouds.clone(), cpu);
    let graphics = GraphicsRasterizerDesc {
        memory_bytes: Some(chunks * 4096 * 16),
        page_points: Some(3 * 4096 * factor as u32),
        ..GraphicsRasterizerDesc::default()
    };
    let graphics = GraphicsRasterizer::with_desc(device.clone(), clouds, graphics);
    let mut all: Vec<Result<Box<dyn Rasterizer + 'a>, RasterError>> = vec![
        Ok(Box::new(cpu)),
        graphics.map(|it| Box::new(it) as Box<dyn Rasterizer>).map_err(RasterError::from),
    ];
    if device.atomics_64() {
        let desc = ComputeRasterizerDesc {
            // Colors take half of the budget.
            memory_bytes: Some(2 * chunks * 4096 * 4),
            streamed_rows: Some(factor.min(512) as u32),
            page_rows: Some(2 * factor as u32),
            ..ComputeRasterizerDesc::default()
        };
        let compute = ComputeRasterizer::with_desc(device.clone(), clouds, desc);
        all.push(compute.map(|it| Box::new(it) as Box<dyn Rasterizer>).map_err(RasterError::from));
    }
    all
}

/// Renders a frame and returns its maps as bits.
fn frame(rasterizer: &mut dyn Rasterizer, job: &FrameJob<'_>) -> Result<Vec<[Vec<u32>; 4]>, RasterError> {
    rasterizer.begin(job)?;
    let view = |view: point_skeleton::raster::ViewMaps<'_>| {
        let depth = view.depth_m.iter().map(|depth_m| depth_m.to_bits()).collect();
        [view.rgb_class.into_owned(), depth, view.instance.into_owned(), view.point.into_owned()]
    };
    Ok(rasterizer.finish()?.into_iter().map(view).collect())
}

#[test]
fn drives_that_jump_look_as_if_everything_was_in_memory() {
    let (folder, random) = (tempfile::tempdir().unwrap(), &mut Random(43));
    let factor = drive_factor();
    let street = street(folder.path(), random, factor);
    let stored: CloudSet<'_> = street.file.clouds().map(Cloud::Stored).collect();
    let schedule: SplatSchedule = "5:3,20:1,40:0".parse().unwrap();
    let mut reference = ReferenceRasterizer::new(street.points.iter().map(Cloud::from).collect());
    with_device(|device| {
        let mut all: Vec<_> =
            rasterizers(&device, &stored, 16, factor).into_iter().map(Result::unwrap).collect();
        let (mut x_m, mut filled) = (0.0, 0);
        for step in 0..24 {
            x_m = if step % 5 == 4 { random.between(-20.0, 220.0) } else { x_m + random.between(0.0, 6.0) };
            let views = views(x_m, random.between(-3.0, 3.0));
            let mut job = job(&street, &views, &schedule);
            match step % 4 {
                1 => job.out_size = Some(ImageSize { height: 20, width: 33 }),
                2 => job.color = job.geometry,
                _ => {}
            }
            let expected = frame(&mut reference, &job).unwrap();
            filled += expected.iter().flat_map(|[_, _, _, point]| point).filter(|point| **point > 0).count();
            for rasterizer in &mut all {
                let found = frame(rasterizer.as_mut(), &job).unwrap();
                assert!(found == expected, "{} in step {step}", rasterizer.info().rasterizer);
            }
        }
        assert!(filled > 50_000, "{filled}");
    });
}

#[test]
fn budgets_that_a_frame_exceeds_are_refused_with_the_number() {
    let (folder, random) = (tempfile::tempdir().unwrap(), &mut Random(44));
    let street = street(folder.path(), random, 1);
    let stored: CloudSet<'_> = street.file.clouds().map(Cloud::Stored).collect();
    let (schedule, views) = (SplatSchedule::default(), views(60.0, 0.0));
    with_device(|device| {
        for (rasterizer, chunks) in rasterizers(&device, &stored, 4, 1).into_iter().zip([4, 4, 8]) {
            let mut rasterizer = match rasterizer {
                Ok(rasterizer) => rasterizer,
                Err(error) => {
                    let message = error.to_string();
                    assert!(message.contains("for points, found 0 MiB allowed (--gpu-memory)"), "{message}");
                    continue;
                }
            };
            let job = job(&street, &views, &schedule);
            let message = frame(rasterizer.as_mut(), &job).unwrap_err().to_string();
            assert!(message.starts_with("the cameras of a frame may see points of "), "{message}");
            assert!(message.contains("MiB are allowed (--"), "{chunks}: {message}");
            // Depth alone fits after a smaller frame too.
            let small = FrameJob { views: &[], ..job };
            frame(rasterizer.as_mut(), &small).unwrap();
        }
    });
}

#[test]
fn damaged_and_truncated_files_are_named_once_their_points_are_seen() {
    let (folder, random) = (tempfile::tempdir().unwrap(), &mut Random(45));
    let street = street(folder.path(), random, 1);
    let path = folder.path().join("points");
    let stored: CloudSet<'_> = street.file.clouds().map(Cloud::Stored).collect();
    let schedule: SplatSchedule = "20:1".parse().unwrap();
    // Some byte of the second cloud.
    let mut bytes = std::fs::read(&path).unwrap();
    bytes[(9000 + 5000) * 16] ^= 4;
    std::fs::write(&path, &bytes).unwrap();
    with_device(|device| {
        for rasterizer in rasterizers(&device, &stored, 100, 1) {
            let mut rasterizer = rasterizer.unwrap();
            let [far, near] = [200.0, 45.0].map(|x_m| views(x_m, 0.0));
            let good = frame(rasterizer.as_mut(), &job(&street, &far, &schedule)).unwrap();
            let message =
                frame(rasterizer.as_mut(), &job(&street, &near, &schedule)).unwrap_err().to_string();
            assert!(message.contains("expected page 1 of cloud 1 with checksum"), "{message}");
            assert!(message.ends_with(&path.display().to_string()), "{message}");
            // The rest of the street is as good as before.
            assert!(frame(rasterizer.as_mut(), &job(&street, &far, &schedule)).unwrap() == good);
        }
        std::fs::File::options().write(true).open(&path).unwrap().set_len(9000 * 16).unwrap();
        for rasterizer in rasterizers(&device, &stored, 100, 1) {
            let near = views(45.0, 0.0);
            let error = frame(rasterizer.unwrap().as_mut(), &job(&street, &near, &schedule)).unwrap_err();
            assert!(matches!(error, RasterError::Points(FileError::Content { .. })), "{error}");
            assert!(error.to_string().contains("found the end of the file (it was truncated)"), "{error}");
        }
    });
}
