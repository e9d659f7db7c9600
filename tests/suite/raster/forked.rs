//! Actors whose color comes from other points than their geometry: the maps differ in few rows alone.

use glam::{DAffine3, DVec3};
use point_skeleton::cloud::{Cloud, Point};
use point_skeleton::geometry::{Camera, ImageSize, View};
use point_skeleton::raster::reference::ReferenceRasterizer;
use point_skeleton::raster::{
    CloudSet, CpuRasterizer, FrameJob, Instance, MapKind, MapSet, Occlusion, SplatSchedule,
};

use super::frames::{assert_same, frame};
use super::random::Random;

/// Points per cloud of an actor, all within a cube of 20 cm.
const ACTOR: usize = 60;

fn point(random: &mut Random, position: [f64; 3]) -> Point {
    let color = [random.below(256) as u8, random.below(256) as u8, random.below(256) as u8];
    Point::new(position.map(|v| v as f32), color, 1 + random.below(4) as u8)
}

/// A view of 80x90 pixels along z.
fn view() -> View {
    let rows = [[60.0, 0.0, 40.3], [0.0, 60.0, 44.7], [0.0, 0.0, 1.0]];
    View { camera: Camera::new("c", 80, 90, rows).unwrap(), camera_from_world: DAffine3::IDENTITY }
}

/// Two walls, behind some actors and before others, with so many points that a block of them covers few rows.
fn background(random: &mut Random) -> Vec<Point> {
    let mut points = Vec::new();
    for _ in 0..60_000 {
        let z = [12.0, 25.0][random.below(2) as usize] + random.between(0.0, 0.5);
        let [x, y] = [random.between(-0.8, 0.8) * z, random.between(-0.9, 0.9) * z];
        points.push(point(random, [x, y, z]));
    }
    points
}

fn actor(random: &mut Random) -> Vec<Point> {
    let mut points = Vec::new();
    for _ in 0..ACTOR {
        let position = [0; 3].map(|_| random.between(-0.1, 0.1));
        points.push(point(random, position));
    }
    points
}

/// Places up to three actors, each in one of the clouds or in both.
fn place(random: &mut Random, color: &mut Vec<Instance>, geometry: &mut Vec<Instance>) {
    for number in 1..=random.below(4) as u32 {
        let z = random.between(4.0, 30.0);
        let at = DVec3::new(random.between(-0.7, 0.7) * z, random.between(-0.75, 0.75) * z, z);
        let instance = |cloud| Instance { cloud, world_from_local: DAffine3::from_translation(at), number };
        match random.below(4) {
            0 => color.push(instance(1)),
            1 => geometry.push(instance(2)),
            2 => [&mut *color, geometry].into_iter().for_each(|list| list.push(instance(1))),
            _ => {
                color.push(instance(1));
                geometry.push(instance(2));
            }
        }
    }
}

#[test]
fn clouds_may_differ_in_some_rows() {
    let random = &mut Random(9);
    let clouds = [background(random), actor(random), actor(random)];
    let set: CloudSet<'_> = clouds.iter().map(Cloud::from).collect();
    let mut reference = ReferenceRasterizer::new(set.clone());
    let mut rasterizer = CpuRasterizer::new(set);
    let schedules =
        ["15:2,35:1,100:0", "8:9,20:3,100:0", "100:0"].map(|text| text.parse::<SplatSchedule>().unwrap());
    let sizes = [(90, 80), (45, 40), (31, 23), (17, 80)].map(|(height, width)| ImageSize { height, width });
    for round in 0..300 {
        let all = Instance { cloud: 0, world_from_local: DAffine3::IDENTITY, number: 0 };
        let (mut color, mut geometry) = (vec![all], vec![all]);
        place(random, &mut color, &mut geometry);
        let job = FrameJob {
            views: &[view()],
            schedule: &schedules[random.below(3) as usize],
            color: &color,
            geometry: &geometry,
            occlusion: if random.below(3) == 0 { Occlusion::Actors } else { Occlusion::Scene },
            crop: None,
            maps: if random.below(4) == 0 {
                MapSet::of(&[MapKind::Color, MapKind::Point])
            } else {
                MapSet::SPLATTED
            },
            out_size: sizes.get(random.below(5) as usize).copied(),
        };
        let what = format!("round {round} {} {:?}", job.schedule, job.out_size);
        assert_same(&frame(&mut reference, &job), &frame(&mut rasterizer, &job), &what);
    }
}
