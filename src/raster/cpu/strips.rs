//! Partition of a frame into row strips that are rendered independently of each other.

use super::project::Projection;
use super::window::Window;
use crate::geometry::ImageSize;
use crate::raster::maps::reduce::{Tap, nearest_indices, taps};
use crate::raster::{FrameJob, RasterError};

/// Source positions of the rows and columns of a view's maps.
pub(super) struct Sampling {
    pub(super) from: ImageSize,
    pub(super) to: ImageSize,
    pub(super) nearest: [Vec<u32>; 2],
    /// For color, if the sizes differ.
    pub(super) taps: Option<[Vec<Tap>; 2]>,
}

/// Rows of a view's maps: first and end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Strip {
    pub(super) view: usize,
    pub(super) rows: [u32; 2],
    pub(super) window: Window,
}

/// Least number of rows in a strip, unless memory demands fewer: padding costs little then.
const MIN_ROWS: u32 = 16;
/// Strips per thread, so that threads finish together.
const STRIPS_PER_THREAD: usize = 12;

impl Sampling {
    pub(super) fn new(from: ImageSize, to: ImageSize) -> Self {
        let sides = [(from.height, to.height), (from.width, to.width)];
        let nearest = sides.map(|(from, to)| nearest_indices(from, to));
        let taps = (from != to).then(|| sides.map(|(from, to)| taps(from, to)));
        Self { from, to, nearest, taps }
    }

    /// Returns first and end of the view rows that these map rows read.
    fn source(&self, rows: [u32; 2]) -> [u32; 2] {
        let rows = rows[0] as usize..rows[1] as usize;
        let nearest = self.nearest[0][rows.clone()].iter().map(|row| *row as usize);
        let taps =
            self.taps.iter().flat_map(|[vertical, _]| vertical[rows.clone()].iter().flat_map(|tap| tap.at));
        let (low, high) =
            nearest.chain(taps).fold((usize::MAX, 0), |(low, high), row| (low.min(row), high.max(row)));
        [low as u32, high as u32 + 1]
    }
}

/// Returns the strips of all views in order, at least one per view.
///
/// # Errors
/// Fails if a single row is too long.
pub(super) fn strips(
    job: &FrameJob<'_>,
    views: &[Sampling],
    threads: usize,
) -> Result<Vec<Strip>, RasterError> {
    let pad = job.schedule.max_radius();
    let each = (threads * STRIPS_PER_THREAD).div_ceil(views.len().max(1)) as u32;
    let mut strips = Vec::new();
    for (view, sampling) in views.iter().enumerate() {
        let height = sampling.to.height;
        let mut count = height.div_ceil(each.max(1)).max(MIN_ROWS).min(height.max(1));
        let mut first = 0;
        while first < height {
            let rows = [first, height.min(first + count)];
            let window = Window { width: sampling.from.width, rows: sampling.source(rows), pad };
            if window.cell(0, window.height()) > Projection::MAX_CELLS {
                if count == 1 {
                    return Err(RasterError::TooWide { width: sampling.from.width });
                }
                count = count.div_ceil(2);
                continue;
            }
            strips.push(Strip { view, rows, window });
            first = rows[1];
        }
    }
    Ok(strips)
}
