//! Splats your own points into your own camera, without a log or a skeleton, and writes `splat.png`: `cargo
//! run --release --example splat_cloud`. Camera axes are x right, y down, z forward. Positions are `f32`: put
//! a nearby origin into `world_from_local`. For several cameras or reduced sizes see
//! `conditions::render_views`.

use std::path::Path;

use glam::{DAffine3, DVec3};
use point_skeleton::RasterizerKind;
use point_skeleton::cloud::Point;
use point_skeleton::geometry::{Camera, View};
use point_skeleton::raster::{Instance, MapKind, MapSet, SplatJob, SplatSchedule, create, rgb_of};

/// Writes an image of a sphere with radius 1 m, 5 m in front of a camera that looks along z.
pub fn run(kind: RasterizerKind, out: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let point = |i: u32| {
        let (y, angle) = (1.0 - f64::from(2 * i + 1) / 1e5, f64::from(i) * 2.399_963);
        let normal = DVec3::new(angle.cos(), 0.0, angle.sin()) * (1.0 - y * y).sqrt() + DVec3::Y * y;
        Point::new(normal.as_vec3().to_array(), [normal.x, y, normal.z].map(|v| (127.0 + 127.0 * v) as u8), 0)
    };
    let points: Vec<Point> = (0..100_000).map(point).collect();
    let camera = Camera::new("front", 400, 300, [[350.0, 0.0, 200.0], [0.0, 350.0, 150.0], [0.0, 0.0, 1.0]])?;
    let world_from_local = DAffine3::from_translation(DVec3::Z * 5.0);

    let mut rasterizer = create(&kind.into(), vec![(&points).into()])?;
    let maps = rasterizer.splat(&SplatJob {
        view: &View { camera, camera_from_world: DAffine3::IDENTITY },
        schedule: &"10:2,50:1".parse::<SplatSchedule>()?, // radius in pixels by depth in meters
        instances: &[Instance { cloud: 0, world_from_local, number: 1 }],
        crop: None,
        maps: MapSet::of(&[MapKind::Color, MapKind::Depth]),
    })?;
    let pixels = maps.rgb_class.iter().flat_map(|pixel| rgb_of(*pixel)).collect();
    Ok(image::RgbImage::from_raw(400, 300, pixels).ok_or("expected 400 x 300 pixels")?.save(out)?)
}

#[allow(dead_code)] // the tests call `run`
fn main() -> Result<(), Box<dyn std::error::Error>> {
    run(RasterizerKind::Auto, "splat.png".as_ref())
}
