//! CPU reference of the splat shaders in Rust: the oracle of the tests, and a rasterizer that needs no
//! driver.
//!
//! Every `f32` operation is in the same order as in `glsl/splat.vert` and `glsl/project.wgsl`. Neither side
//! fuses multiplications with additions (the shaders by `NoContraction`), so the results are bit-exact.

use std::borrow::Cow;
use std::time::Instant;

use super::frame::frame_by_views;
use super::frames::CompletedFrames;
use super::{
    CloudSet, Draw, FrameJob, FrameMaps, MapKind, MapSet, RasterError, Rasterizer, RasterizerInfo, SplatJob,
    SplatMaps, SplatSchedule, StageTimes, draws_from_job,
};
use crate::cloud::{Bounds, Cloud, Point};

/// The CPU reference as a [`Rasterizer`].
pub struct ReferenceRasterizer<'a> {
    clouds: CloudSet<'a>,
    extents: Vec<(usize, Option<Bounds>)>,
    stages: StageTimes,
    done: CompletedFrames,
}

impl<'a> ReferenceRasterizer<'a> {
    /// Creates a rasterizer that borrows the clouds. Nothing is copied; stored ones are read for every view.
    pub fn new(clouds: CloudSet<'a>) -> Self {
        let extents = clouds.iter().map(|cloud| (cloud.len(), cloud.bounds())).collect();
        Self { clouds, extents, stages: StageTimes::default(), done: CompletedFrames::default() }
    }
}

impl Rasterizer for ReferenceRasterizer<'_> {
    fn info(&self) -> RasterizerInfo {
        RasterizerInfo { rasterizer: "cpu", device: "host".into(), driver: "plain Rust".into() }
    }

    fn begin(&mut self, job: &FrameJob<'_>) -> Result<(), RasterError> {
        self.done.check()?;
        let frame = frame_by_views(job, &mut |job| self.splat(job))?;
        self.done.push(frame);
        Ok(())
    }

    fn finish(&mut self) -> Result<FrameMaps<'_>, RasterError> {
        self.done.pop()
    }

    fn splat(&mut self, job: &SplatJob<'_>) -> Result<SplatMaps, RasterError> {
        let draws = draws_from_job(job, &self.extents)?;
        let clouds: Vec<Cow<'_, [Point]>> =
            self.clouds.iter().map(Cloud::points).collect::<Result<_, _>>()?;
        let camera = &job.view.camera;
        let start = Instant::now();
        let mut buffer = Visibility::new(camera.width, camera.height);
        for (index, draw) in draws.iter().enumerate() {
            buffer.splat(&clouds[draw.cloud], draw, index as u32, job.schedule);
        }
        self.stages.add("splat", start.elapsed());
        let start = Instant::now();
        let maps = buffer.resolve(&clouds, &draws, job.maps);
        self.stages.add("resolve", start.elapsed());
        Ok(maps)
    }

    fn stages(&mut self) -> &mut StageTimes {
        &mut self.stages
    }
}

/// The visibility buffer: depth, draw and point of each pixel's winner.
struct Visibility {
    width: u32,
    height: u32,
    depth_m: Vec<f32>,
    /// `(draw, point within the draw's cloud)`.
    winner: Vec<(u32, u32)>,
}

impl Visibility {
    fn new(width: u32, height: u32) -> Self {
        let pixels = width as usize * height as usize;
        Self { width, height, depth_m: vec![f32::INFINITY; pixels], winner: vec![(0, 0); pixels] }
    }

    /// Splats points. Later points never replace earlier ones of equal depth.
    fn splat(&mut self, points: &[Point], draw: &Draw, draw_index: u32, schedule: &SplatSchedule) {
        for (index, point) in points.iter().enumerate() {
            let Some(splat) = project(&point.position, draw, schedule) else { continue };
            let Some((columns, rows)) = splat.covered(self.width, self.height) else { continue };
            for row in rows {
                let first = row as usize * self.width as usize;
                let pixels = first + columns.start as usize..first + columns.end as usize;
                let (depths, winners) = (&mut self.depth_m[pixels.clone()], &mut self.winner[pixels]);
                if columns.len() >= WIDE && !is_nearer_somewhere(splat.depth_m, depths) {
                    continue;
                }
                for (depth_m, winner) in depths.iter_mut().zip(winners) {
                    if splat.depth_m < *depth_m {
                        *depth_m = splat.depth_m;
                        *winner = (draw_index, index as u32);
                    }
                }
            }
        }
    }

    fn resolve(self, clouds: &[Cow<'_, [Point]>], draws: &[Draw], maps: MapSet) -> SplatMaps {
        let (depths, winners) = (&self.depth_m, &self.winner);
        let plane = |wanted: bool, value: &dyn Fn(&Draw, u32) -> u32| -> Vec<u32> {
            if !wanted {
                return Vec::new();
            }
            let pixel = |(depth, &(draw, index)): (&f32, &(u32, u32))| {
                if depth.is_finite() { value(&draws[draw as usize], index) } else { 0 }
            };
            depths.iter().zip(winners).map(pixel).collect()
        };
        SplatMaps {
            width: self.width,
            height: self.height,
            point: plane(maps.contains(MapKind::Point), &|draw, i| draw.first_number + i + 1),
            rgb_class: plane(maps.intersects(MapSet::RGB_CLASS), &|draw, i| {
                clouds[draw.cloud][i as usize].rgb_class
            }),
            instance: plane(maps.contains(MapKind::Instance), &|draw, _| draw.instance),
            depth_m: if maps.contains(MapKind::Depth) { self.depth_m } else { Vec::new() },
        }
    }
}

/// Minimum row length, pixels, for a vectorized pretest to cost less than a test and a branch per pixel.
const WIDE: usize = 8;

/// Returns whether a depth is less than any of these; branch-free, so that it compiles to vector comparisons.
fn is_nearer_somewhere(depth_m: f32, depths_m: &[f32]) -> bool {
    depths_m.iter().fold(false, |nearer, other| nearer | (depth_m < *other))
}

/// A projected point: center pixel (may lie outside the image), camera depth and radius.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Splat {
    /// Column of the center, an integer.
    pub x: f32,
    /// Row of the center, an integer.
    pub y: f32,
    /// Camera depth, meters.
    pub depth_m: f32,
    /// Radius, pixels.
    pub radius: u32,
}

impl Splat {
    /// Returns the columns and rows of a `width × height` image that the square covers; `None` if empty.
    fn covered(&self, width: u32, height: u32) -> Option<(std::ops::Range<i32>, std::ops::Range<i32>)> {
        let r = self.radius as f32;
        let reaches = |c: f32, side: u32| c >= -r && c < side as f32 + r;
        if !(reaches(self.x, width) && reaches(self.y, height)) {
            return None;
        }
        let range = |c: f32, side: u32| {
            let (c, r) = (c as i32, self.radius as i32);
            (c - r).max(0)..(c + r + 1).min(side as i32)
        };
        Some((range(self.x, width), range(self.y, height)))
    }
}

/// Projects a point as the vertex shader does; `None` if the splat rule or the crop discards it.
pub fn project(p: &[f32; 3], draw: &Draw, schedule: &SplatSchedule) -> Option<Splat> {
    let dot = |row: &[f32; 4]| row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3];
    let depth_m = dot(&draw.image_from_local[2]);
    let radius = schedule.radius_at(depth_m)?;
    let [crop_x, crop_y] = draw.crop_from_local.each_ref().map(dot);
    if !(crop_x.abs() <= draw.crop_radius_m && crop_y.abs() <= draw.crop_radius_m) {
        return None;
    }
    let x = (dot(&draw.image_from_local[0]) / depth_m).floor();
    let y = (dot(&draw.image_from_local[1]) / depth_m).floor();
    Some(Splat { x, y, depth_m, radius })
}
