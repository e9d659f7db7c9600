//! A frame of the synthetic street: six cameras of 900x1600, all maps except point numbers, with and without
//! reduction.
//!
//! `cargo bench`; with a filter, for instance `cargo bench -- cpu/full`.
#![allow(clippy::unwrap_used, clippy::print_stderr)] // a frame that cannot be rendered ends the benchmark

use std::hint::black_box;
use std::time::Duration;

use criterion::measurement::WallTime;
use criterion::{BenchmarkGroup, Criterion, SamplingMode, Throughput, criterion_group, criterion_main};
use point_skeleton::geometry::{ImageSize, View};
use point_skeleton::raster::{
    FrameJob, Instance, MapKind, MapSet, Occlusion, Rasterizer, RasterizerKind, SplatSchedule, create,
};
use pskel_eval::bench::{street_cloud, street_views};

const POINTS: usize = 400_000;
const KINDS: [RasterizerKind; 3] = [RasterizerKind::Compute, RasterizerKind::Graphics, RasterizerKind::Cpu];
const SIZES: [(&str, Option<ImageSize>); 2] =
    [("full", None), ("reduced", Some(ImageSize { height: 256, width: 448 }))];

fn frames(criterion: &mut Criterion) {
    let (cloud, views) = (street_cloud(POINTS, 1), street_views());
    for kind in KINDS {
        let mut group = criterion.benchmark_group(kind.to_string());
        group.sample_size(10).sampling_mode(SamplingMode::Flat);
        group.warm_up_time(Duration::from_secs(1)).measurement_time(Duration::from_secs(8));
        group.throughput(Throughput::Elements(POINTS as u64));
        match create(&kind.into(), vec![(&cloud).into()]) {
            Ok(mut rasterizer) => sizes(&mut group, rasterizer.as_mut(), &views),
            Err(error) => eprintln!("{kind} is left out: {error}"),
        }
        group.finish();
    }
}

fn sizes(group: &mut BenchmarkGroup<'_, WallTime>, rasterizer: &mut dyn Rasterizer, views: &[View]) {
    let schedule = SplatSchedule::default();
    let instances = [Instance { cloud: 0, world_from_local: glam::DAffine3::IDENTITY, number: 0 }];
    for (name, out_size) in SIZES {
        let maps = MapSet::SPLATTED.without(MapKind::Point);
        let job = FrameJob {
            views,
            schedule: &schedule,
            color: &instances,
            geometry: &instances,
            occlusion: Occlusion::Scene,
            crop: None,
            maps,
            out_size,
        };
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                rasterizer.begin(&job).unwrap();
                black_box(rasterizer.finish().unwrap().len())
            });
        });
    }
}

criterion_group!(benches, frames);
criterion_main!(benches);
