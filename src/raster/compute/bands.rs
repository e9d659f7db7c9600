//! Partition of views into row strips ("bands"), and of strips into batches ("parts") that fit the device's
//! buffers.

use bytemuck::{Pod, Zeroable};

use crate::geometry::ImageSize;
use crate::gpu::shaders;
use crate::raster::maps::reduce::{nearest_indices, taps};
use crate::raster::{FrameJob, RasterError};

/// Minimum padding of keys around each strip, pixels: the radius that the resolve shaders gather.
pub(super) const PAD: u32 = shaders::resolve_full_wgsl_both::PAD;
/// Extra columns of keys beyond the padding that a shader may read but not use.
const SPARE: u32 = 8;
/// Columns of a tile ("panel") of keys.
const PANEL: u32 = 32;

/// Capacity limits of one batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PartLimits {
    /// Size of one key layer, bytes.
    pub(super) key_bytes: u64,
    /// Rows of keys.
    pub(super) key_rows: u32,
    /// Pixels of results.
    pub(super) pixels: u64,
}

/// Source positions of one output row or column of a reduction.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub(super) struct ResolveTap {
    pub(super) nearest: u32,
    /// First of the two that color interpolates.
    pub(super) low: u32,
    /// Weights of these two, in 1/2048.
    pub(super) weights: [i32; 2],
}

/// Taps of a view's reduction.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Reduction {
    pub(super) columns: Vec<ResolveTap>,
    pub(super) rows: Vec<ResolveTap>,
}

fn axis(from: u32, to: u32) -> Vec<ResolveTap> {
    let tap = |(nearest, tap): (u32, crate::raster::maps::reduce::Tap)| ResolveTap {
        nearest,
        low: tap.at[0] as u32,
        weights: tap.weight,
    };
    nearest_indices(from, to).into_iter().zip(taps(from, to)).map(tap).collect()
}

impl Reduction {
    fn new(from: ImageSize, to: ImageSize) -> Self {
        Self { columns: axis(from.width, to.width), rows: axis(from.height, to.height) }
    }

    /// Returns whether the shader that resolves both kinds in one walk supports it.
    pub(super) fn joint(&self) -> bool {
        let near = |tap: &ResolveTap| tap.nearest <= tap.low && tap.low - tap.nearest <= 3;
        let forward = |pair: &[ResolveTap]| pair[0].low < pair[1].nearest;
        self.columns.iter().all(near)
            && self.rows.iter().all(|tap| tap.nearest <= tap.low)
            && self.rows.windows(2).all(forward)
    }

    /// Returns whether the shaders that resolve one kind per walk support it: always, except for upscaling.
    pub(super) fn apart(&self) -> bool {
        self.rows.windows(2).all(|pair| pair[0].low < pair[1].low)
    }
}

/// Row strip of a view, rendered in one batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RowStrip {
    pub(super) view: usize,
    /// Rows of the result: first and end.
    pub(super) rows: [u32; 2],
    /// Rows of the view: first and end.
    pub(super) source: [u32; 2],
}

impl RowStrip {
    /// Returns the number of key rows, with padding and one more that is read with weight zero.
    pub(super) fn key_rows(&self, pad: u32) -> u32 {
        self.source[1] - self.source[0] + 2 * pad + 1
    }
}

/// Partition of a frame's views.
pub(super) struct Partition {
    /// Columns of keys: whole tiles.
    columns: u32,
    /// Padding of keys around each strip, pixels: room for points outside whose squares reach in.
    pub(super) pad: u32,
    /// One per view; `None` if no view is reduced.
    pub(super) reductions: Option<Vec<Reduction>>,
    /// Batches of strips.
    pub(super) parts: Vec<Vec<RowStrip>>,
}

impl Partition {
    /// Partitions the views. Returns `None` if the shaders do not support a reduction.
    ///
    /// # Errors
    /// Fails if a single row is too long.
    pub(super) fn new(job: &FrameJob<'_>, limits: PartLimits) -> Result<Option<Self>, RasterError> {
        let from = |view: usize| ImageSize::of(&job.views[view].camera);
        let to = |view: usize| job.size_of(&job.views[view]);
        let views = 0..job.views.len();
        let widest = views.clone().map(|v| from(v).width).max().unwrap_or(1);
        let pad = pad_for(job.schedule.max_radius());
        let columns = (widest + 2 * pad + SPARE).next_multiple_of(PANEL);
        let reduced = views.clone().any(|v| from(v) != to(v));
        let reductions: Option<Vec<Reduction>> =
            reduced.then(|| views.clone().map(|v| Reduction::new(from(v), to(v))).collect());
        if !reductions.iter().flatten().all(Reduction::apart) {
            return Ok(None);
        }
        let key_rows = limits.key_rows.min((limits.key_bytes / (8 * u64::from(columns))) as u32);
        let mut cut = Self { columns, pad, reductions, parts: Vec::new() };
        let mut left = (0, 0);
        for view in views {
            let mut first = 0;
            while first < to(view).height {
                let band = cut.band(
                    view,
                    [first, to(view).height],
                    (key_rows, limits.pixels),
                    from(view),
                    to(view),
                )?;
                first = band.rows[1];
                let pixels = u64::from(band.rows[1] - band.rows[0]) * row_pixels(to(view));
                if cut.parts.is_empty() || band.key_rows(pad) > left.0 || pixels > left.1 {
                    cut.parts.push(Vec::new());
                    left = (key_rows, limits.pixels);
                }
                left = (left.0 - band.key_rows(pad), left.1 - pixels);
                cut.parts.last_mut().into_iter().for_each(|part| part.push(band));
            }
        }
        Ok(Some(cut))
    }

    /// Returns the bytes of a layer with this number of key rows.
    pub(super) fn key_bytes(&self, key_rows: u32) -> u64 {
        8 * self.key_pixels(key_rows)
    }

    /// Returns the pixels of this number of key rows.
    pub(super) fn key_pixels(&self, key_rows: u32) -> u64 {
        u64::from(self.columns) * u64::from(key_rows)
    }

    /// Returns a strip that starts at row `first` and fits the limits: its height is halved until it does.
    fn band(
        &self,
        view: usize,
        [first, end]: [u32; 2],
        (key_rows, pixels): (u32, u64),
        from: ImageSize,
        to: ImageSize,
    ) -> Result<RowStrip, RasterError> {
        let most = (pixels / row_pixels(to)).min(u64::from(end - first)) as u32;
        let mut count = most;
        loop {
            if count == 0 {
                return Err(RasterError::TooWide { width: from.width.max(to.width) });
            }
            let band = self.band_of(view, [first, first + count], from);
            if band.key_rows(self.pad) <= key_rows {
                return Ok(band);
            }
            count /= 2;
        }
    }

    fn band_of(&self, view: usize, rows: [u32; 2], from: ImageSize) -> RowStrip {
        let Some(reductions) = &self.reductions else { return RowStrip { view, rows, source: rows } };
        let taps = &reductions[view].rows;
        let (top, bottom) = (taps[rows[0] as usize], taps[rows[1] as usize - 1]);
        let end = (bottom.nearest + 1).max(bottom.low + 2).min(from.height);
        RowStrip { view, rows, source: [top.nearest.min(top.low), end] }
    }
}

/// Returns the padding for squares of a radius: even, since the resolve shaders read pairs of columns.
fn pad_for(radius: u32) -> u32 {
    radius.next_multiple_of(2).max(PAD)
}

/// Returns the row stride of full-size results, pixels: shaders write four pixels as two 64-bit words.
pub(super) fn row_pixels(size: ImageSize) -> u64 {
    u64::from(size.width).next_multiple_of(4)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reduction(from: u32, to: u32) -> Reduction {
        let size = |side| ImageSize { height: side, width: side };
        Reduction::new(size(from), size(to))
    }

    #[test]
    fn common_reductions_resolve_in_one_walk() {
        for (from, to) in [(1600, 448), (900, 256), (1600, 400), (900, 224), (1080, 448), (1920, 896)] {
            assert!(reduction(from, to).joint(), "{from} {to}");
        }
        for (from, to) in [(100, 99), (64, 40), (10, 10)] {
            assert!(reduction(from, to).apart(), "{from} {to}");
        }
        assert!(!reduction(10, 20).apart());
    }
}
