//! Rasterizer that takes no more memory than the budget allows (see [`memory`](crate::memory)).

use super::{
    CloudSet, FrameJob, FrameMaps, MapKind, MapSet, RasterError, Rasterizer, RasterizerInfo, SplatJob,
    SplatMaps, StageTimes,
};
use crate::cloud::Cloud;
use crate::geometry::{ImageSize, View};
use crate::memory::{MemoryError, Need, Reservation, reserve};

/// Host memory per point of a cloud in memory while it is sorted: keys and order.
const ORDER_BYTES: u64 = 12;
/// Host memory of visibility buffers per pixel of a view that is rendered in strips: the strips of all
/// threads together.
const STRIP_PIXEL_BYTES: u64 = 2;

/// A rasterizer that reserves the memory of its frames before it renders them.
pub(super) struct Budgeted<'a> {
    inner: Box<dyn Rasterizer + 'a>,
    /// Whether maps are rendered at the full size of views and reduced afterwards.
    at_full_size: bool,
    /// Memory of maps.
    maps: Reservation,
    in_flight: u64,
    /// Whether the maps of a finished frame are kept until the next one is finished.
    has_finished: bool,
}

/// Reserves the host memory for the order of points while a rasterizer is created; afterwards it is taken.
pub(super) fn reserve_order(clouds: &CloudSet<'_>) -> Result<Reservation, MemoryError> {
    let in_memory = |cloud: &Cloud<'_>| if let Cloud::Memory(points) = cloud { points.len() } else { 0 };
    let points: usize = clouds.iter().map(in_memory).sum();
    let bytes = ORDER_BYTES * points as u64;
    let advice = "points in a skeleton are sorted already";
    reserve(bytes, || Need { what: format!("sorting {points} points"), bytes, advice })
}

impl<'a> Budgeted<'a> {
    pub(super) fn new(inner: Box<dyn Rasterizer + 'a>, at_full_size: bool) -> Self {
        let maps = Reservation::default();
        Self { inner, at_full_size, maps, in_flight: 0, has_finished: false }
    }
}

/// Estimates the host memory that a rasterizer takes for one frame of these views, bytes.
pub(crate) fn frame_bytes(
    views: &[View],
    out_size: Option<ImageSize>,
    maps: MapSet,
    at_full_size: bool,
) -> u64 {
    let plane = |wanted: bool| if wanted { 4 } else { 0 };
    let has = |kind| plane(maps.contains(kind));
    let each = plane(maps.intersects(MapSet::RGB_CLASS))
        + has(MapKind::Depth)
        + has(MapKind::Instance)
        + has(MapKind::Point);
    if each == 0 {
        return 0;
    }
    let drawn = |view: &View| size_of(view).pixels() as u64;
    let written: u64 = views.iter().map(|v| out_size.map_or(drawn(v), |size| size.pixels() as u64)).sum();
    let largest = views.iter().map(drawn).max().unwrap_or(0);
    each * written + largest * if at_full_size { each } else { STRIP_PIXEL_BYTES }
}

fn size_of(view: &View) -> ImageSize {
    ImageSize::of(&view.camera)
}

/// Describes the memory for views with some sizes.
pub(crate) fn need_of_views(sizes: impl Iterator<Item = ImageSize>, bytes: u64) -> Need {
    let sizes: Vec<ImageSize> = sizes.collect();
    let what = match sizes.iter().max_by_key(|size| size.pixels()) {
        Some(largest) if sizes.len() > 1 => {
            format!("rendering {} views of up to {largest} pixels", sizes.len())
        }
        Some(size) => format!("rendering a view of {size} pixels"),
        None => "rendering".to_owned(),
    };
    Need { what, bytes, advice: "fewer or smaller cameras, fewer maps, --size and --out-size need less" }
}

impl Rasterizer for Budgeted<'_> {
    fn info(&self) -> RasterizerInfo {
        self.inner.info()
    }

    fn begin(&mut self, job: &FrameJob<'_>) -> Result<(), RasterError> {
        let frames = self.in_flight + 1 + u64::from(self.has_finished);
        let bytes = frames * frame_bytes(job.views, job.out_size, job.maps, self.at_full_size);
        self.maps.grow(bytes, || need_of_views(job.views.iter().map(size_of), bytes))?;
        self.inner.begin(job)?;
        self.in_flight += 1;
        Ok(())
    }

    fn finish(&mut self) -> Result<FrameMaps<'_>, RasterError> {
        let maps = self.inner.finish()?;
        self.in_flight = self.in_flight.saturating_sub(1);
        self.has_finished = true;
        Ok(maps)
    }

    fn splat(&mut self, job: &SplatJob<'_>) -> Result<SplatMaps, RasterError> {
        let views = std::slice::from_ref(job.view);
        let bytes = frame_bytes(views, None, job.maps, self.at_full_size);
        // The caller owns the maps.
        let _maps = reserve(bytes, || need_of_views(views.iter().map(size_of), bytes))?;
        self.inner.splat(job)
    }

    fn stages(&mut self) -> &mut StageTimes {
        self.inner.stages()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Camera;
    use crate::raster::{Occlusion, RasterizerKind, SplatSchedule, create};

    fn views(count: usize, width: u32, height: u32) -> Vec<View> {
        let rows = [[100.0, 0.0, 50.0], [0.0, 100.0, 50.0], [0.0, 0.0, 1.0]];
        let camera = Camera::new("c", width, height, rows).unwrap();
        vec![View { camera, camera_from_world: Default::default() }; count]
    }

    #[test]
    fn frames_need_four_bytes_per_pixel_and_map() {
        let views = views(3, 100, 10);
        let default = MapSet::default();
        assert_eq!(frame_bytes(&views, None, default, false), 3000 * 12 + 2000);
        assert_eq!(frame_bytes(&views, None, default, true), 3000 * 12 + 12_000);
        let small = ImageSize { height: 5, width: 10 };
        assert_eq!(frame_bytes(&views, Some(small), default, false), 150 * 12 + 2000);
        assert_eq!(frame_bytes(&views, None, MapSet::of(&[MapKind::Boxes]), true), 0);
    }

    /// 200 cameras of the largest size: 0.6 TB of maps.
    #[test]
    fn rejects_frames_beyond_the_budget() {
        let mut rasterizer = create(&RasterizerKind::Cpu.into(), vec![(&[]).into()]).unwrap();
        let (views, schedule) = (views(200, 16_384, 16_384), SplatSchedule::default());
        let job = FrameJob {
            views: &views,
            schedule: &schedule,
            color: &[],
            geometry: &[],
            occlusion: Occlusion::Scene,
            crop: None,
            maps: MapSet::default(),
            out_size: None,
        };
        let message = rasterizer.begin(&job).unwrap_err().to_string();
        assert!(
            message.starts_with("rendering 200 views of up to 16384x16384 pixels needs 600.5 GiB of memory"),
            "{message}"
        );
        let size = ImageSize { height: 256, width: 256 };
        rasterizer.begin(&FrameJob { views: &views[..2], out_size: Some(size), ..job }).unwrap();
    }
}
