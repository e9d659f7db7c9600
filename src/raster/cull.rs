//! Culling of chunk parts per row strip, and their minimum depths.

use pulp::{Simd, WithSimd};

use super::chunk::{CHUNK, CULL_BLOCK, ChunkedCloud, Extent, GROUP, GroupExtents};
use crate::bits::Ones;
use crate::raster::Draw;
use crate::raster::schedule::Z_NEAR_M;

/// Range of a chunk's points that may be visible.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct VisibleRange {
    /// Chunk index within the cloud.
    pub(super) chunk: u32,
    /// First and end point within the chunk.
    pub(super) points: [u32; 2],
    /// Lower bound of their depths, meters.
    pub(super) nearest_m: f32,
    /// Whether the crop may exclude some of them.
    pub(super) crop: bool,
}

/// Rows of a view, pixels: first and end.
pub(super) type Rows = [u32; 2];

/// Half-spaces that contain every drawn point, as `normal · p + offset >= 0`: depth, image and crop.
struct Frustum {
    planes: Vec<[f64; 4]>,
    /// Index of the crop's first half-space.
    crop: usize,
    depth: [f64; 4],
}

/// Slack in meters, and in pixel · meters: far above the rounding of `f32`.
const SLACK: f64 = 1e-3;
const IMAGE_SLACK: f64 = 1.0;
/// Relative rounding error of `f32`, with a margin.
const ROUNDING: f64 = 1e-6;

/// [`Frustum::touching`] in the widest vectors of the processor.
struct Touching<'t> {
    group: &'t GroupExtents,
    frustum: &'t Frustum,
}

impl WithSimd for Touching<'_> {
    type Output = u64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> u64 {
        self.frustum.touching(self.group)
    }
}

impl Frustum {
    fn new(draw: &Draw, width: u32, rows: Rows, pad: f64, z_far_m: f32) -> Self {
        let row = |r: &[f32; 4]| r.map(f64::from);
        let [u, v, z] = draw.image_from_local.each_ref().map(row);
        let sum = |a: [f64; 4], b: [f64; 4], scale: f64| [0, 1, 2, 3].map(|i| a[i] + scale * b[i]);
        let offset = |a: [f64; 4], by: f64| [a[0], a[1], a[2], a[3] + by];
        let negative = |a: [f64; 4]| a.map(|v| -v);
        let (right, top, bottom) =
            (f64::from(width) + pad, f64::from(rows[0]) - pad, f64::from(rows[1]) + pad);
        let mut planes = vec![
            offset(z, SLACK - f64::from(Z_NEAR_M)),
            offset(negative(z), f64::from(z_far_m) + SLACK),
            offset(sum(u, z, pad), IMAGE_SLACK),
            offset(negative(sum(u, z, -right)), IMAGE_SLACK),
            offset(sum(v, z, -top), IMAGE_SLACK),
            offset(negative(sum(v, z, -bottom)), IMAGE_SLACK),
        ];
        let crop = planes.len();
        let radius = f64::from(draw.crop_radius_m) + SLACK;
        for axis in draw.crop_from_local.iter().filter(|_| draw.cropped()) {
            planes.push(offset(row(axis), radius));
            planes.push(offset(negative(row(axis)), radius));
        }
        Self { planes, crop, depth: z }
    }

    /// Returns the blocks of a group that touch: a bit mask.
    #[inline(always)]
    fn touching(&self, group: &GroupExtents) -> u64 {
        let mut least = [0.0_f64; GROUP];
        for plane in &self.planes {
            for (i, least) in least.iter_mut().enumerate() {
                let most = Self::range(plane, &group.block(i))[1];
                *least = if most < *least { most } else { *least };
            }
        }
        let outside = |i: usize| u64::from(least[i] < 0.0) << i;
        (0..GROUP).fold(group.drawn, |touching, i| touching & !outside(i))
    }

    /// Returns the numbers and bounds of all blocks that touch.
    fn touched(&self, groups: &[GroupExtents]) -> impl Iterator<Item = (usize, Extent)> {
        let touching = move |(number, group): (usize, &GroupExtents)| {
            let any = group.all.as_ref().is_some_and(|all| self.touches(all));
            let blocks = if any { pulp::Arch::new().dispatch(Touching { group, frustum: self }) } else { 0 };
            (number, blocks)
        };
        let masks = groups.iter().enumerate().map(touching);
        masks.flat_map(move |(number, blocks)| {
            Ones(blocks).map(move |block| (number * GROUP + block, groups[number].block(block)))
        })
    }

    /// Returns the minimum and maximum of `normal · p + offset` over a box, widened by the rounding of `f32`.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)] // vectorizes over the boxes of a loop
    fn range(plane: &[f64; 4], extent: &Extent) -> [f64; 2] {
        let (mut middle, mut reach, mut size) = (plane[3], 0.0, plane[3].abs());
        for axis in 0..3 {
            let (normal, center) = (plane[axis], extent.center[axis]);
            middle += normal * center;
            reach += normal.abs() * extent.half[axis];
            size += normal.abs() * center.abs();
        }
        reach += ROUNDING * (size + reach);
        [middle - reach, middle + reach]
    }

    /// Returns whether a point of the box may be drawn; conservative.
    fn touches(&self, extent: &Extent) -> bool {
        // Formulated so that NaN counts as touching.
        !self.planes.iter().any(|plane| Self::range(plane, extent)[1] < 0.0)
    }

    /// Returns whether the crop may exclude points of the box; conservative.
    fn cuts(&self, extent: &Extent) -> bool {
        !self.planes[self.crop..].iter().all(|plane| Self::range(plane, extent)[0] > 2.0 * SLACK)
    }

    fn nearest_m(&self, extent: &Extent) -> f32 {
        Self::range(&self.depth, extent)[0].max(0.0) as f32
    }
}

/// Returns the blocks of a cloud that may be visible in some rows of a view `width` pixels wide, in point
/// order. The view is padded by `pad` pixels for the squares of points.
pub(super) fn seen_blocks(
    cloud: &ChunkedCloud<'_>,
    draw: &Draw,
    (width, rows): (u32, Rows),
    pad: u32,
    z_far_m: f32,
) -> Vec<VisibleRange> {
    let frustum = Frustum::new(draw, width, rows, f64::from(pad) + 2.0, z_far_m);
    let range = |(i, extent): (usize, Extent)| {
        let (nearest_m, crop) = (frustum.nearest_m(&extent), frustum.cuts(&extent));
        let (chunk, first) = ((i * CULL_BLOCK / CHUNK) as u32, (i * CULL_BLOCK % CHUNK) as u32);
        let end = cloud.count(chunk as usize).min(first + CULL_BLOCK as u32);
        VisibleRange { chunk, points: [first, end], nearest_m, crop }
    };
    frustum.touched(&cloud.groups).map(range).collect()
}

/// Returns the chunks of a cloud that may be visible in a view `width` pixels wide, in order.
pub(super) fn seen_chunks(
    cloud: &ChunkedCloud<'_>,
    draw: &Draw,
    (width, rows): (u32, Rows),
    pad: u32,
    z_far_m: f32,
) -> Vec<u32> {
    let frustum = Frustum::new(draw, width, rows, f64::from(pad) + 2.0, z_far_m);
    frustum.touched(&cloud.chunk_groups).map(|(chunk, _)| chunk as u32).collect()
}

/// Joins neighboring blocks of a chunk.
pub(super) fn joined(blocks: &[VisibleRange]) -> Vec<VisibleRange> {
    let mut ranges: Vec<VisibleRange> = Vec::with_capacity(blocks.len());
    for block in blocks {
        match ranges.last_mut() {
            Some(last)
                if (last.chunk, last.points[1], last.crop) == (block.chunk, block.points[0], block.crop) =>
            {
                last.points[1] = block.points[1];
                last.nearest_m = last.nearest_m.min(block.nearest_m);
            }
            _ => ranges.push(*block),
        }
    }
    ranges
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera at the origin with focal length 100 that looks along z, 300 × 200 pixels; a crop of 30 m in x
    /// and z.
    fn frustum() -> Frustum {
        let draw = Draw {
            cloud: 0,
            image_from_local: [[100.0, 0.0, 150.0, 0.0], [0.0, 100.0, 100.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
            crop_from_local: [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
            crop_radius_m: 30.0,
            first_number: 0,
            instance: 0,
        };
        Frustum::new(&draw, 300, [0, 200], 3.0, 100.0)
    }

    #[test]
    fn boxes_outside_the_frustum_do_not_touch() {
        let frustum = frustum();
        let extent = |center, half| Extent { center, half: [half; 3] };
        let touches = |center, half| frustum.touches(&extent(center, half));
        assert!(touches([0.0, 0.0, 10.0], 1.0) && touches([0.0, 0.0, 0.0], 1.0));
        assert!(!touches([0.0, 0.0, -2.0], 1.0) && !touches([0.0, 0.0, 32.0], 1.0));
        assert!(touches([16.0, 0.0, 10.0], 1.0) && !touches([20.0, 0.0, 10.0], 1.0));
        assert!(!touches([0.0, 14.0, 10.0], 1.0) && !touches([0.0, -14.0, 10.0], 1.0));
        assert!(touches([0.0, f64::NAN, 10.0], 1.0), "what is no number may be anywhere");
        assert!(
            !frustum.cuts(&extent([0.0, 0.0, 10.0], 5.0)) && frustum.cuts(&extent([0.0, 0.0, 29.0], 2.0))
        );
        assert_eq!(frustum.nearest_m(&extent([0.0, 0.0, 0.5], 1.0)), 0.0);
    }

    /// All blocks of a group at once as one by one; a block without finite points never touches.
    #[test]
    fn group_test_matches_the_block_tests() {
        let frustum = frustum();
        let between =
            |i: usize, axis: i64| crate::hash::between(5, &[i as i64 / 1024, axis], -40.0, 40.0) as f32;
        let at = |i: usize| [0, 1, 2].map(|axis| between(i, axis) + (i % 1024) as f32 * 1e-3);
        let point = |i: usize| {
            let position = if i / 1024 == 7 { [f32::NAN; 3] } else { at(i) };
            crate::cloud::Point::new(position, [0; 3], 0)
        };
        let points: Vec<crate::cloud::Point> = (0..64 * 1024).map(point).collect();
        let cloud = ChunkedCloud::new((&points).into());
        let mut counts = [0; 2];
        for group in &cloud.groups {
            let found = pulp::Arch::new().dispatch(Touching { group, frustum: &frustum });
            for block in 0..GROUP {
                let drawn = group.drawn >> block & 1 == 1;
                let expected = drawn && frustum.touches(&group.block(block));
                assert_eq!(found >> block & 1 == 1, expected, "{block}");
                counts[usize::from(expected)] += 1;
            }
        }
        assert!(counts.iter().all(|count| *count > 3), "{counts:?}");
    }
}
