//! Preview images of category templates.

use std::path::Path;

use glam::{DAffine3, DMat3, DVec3};

use crate::cloud::{Bounds, Point};
use crate::conditions::write::png;
use crate::error::FileError;
use crate::geometry::{Camera, CameraError, ImageSize, View};
use crate::raster::reference::ReferenceRasterizer;
use crate::raster::{
    Instance, MapKind, MapSet, RasterError, Rasterizer, ScheduleError, SplatJob, SplatSchedule, SplatStep,
};
use crate::skeleton::TemplateCloud;

/// Error of a preview image.
#[derive(Debug, thiserror::Error)]
pub enum PreviewError {
    /// No camera can view the bounds.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The bounds are too large for a splat schedule.
    #[error(transparent)]
    Schedule(#[from] ScheduleError),
    /// The points cannot be rendered.
    #[error("cannot draw a template")]
    Raster(#[from] RasterError),
    /// The image cannot be written.
    #[error(transparent)]
    File(#[from] FileError),
}

/// Writes a preview image `KIND.png` of each template into a folder.
///
/// # Errors
/// Fails if a template cannot be rendered or if an image cannot be written.
pub fn write_all(folder: &Path, clouds: &[TemplateCloud]) -> Result<(), PreviewError> {
    for (template, points) in clouds {
        let (pixels, size) = draw(points, &template.bounds)?;
        png::write_rgb(&folder.join(format!("{}.png", template.kind.name())), &pixels, size)?;
    }
    Ok(())
}

/// Size of a view in the image, pixels.
const WIDTH: u32 = 480;
const HEIGHT: u32 = 360;
/// Distance of the camera in radii, large for little perspective.
const RADII_AWAY: f64 = 8.0;
/// Share of a view that the bounds fill.
const FILLS: f64 = 0.85;

/// Renders points from four sides, nearer points brighter: from the right, from above (front to the right),
/// from the front right, and from behind left.
fn draw(points: &[Point], bounds: &Bounds) -> Result<(Vec<[u8; 3]>, ImageSize), PreviewError> {
    let size = ImageSize { height: 2 * HEIGHT, width: 2 * WIDTH };
    let mut pixels = vec![[0; 3]; size.pixels()];
    let views = [
        (DVec3::NEG_Y, DVec3::Z),
        (DVec3::Z, DVec3::Y),
        (DVec3::new(1.0, -1.0, 0.5), DVec3::Z),
        (DVec3::new(-1.0, 1.0, 0.5), DVec3::Z),
    ];
    for (place, (from, up)) in views.into_iter().enumerate() {
        let grey = panel(points, bounds, from.normalize(), up)?;
        let (left, top) = (place % 2 * WIDTH as usize, place / 2 * HEIGHT as usize);
        for (row, line) in grey.chunks_exact(WIDTH as usize).enumerate() {
            let start = (top + row) * size.width as usize + left;
            pixels[start..start + WIDTH as usize].copy_from_slice(line);
        }
    }
    Ok((pixels, size))
}

fn panel(points: &[Point], bounds: &Bounds, from: DVec3, up: DVec3) -> Result<Vec<[u8; 3]>, PreviewError> {
    let [min, max] = [bounds.min, bounds.max].map(|v| DVec3::from(v.map(f64::from)));
    let radius_m = ((max - min).length() / 2.0).max(1e-3);
    let right = up.cross(from).normalize();
    let down = right.cross(from);
    let reach = |axis: DVec3| (max - min).dot(axis.abs()) / 2.0;
    let (cx, cy) = (f64::from(WIDTH) / 2.0, f64::from(HEIGHT) / 2.0);
    let pixels_per_m = FILLS * (cx / reach(right).max(1e-3)).min(cy / reach(down).max(1e-3));
    let focal_px = pixels_per_m * RADII_AWAY * radius_m;
    let intrinsics = [[focal_px, 0.0, cx], [0.0, focal_px, cy], [0.0, 0.0, 1.0]];
    let rotation = DMat3::from_cols(right, down, -from);
    let place = (min + max) / 2.0 + from * RADII_AWAY * radius_m;
    let view = View {
        camera: Camera::new("picture", WIDTH, HEIGHT, intrinsics)?,
        camera_from_world: DAffine3::from_mat3_translation(rotation, place).inverse(),
    };
    // Splat squares that close the gaps if points cover their bounds.
    let [x, y, z] = (max - min).to_array();
    let apart_m = (2.0 * (x * y + y * z + z * x) / points.len().max(1) as f64).sqrt();
    let radius =
        (0.6 * apart_m * pixels_per_m).ceil().clamp(1.0, f64::from(SplatSchedule::MAX_RADIUS)) as u32;
    let z_max_m = ((RADII_AWAY + 2.0) * radius_m) as f32;
    let schedule = SplatSchedule::new(vec![SplatStep { z_max_m, radius }])?;
    let instances = [Instance { cloud: 0, world_from_local: DAffine3::IDENTITY, number: 1 }];
    let maps = MapSet::of(&[MapKind::Depth]);
    let job = SplatJob { view: &view, schedule: &schedule, instances: &instances, crop: None, maps };
    let maps = ReferenceRasterizer::new(vec![points.into()]).splat(&job)?;
    Ok(shaded(&maps.depth_m, 1.0 / pixels_per_m))
}

/// Distance to either side for slopes, pixels.
const SLOPE_PX: usize = 4;

/// Shades depth in grey on black: bright where near, and where the surface faces the camera.
fn shaded(depth_m: &[f32], pixel_m: f64) -> Vec<[u8; 3]> {
    let drawn = || depth_m.iter().copied().filter(|d| d.is_finite());
    let (near, far) = (drawn().fold(f32::INFINITY, f32::min), drawn().fold(f32::NEG_INFINITY, f32::max));
    let range = f64::from(far - near).max(1e-6);
    let width = WIDTH as usize;
    let at = |i: Option<usize>| i.and_then(|i| depth_m.get(i)).copied().filter(|d| d.is_finite());
    let slope = |i: usize, step: usize| {
        let ends = at(i.checked_sub(SLOPE_PX * step)).zip(at(Some(i + SLOPE_PX * step)));
        ends.map_or(0.0, |(a, b)| f64::from(b - a) / (2.0 * SLOPE_PX as f64 * pixel_m))
    };
    let grey = |(i, d): (usize, &f32)| {
        if !d.is_finite() {
            return [0; 3];
        }
        let (across, along) = (slope(i, 1), slope(i, width));
        let facing = 1.0 / (1.0 + across * across + along * along).sqrt();
        let depth = f64::from(d - near) / range;
        [(40.0 + 100.0 * facing + 110.0 * (1.0 - depth)) as u8; 3]
    };
    depth_m.iter().enumerate().map(grey).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_panel_shows_the_points_from_its_side() {
        // A bar along x with a post on its front end and one on its left.
        let along =
            |f: fn(f32) -> [f32; 3]| (0..=200).map(move |i| Point::new(f(i as f32 / 100.0), [9; 3], 1));
        let bar = along(|t| [2.0 * (t - 1.0), 0.0, 0.0]);
        let post = along(|t| [2.0, 0.0, 0.5 * t]);
        let left = along(|t| [0.0, 0.5 * t, 0.0]);
        let points: Vec<Point> = bar.chain(post).chain(left).collect();
        let (pixels, size) = draw(&points, &Bounds::of(&points).unwrap()).unwrap();
        assert_eq!((pixels.len(), size.width, size.height), (960 * 720, 960, 720));
        let lit = |x: usize, y: usize| pixels[y * 960 + x] != [0; 3];
        let count = |xs: std::ops::Range<usize>, ys: std::ops::Range<usize>| {
            xs.flat_map(|x| ys.clone().map(move |y| (x, y))).filter(|(x, y)| lit(*x, *y)).count()
        };
        // Seen from the right, the post rises at the right end. Seen from above, the left post points up from
        // the middle.
        assert!(count(400..470, 100..170) > 50 && count(10..80, 100..170) == 0);
        assert!(count(690..750, 100..170) > 50 && count(880..950, 100..170) == 0);
        for (left, top) in [(0, 0), (480, 0), (0, 360), (480, 360)] {
            assert!(count(left..left + 480, top..top + 360) > 500);
        }
    }
}
