//! Accumulated points of a voxel.
//!
//! Sums are integers, so they do not depend on the order of points or merges.

use bytemuck::{Pod, Zeroable};
use glam::DVec3;

use crate::cloud::Point;

/// Accumulated points of a voxel, in their file layout.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub(super) struct VoxelSum {
    /// Key of the voxel; sorts in Morton order, so that points of neighboring voxels are neighbors in files.
    pub(super) key: u64,
    /// Sum of offsets from the voxel's corner, in steps of 1 / [`STEPS_PER_M`] meters.
    offset: [i64; 3],
    rgb: [u64; 3],
    count: u64,
}

impl VoxelSum {
    /// Adds two sums of the same voxel.
    fn plus(self, other: Self) -> Self {
        Self {
            key: self.key,
            offset: std::array::from_fn(|axis| self.offset[axis] + other.offset[axis]),
            rgb: std::array::from_fn(|channel| self.rgb[channel] + other.rgb[channel]),
            count: self.count + other.count,
        }
    }
}

/// Steps per meter: a step is 0.2 nm, and the sum of a million points in a voxel of a kilometer fits 64 bits.
const STEPS_PER_M: f64 = (1_u64 << 32) as f64;

/// Voxel grid around an origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Voxels {
    /// Side, meters; 0 if every point is its own voxel.
    pub(super) side_m: f64,
}

impl Voxels {
    /// Returns the sum of a single point at a position relative to its cell's origin, meters. `place` is the
    /// point's global number, which sorts points if none are merged.
    pub(super) fn sum(self, position: DVec3, rgb: [u8; 3], place: u64) -> VoxelSum {
        let (key, corner) = if self.side_m > 0.0 {
            let index = (position / self.side_m).floor();
            (key(index), index * self.side_m)
        } else {
            (place, DVec3::ZERO)
        };
        let steps = |m: f64| (m * STEPS_PER_M).round() as i64;
        let offset = (position - corner).to_array().map(steps);
        VoxelSum { key, offset, rgb: rgb.map(u64::from), count: 1 }
    }

    /// Returns the mean of a voxel's points, relative to the cell's origin.
    pub(super) fn mean(self, sum: &VoxelSum, class: u8) -> Point {
        let corner = if self.side_m > 0.0 { index(sum.key) * self.side_m } else { DVec3::ZERO };
        let offset = DVec3::from(sum.offset.map(|o| o as f64 / STEPS_PER_M)) / sum.count as f64;
        let rgb = sum.rgb.map(|s| ((s + sum.count / 2) / sum.count) as u8);
        Point::new((corner + offset).as_vec3().to_array(), rgb, class)
    }
}

/// Number of voxels to each side of the origin along an axis.
const REACH: i64 = 1 << 20;
const AXIS: u64 = (1 << 21) - 1;

/// Interleaves a voxel index with 21 bits per axis.
fn key(index: DVec3) -> u64 {
    let axis = |i: f64| spread((i as i64).saturating_add(REACH).clamp(0, AXIS as i64) as u64);
    axis(index.x) | axis(index.y) << 1 | axis(index.z) << 2
}

fn index(key: u64) -> DVec3 {
    let axis = |shift: u32| (gather(key >> shift) as i64 - REACH) as f64;
    DVec3::new(axis(0), axis(1), axis(2))
}

/// Masks of [`spread`]: the bits after each step.
const STEPS: [(u32, u64); 5] = [
    (32, 0x001f_0000_0000_ffff),
    (16, 0x001f_0000_ff00_00ff),
    (8, 0x100f_00f0_0f00_f00f),
    (4, 0x10c3_0c30_c30c_30c3),
    (2, 0x1249_2492_4924_9249),
];

/// Spreads the low 21 bits to every third bit.
fn spread(value: u64) -> u64 {
    STEPS.iter().fold(value & AXIS, |bits, (shift, mask)| (bits | bits << shift) & mask)
}

/// Returns every third bit: the inverse of [`spread`].
fn gather(bits: u64) -> u64 {
    let masks = STEPS.iter().rev().skip(1).map(|(_, mask)| *mask).chain([AXIS]);
    let steps = STEPS.iter().rev().map(|(shift, _)| *shift).zip(masks);
    steps.fold(bits & STEPS[4].1, |bits, (shift, mask)| (bits | bits >> shift) & mask)
}

/// Sorts by voxel and merges sums of the same voxel.
pub(super) fn merge(mut sums: Vec<VoxelSum>) -> Vec<VoxelSum> {
    sums.sort_unstable_by_key(|sum| sum.key);
    merge_equal(&mut sums);
    sums
}

/// Merges the sums of several lists, each sorted by voxel, one after the other.
pub(super) fn merge_sorted(mut sums: Vec<VoxelSum>) -> Vec<VoxelSum> {
    // A stable sort finds the lists and merges them.
    sums.sort_by_key(|sum| sum.key);
    merge_equal(&mut sums);
    sums
}

/// Merges neighbors of the same voxel.
fn merge_equal(sums: &mut Vec<VoxelSum>) {
    sums.dedup_by(|next, retained| {
        let same = next.key == retained.key;
        if same {
            *retained = retained.plus(*next);
        }
        same
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const VOXELS: Voxels = Voxels { side_m: 0.01 };

    fn sum(x: f64, y: f64, z: f64, grey: u8) -> VoxelSum {
        VOXELS.sum(DVec3::new(x, y, z), [grey; 3], 0)
    }

    #[test]
    fn a_voxel_holds_the_mean_of_its_points() {
        let sums =
            vec![sum(0.004, 0.003, 0.002, 20), sum(0.001, 0.001, -0.001, 9), sum(0.002, 0.001, 0.0, 10)];
        let points: Vec<Point> = merge(sums).iter().map(|s| VOXELS.mean(s, 1)).collect();
        let near = |p: &Point, at: [f32; 3]| (0..3).all(|i| (p.position[i] - at[i]).abs() < 1e-8);
        assert!(points.len() == 2 && near(&points[0], [0.001, 0.001, -0.001]));
        assert!(near(&points[1], [0.003, 0.002, 0.001]), "{:?}", points[1]);
        assert_eq!((points[0].rgb(), points[1].rgb(), points[1].class()), ([9; 3], [15; 3], 1));
    }

    #[test]
    fn without_voxels_points_keep_their_order() {
        let voxels = Voxels { side_m: 0.0 };
        let at = |i: u64| DVec3::new(31.9 - i as f64, -20.0, 1e-4);
        let sums: Vec<VoxelSum> = (0..30).rev().map(|i| voxels.sum(at(i), [i as u8; 3], i)).collect();
        let points: Vec<Point> = merge(sums).iter().map(|s| voxels.mean(s, 0)).collect();
        for (i, point) in (0..).zip(&points) {
            // Rounding error of f32 at 32 m.
            let off = DVec3::from(point.position.map(f64::from)) - at(i);
            assert!(off.abs().max_element() < 2e-6 && point.rgb() == [i as u8; 3], "{off}");
        }
    }

    #[test]
    fn keys_interleave_the_bits_of_voxels() {
        let corner = |x: f64, y: f64, z: f64| key(DVec3::new(x, y, z)) - key(DVec3::ZERO);
        assert_eq!([corner(1.0, 0.0, 0.0), corner(0.0, 1.0, 0.0), corner(5.0, 0.0, 1.0)], [1, 2, 0o105]);
        let lowest = DVec3::splat(-(REACH as f64));
        assert_eq!((key(lowest), key(-lowest)), (0, (1 << 63) - 1));
    }

    proptest! {
        #[test]
        fn keys_are_voxels(x in -REACH..REACH, y in -REACH..REACH, z in -REACH..REACH) {
            let voxel = DVec3::new(x as f64, y as f64, z as f64);
            prop_assert_eq!(index(key(voxel)), voxel);
        }

        /// Partitioning and merging in any order gives the same sums, with distinct voxels.
        #[test]
        fn merging_in_parts_changes_nothing(
            points in proptest::collection::vec((-0.03..0.03_f64, -0.03..0.03_f64, any::<u8>()), 1..200),
            parts in 1..5_usize,
        ) {
            let sums: Vec<VoxelSum> = points.iter().map(|(x, y, grey)| sum(*x, *y, 0.5, *grey)).collect();
            let whole = merge(sums.clone());
            let dealt = (0..parts).map(|p| merge(sums.iter().copied().skip(p).step_by(parts).collect()));
            prop_assert_eq!(&merge_sorted(dealt.flatten().collect()), &whole);
            prop_assert!(whole.windows(2).all(|pair| pair[0].key < pair[1].key));
            prop_assert_eq!(whole.iter().map(|s| s.count).sum::<u64>(), points.len() as u64);
        }
    }
}
