//! Skipping hidden points changes no map.

use point_skeleton::cloud::{Cloud, Point};
use point_skeleton::geometry::{Camera, View};
use point_skeleton::raster::reference::ReferenceRasterizer;
use point_skeleton::raster::{
    CloudSet, CpuRasterizer, CpuRasterizerDesc, Instance, MapSet, Rasterizer, SplatJob, SplatMaps,
    SplatSchedule,
};

use super::random::Random;
use pskel_testing::devices::assert_same;

/// A camera at the origin that looks along z, turned by an angle in degrees.
fn view(turn_deg: f64) -> View {
    let rows = [[60.0, 0.0, 40.3], [0.0, 60.0, 24.7], [0.0, 0.0, 1.0]];
    let camera = Camera::new("c", 80, 50, rows).unwrap();
    View { camera, camera_from_world: glam::DAffine3::from_rotation_y(turn_deg.to_radians()) }
}

/// Walls of so many points at some depths, each with a hole of one pixel, and a slope of points behind each
/// other.
fn walls(random: &mut Random, count: usize, depths_m: &[f64]) -> Vec<Point> {
    let mut points = Vec::new();
    let color = |random: &mut Random| [random.below(256) as u8, random.below(256) as u8, 7];
    for (wall, depth_m) in depths_m.iter().enumerate() {
        for _ in 0..count {
            let at = [random.between(0.0, 80.0), random.between(0.0, 50.0)];
            let hole = [20 + 7 * wall, 11 + 5 * wall];
            if at.map(|v| v as usize) == hole {
                continue;
            }
            // A third of a wall's points have exactly its depth.
            let z = if random.below(3) == 0 { *depth_m } else { depth_m + random.between(0.0, 0.3) };
            let position = [(at[0] - 40.3) / 60.0 * z, (at[1] - 24.7) / 60.0 * z, z];
            points.push(Point::new(position.map(|v| v as f32), color(random), 3));
        }
    }
    for _ in 0..40_000 {
        let (x, z) = (random.between(-6.0, 6.0), random.between(2.0, 90.0));
        points.push(Point::new([x as f32, 1.5, z as f32], color(random), 2));
    }
    points
}

fn splat(
    rasterizer: &mut dyn Rasterizer,
    schedule: &SplatSchedule,
    view: &View,
    instances: &[Instance],
) -> SplatMaps {
    rasterizer.splat(&SplatJob { view, schedule, instances, crop: None, maps: MapSet::SPLATTED }).unwrap()
}

#[test]
fn skipping_hidden_points_changes_nothing() {
    let random = &mut Random(5);
    let near = walls(random, 60_000, &[6.0, 14.99, 15.0]);
    let far = walls(random, 60_000, &[9.0, 34.9, 35.1, 60.0]);
    // About one point per pixel and wall: their squares have gaps.
    let sparse = walls(random, 4_000, &[7.0, 7.5, 8.0, 8.5, 9.5, 14.5, 15.5, 33.0, 34.0, 36.0, 50.0]);
    let clouds: CloudSet<'_> = [&near, &far, &sparse].map(Cloud::from).into();
    let mut reference = ReferenceRasterizer::new(clouds.clone());
    // The camera jumps, and so does the second cloud.
    let places = [(0.0, 0.0), (3.0, -4.0), (-40.0, 8.0), (180.0, 0.0), (0.0, 0.0)];
    for text in ["15:2,35:1,100:0", "100:0", "5:9,35:3,100:1"] {
        let schedule: SplatSchedule = text.parse().unwrap();
        let mut all = [true, false].map(|occlusion_culling| {
            CpuRasterizer::with_desc(
                clouds.clone(),
                CpuRasterizerDesc { occlusion_culling, memory_bytes: None },
            )
        });
        for (turn_deg, shift_m) in places {
            let view = view(turn_deg);
            let instance = |cloud: usize, z: f64| Instance {
                cloud,
                world_from_local: glam::DAffine3::from_translation(glam::DVec3::new(0.0, 0.0, z)),
                number: cloud as u32,
            };
            let dense = [instance(0, 0.0), instance(1, shift_m), instance(2, 1.0)];
            let sparse = [instance(2, 0.0), instance(2, shift_m), instance(1, 30.0)];
            for instances in [dense, sparse] {
                let expected = splat(&mut reference, &schedule, &view, &instances);
                for rasterizer in &mut all {
                    let found = splat(rasterizer, &schedule, &view, &instances);
                    assert_same(&expected, &found, &format!("{text} {turn_deg} {shift_m}"));
                }
            }
        }
    }
}
