//! The rasterizer for processors: vector code and threads, without a driver.
//!
//! # How it works
//! Points are stored in blocks, coordinate by coordinate (`packed`), in huge pages (`memory`). The chunks
//! that a camera may see are loaded before a frame, and others stay while memory lasts (`chunks`, `arena`). A
//! frame is cut into row strips (`strips`), which are rendered independently of each other (`task`): a thread
//! finds where the blocks of a strip may fall (`footprint`), tests them and then their groups against what is
//! already drawn (`hidden`) and draws the others nearest first into visibility buffers (`blocks`, `project`,
//! `window`), finds the visible point of each pixel (`dilate`) and writes the maps (`resolve`). Each point
//! draws only its own pixel, as in the compute rasterizer: the least of 64-bit keys, point by point. The
//! loops over pixels compare depths first, and numbers of points on ties, both of 32 bits.
//!
//! # What was measured
//! 100 million points, AVX2, in ms: loading the points of the next groups ahead took project from 159 to 136,
//! 64-bit keys without branches from 136 to 97, dropping a second test of groups from 97 to 90; loading
//! colors ahead took resolve from 51 to 35, masks of empty pixels from 35 to 26 (4 million). Without gain:
//! tests of groups against tiles, tiles of 16 pixels, finer cells of the Morton order, keys in huge pages,
//! permuted points in groups, 6 to 36 strips per thread, loading six groups and eight blocks ahead. Most
//! groups of the 100 million street would be drawn even if all cells were known from the start.

mod arena;
mod blocks;
mod chunks;
mod dilate;
mod footprint;
mod hidden;
mod memory;
mod numbering;
mod packed;
mod project;
mod resolve;
mod strips;
mod task;
mod window;

use std::collections::VecDeque;
use std::sync::Mutex;
use std::time::Instant;

use rayon::prelude::*;

use self::chunks::Chunks;
use self::numbering::Numbering;
use self::resolve::MapRows;
use self::strips::{Sampling, strips};
use self::task::{Scratch, Task};
use super::layers::Layers;
use super::sight::seen_instances;
use super::{
    CloudSet, FRAMES_IN_FLIGHT, FrameJob, FrameMaps, MapKind, MapSet, Occlusion, Plane, RasterError,
    Rasterizer, RasterizerInfo, SplatJob, SplatMaps, StageTimes, ViewMaps,
};
use crate::geometry::ImageSize;

/// Options of a [`CpuRasterizer`]. Results never depend on them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CpuRasterizerDesc {
    /// Whether groups of points are skipped that what is already drawn hides.
    pub occlusion_culling: bool,
    /// Memory budget for points, bytes (17 per point). `None` for
    /// [`DEFAULT_MEMORY_BYTES`](super::DEFAULT_MEMORY_BYTES), or what a single frame needs if that is more.
    pub memory_bytes: Option<u64>,
}

impl Default for CpuRasterizerDesc {
    fn default() -> Self {
        Self { occlusion_culling: true, memory_bytes: None }
    }
}

/// Maps of a frame: its views one after the other. A map that is not wanted has length 0.
#[derive(Default)]
struct Maps {
    sizes: Vec<ImageSize>,
    rgb_class: Vec<u32>,
    depth_m: Vec<f32>,
    instance: Vec<u32>,
    point: Vec<u32>,
}

/// Rasterizer on the processor's threads.
pub struct CpuRasterizer<'a> {
    chunks: Chunks<'a>,
    desc: CpuRasterizerDesc,
    /// Memory of strips, reused from frame to frame.
    scratch: Mutex<Vec<Scratch>>,
    done: VecDeque<Maps>,
    /// Memory of maps, reused from frame to frame; the last frame may still be read.
    unused: Vec<Maps>,
    shown: Maps,
    stages: StageTimes,
}

impl<'a> CpuRasterizer<'a> {
    /// Creates a rasterizer of clouds, whose points are loaded when they may be seen.
    pub fn new(clouds: CloudSet<'a>) -> Self {
        Self::with_desc(clouds, CpuRasterizerDesc::default())
    }

    /// Creates a rasterizer with other options.
    pub fn with_desc(clouds: CloudSet<'a>, desc: CpuRasterizerDesc) -> Self {
        let mut stages = StageTimes::default();
        let start = Instant::now();
        let chunks = Chunks::new(clouds, desc.memory_bytes);
        stages.add("sort", start.elapsed());
        let (scratch, done, unused, shown) = Default::default();
        Self { chunks, desc, scratch, done, unused, shown, stages }
    }

    fn render(&mut self, job: &FrameJob<'_>) -> Result<Maps, RasterError> {
        let samplings: Vec<Sampling> = job
            .views
            .iter()
            .map(|view| Sampling::new(ImageSize::of(&view.camera), job.size_of(view)))
            .collect();
        let layers = Layers::of(job);
        let mut maps = self.unused.pop().unwrap_or_default();
        maps.start(&samplings, if layers.count == 0 { MapSet::NONE } else { job.maps });
        if layers.count == 0 {
            return Ok(maps);
        }
        let start = Instant::now();
        let seen = seen_instances(job, &layers, &self.chunks.clouds)?;
        self.chunks.load(job, &seen)?;
        self.stages.add("load", start.elapsed());
        let numbering = Numbering::new(&seen, &self.chunks)?;
        let threads = rayon::current_num_threads();
        let strips = strips(job, &samplings, threads)?;
        let mut rest = maps.rows();
        let mut tasks = Vec::with_capacity(strips.len());
        for strip in &strips {
            let sampling = &samplings[strip.view];
            let pixels = (strip.rows[1] - strip.rows[0]) as usize * sampling.to.width as usize;
            tasks.push((strip, sampling, rest.take_first(pixels)));
        }
        let (scratch, culls) = (&self.scratch, self.desc.occlusion_culling);
        let times = tasks.into_par_iter().with_max_len(1).map(|(strip, sampling, mut maps)| {
            let unused = scratch.lock().ok().and_then(|mut all| all.pop());
            let mut own = unused.unwrap_or_default();
            let task = Task { job, layers: &layers, strip, sampling, numbering: &numbering, culls };
            let times = task.render(&mut own, &mut maps);
            if let Ok(mut all) = scratch.lock() {
                all.push(own);
            }
            times
        });
        let times: Vec<StageTimes> = times.collect();
        self.chunks.load_ahead(job);
        // Threads work at the same time: their mean is the share of the frame's time.
        for (stage, time) in times.iter().flat_map(|times| &times.0) {
            self.stages.add(stage, *time / threads as u32);
        }
        Ok(maps)
    }
}

impl Maps {
    fn start(&mut self, samplings: &[Sampling], wanted: MapSet) {
        self.sizes = samplings.iter().map(|sampling| sampling.to).collect();
        let pixels: usize = self.sizes.iter().map(|size| size.pixels()).sum();
        let of = |wanted: bool| if wanted { pixels } else { 0 };
        self.rgb_class.resize(of(wanted.intersects(MapSet::RGB_CLASS)), 0);
        self.depth_m.resize(of(wanted.contains(MapKind::Depth)), 0.0);
        self.instance.resize(of(wanted.contains(MapKind::Instance)), 0);
        self.point.resize(of(wanted.contains(MapKind::Point)), 0);
    }

    fn rows(&mut self) -> MapRows<'_> {
        MapRows {
            rgb_class: &mut self.rgb_class,
            depth_m: &mut self.depth_m,
            instance: &mut self.instance,
            point: &mut self.point,
        }
    }

    fn views(&self) -> FrameMaps<'_> {
        let mut first = 0;
        let mut view = |size: &ImageSize| {
            let pixels = first..first + size.pixels();
            first = pixels.end;
            ViewMaps {
                size: *size,
                rgb_class: Plane::borrowed(self.rgb_class.get(pixels.clone()).unwrap_or_default()),
                depth_m: Plane::borrowed(self.depth_m.get(pixels.clone()).unwrap_or_default()),
                instance: Plane::borrowed(self.instance.get(pixels.clone()).unwrap_or_default()),
                point: Plane::borrowed(self.point.get(pixels).unwrap_or_default()),
            }
        };
        self.sizes.iter().map(&mut view).collect()
    }
}

impl Rasterizer for CpuRasterizer<'_> {
    fn info(&self) -> RasterizerInfo {
        RasterizerInfo { rasterizer: "cpu", device: "host".into(), driver: "none".into() }
    }

    fn begin(&mut self, job: &FrameJob<'_>) -> Result<(), RasterError> {
        if self.done.len() == FRAMES_IN_FLIGHT {
            return Err(RasterError::TooManyFrames { max: FRAMES_IN_FLIGHT });
        }
        let maps = self.render(job)?;
        self.done.push_back(maps);
        Ok(())
    }

    fn finish(&mut self) -> Result<FrameMaps<'_>, RasterError> {
        let maps = self.done.pop_front().ok_or(RasterError::NoFrame)?;
        self.unused.push(std::mem::replace(&mut self.shown, maps));
        Ok(self.shown.views())
    }

    fn splat(&mut self, job: &SplatJob<'_>) -> Result<SplatMaps, RasterError> {
        let packed = if job.maps.intersects(MapSet::RGB_CLASS) { MapSet::RGB_CLASS } else { MapSet::NONE };
        let frame = FrameJob {
            views: std::slice::from_ref(job.view),
            schedule: job.schedule,
            color: job.instances,
            geometry: job.instances,
            occlusion: Occlusion::Scene,
            crop: job.crop,
            maps: job.maps | packed,
            out_size: None,
        };
        let Maps { rgb_class, depth_m, instance, point, .. } = self.render(&frame)?;
        let (width, height) = (job.view.camera.width, job.view.camera.height);
        Ok(SplatMaps { width, height, point, depth_m, rgb_class, instance })
    }

    fn stages(&mut self) -> &mut StageTimes {
        &mut self.stages
    }
}
