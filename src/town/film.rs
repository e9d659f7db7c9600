//! Images and LiDAR sweeps by casting rays.

use glam::DVec3;
use image::RgbImage;
use rayon::prelude::*;

use super::hash::{between, rough, unit};
use super::material::{Look, linear};
use super::shape::Ray;
use super::world::World;
use crate::dataset::SweepPoint;
use crate::geometry::{Camera, Pose};

/// Towards the sun, street frame.
const SUN: DVec3 = DVec3::new(0.42, -0.55, 0.72);
/// Beams of the LiDAR and their elevations, degrees.
const BEAMS: u16 = 64;
const ELEVATION_DEG: [f64; 2] = [-25.0, 12.0];
/// Azimuths of a turn.
const AZIMUTHS: u32 = 1800;
/// Nearest and farthest return, metres.
const RANGE_M: [f64; 2] = [0.9, 100.0];
/// Noise of a range, metres to either side.
const NOISE_M: f64 = 0.015;

/// The ground: a plane with asphalt and paint.
fn ground_look(p: DVec3) -> Look {
    let grain = 0.75 + 0.25 * rough(1, 0.35 * p.x, 0.8 * p.y) + 0.25 * rough(2, 9.0 * p.x, 9.0 * p.y);
    let worn = rough(5, 3.0 * p.x, 3.0 * p.y);
    let dashed = p.y.abs() < 0.08 && p.x.rem_euclid(6.0) < 3.0;
    let edge = (p.y.abs() - 3.5).abs() < 0.06;
    let zebra = (24.0..27.5).contains(&p.x) && p.y.abs() < 5.3 && p.y.rem_euclid(1.0) < 0.5;
    let paint = (dashed || edge || zebra) && worn > 0.25;
    let color = if paint { [0.86, 0.85, 0.80] } else { [0.36, 0.365, 0.38] };
    Look { color: linear(color) * grain, mirror: 0.0 }
}

fn sky(dir: DVec3) -> DVec3 {
    let up = dir.z.clamp(0.0, 1.0).sqrt();
    let cloud = if dir.z > 0.02 { rough(6, 1.5 * dir.x / dir.z, 1.5 * dir.y / dir.z) } else { 0.4 };
    let blue = linear([0.80, 0.87, 0.94]).lerp(linear([0.36, 0.58, 0.86]), up);
    blue.lerp(linear([0.95, 0.95, 0.96]), (cloud - 0.45).clamp(0.0, 0.4) * up * 2.0)
}

/// What a ray meets: distance in its length, point, unit normal, look.
fn meet(world: &World, ray: &Ray, t_max: f64) -> Option<(f64, DVec3, Look)> {
    let plane = if ray.dir.z < 0.0 { -ray.origin.z / ray.dir.z } else { f64::INFINITY };
    if let Some(hit) = world.cast(ray, t_max.min(plane)) {
        return Some((hit.t, hit.normal, hit.material.look(hit.local, hit.local_normal)));
    }
    (plane < t_max).then(|| (plane, DVec3::Z, ground_look(ray.at(plane))))
}

/// Linear light along a ray.
fn light(world: &World, ray: &Ray) -> DVec3 {
    let Some((t, normal, look)) = meet(world, ray, f64::INFINITY) else { return sky(ray.dir.normalize()) };
    let point = ray.at(t) + normal * 1e-3;
    let sun = SUN.normalize();
    let facing = normal.dot(sun).max(0.0);
    let lit = facing > 0.0 && !world.blocks(&Ray { origin: point, dir: sun });
    let direct = if lit { DVec3::new(1.0, 0.95, 0.86) * facing } else { DVec3::ZERO };
    let ambient = DVec3::new(0.40, 0.45, 0.52) * (0.75 + 0.25 * normal.z);
    let dir = ray.dir.normalize();
    let mirrored = sky(dir - 2.0 * dir.dot(normal) * normal);
    let own = (look.color * (direct + ambient)).lerp(mirrored, look.mirror);
    let haze = 1.0 - (-t * ray.dir.length() / 400.0).exp();
    own.lerp(linear([0.80, 0.87, 0.94]), haze)
}

/// What a camera sees; a pixel is the mean of four rays.
pub(super) fn image(world: &World, camera: &Camera, street_from_camera: &Pose) -> RgbImage {
    let camera_from_image = camera.intrinsics.inverse();
    let ray = |x: f64, y: f64| {
        let dir = street_from_camera.rotation * (camera_from_image * DVec3::new(x, y, 1.0));
        Ray { origin: street_from_camera.translation, dir }
    };
    let pixel = |i: usize| {
        let (x, y) = ((i as u32 % camera.width) as f64, (i as u32 / camera.width) as f64);
        let rays = [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)];
        let sum: DVec3 = rays.iter().map(|(dx, dy)| light(world, &ray(x + dx, y + dy))).sum();
        (sum / 4.0).to_array().map(|v| (v.clamp(0.0, 1.0).sqrt() * 255.0).round() as u8)
    };
    let pixels = camera.width as usize * camera.height as usize;
    let bytes: Vec<u8> = (0..pixels).into_par_iter().flat_map_iter(pixel).collect();
    RgbImage::from_fn(camera.width, camera.height, |x, y| {
        let i = 3 * (y as usize * camera.width as usize + x as usize);
        image::Rgb([bytes[i], bytes[i + 1], bytes[i + 2]])
    })
}

/// What a spinning LiDAR sees at one instant, in its own frame.
pub(super) fn sweep(world: &World, street_from_lidar: &Pose, seed: u64) -> Vec<SweepPoint> {
    let rays = u32::from(BEAMS) * AZIMUTHS;
    let cast = |i: u32| {
        let (ring, step) = ((i % u32::from(BEAMS)) as u16, i / u32::from(BEAMS));
        let share = f64::from(ring) / f64::from(BEAMS - 1);
        let elevation = (ELEVATION_DEG[0] + (ELEVATION_DEG[1] - ELEVATION_DEG[0]) * share).to_radians();
        let azimuth = std::f64::consts::TAU * f64::from(step) / f64::from(AZIMUTHS);
        let dir =
            DVec3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
        let ray = Ray { origin: street_from_lidar.translation, dir: street_from_lidar.rotation * dir };
        let (t, normal, look) = meet(world, &ray, RANGE_M[1])?;
        let lost = unit(seed, &[i64::from(i), 1]) < 0.02 + 0.5 * look.mirror;
        if lost || t < RANGE_M[0] {
            return None;
        }
        let range = t + between(seed, &[i64::from(i)], -NOISE_M, NOISE_M);
        let facing = -normal.dot(ray.dir);
        let intensity = (255.0 * look.color.element_sum() / 3.0 * facing).clamp(0.0, 255.0).round() as f32;
        Some(SweepPoint { position: (dir * range).as_vec3().to_array(), intensity, ring })
    };
    (0..rays).into_par_iter().filter_map(cast).collect()
}
