//! Blocks of sums, as runs store them.
//!
//! # How it works
//! Most bytes of a sum are zero, or equal to the previous sum's. So keys are replaced by their differences,
//! the bytes of a block are ordered by their place in a sum, and the result is compressed. A sum of 64 bytes
//! then takes about 18.

use bytemuck::Zeroable;

use super::sums::VoxelSum;

/// Number of sums in a block.
pub(super) const BLOCK: usize = 16_384;

const SUM_BYTES: usize = size_of::<VoxelSum>();
/// Number of sums whose bytes are ordered at once: they fit the nearest cache.
const TILE: usize = 64;

/// Compresses sums that are sorted by voxel, at least one.
pub(super) fn encode(sums: &[VoxelSum]) -> Vec<u8> {
    let mut planes = vec![0; size_of_val(sums)];
    let mut before = 0;
    for (first, some) in (0..).step_by(TILE).zip(sums.chunks(TILE)) {
        let mut differences = [VoxelSum::zeroed(); TILE];
        for (to, sum) in differences.iter_mut().zip(some) {
            *to = *sum;
            to.key -= before;
            before = sum.key;
        }
        let bytes: &[[u8; SUM_BYTES]] = bytemuck::cast_slice(&differences);
        for (plane, to) in planes.chunks_exact_mut(sums.len()).enumerate() {
            let to = &mut to[first..first + some.len()];
            to.iter_mut().zip(bytes).for_each(|(to, bytes)| *to = bytes[plane]);
        }
    }
    lz4_flex::block::compress(&planes)
}

/// Returns a number of compressed sums, at least one; `None` if these are none.
pub(super) fn decode(bytes: &[u8], count: usize) -> Option<Vec<VoxelSum>> {
    let planes = lz4_flex::block::decompress(bytes, count * SUM_BYTES).ok()?;
    if count == 0 || planes.len() != count * SUM_BYTES {
        return None;
    }
    let mut sums = vec![VoxelSum::zeroed(); count];
    for (first, some) in (0..).step_by(TILE).zip(sums.chunks_mut(TILE)) {
        let bytes: &mut [[u8; SUM_BYTES]] = bytemuck::cast_slice_mut(some);
        for (plane, from) in planes.chunks_exact(count).enumerate() {
            let from = &from[first..first + bytes.len()];
            bytes.iter_mut().zip(from).for_each(|(bytes, from)| bytes[plane] = *from);
        }
    }
    let mut key = 0_u64;
    for sum in &mut sums {
        key = key.wrapping_add(sum.key);
        sum.key = key;
    }
    Some(sums)
}

#[cfg(test)]
mod tests {
    use super::super::sums::{Voxels, merge};
    use super::*;
    use glam::DVec3;
    use proptest::prelude::*;

    #[test]
    fn single_points_take_a_third() {
        let voxels = Voxels { side_m: 0.01 };
        let at = |i: usize| DVec3::from([7, 11, 13].map(|step| (i * step % 997) as f64 * 0.0311));
        let sums = (0..BLOCK).map(|i| voxels.sum(at(i), [(i * 5) as u8, (i * 3) as u8, i as u8], 0));
        let sums = merge(sums.collect());
        let bytes = encode(&sums).len();
        assert!(bytes < 22 * sums.len(), "{} sums in {bytes} bytes", sums.len());
    }

    #[test]
    fn no_other_bytes_are_sums() {
        let bytes = encode(&[VoxelSum::zeroed(); 3]);
        assert_eq!(decode(&bytes, 3), Some(vec![VoxelSum::zeroed(); 3]));
        assert_eq!((decode(&bytes, 2), decode(&bytes, 4), decode(b"none", 3)), (None, None, None));
    }

    proptest! {
        #[test]
        fn sums_round_trip(
            points in proptest::collection::vec((-31.0..31.0_f64, -31.0..31.0_f64, any::<u8>()), 1..300),
            side_m in prop_oneof![Just(0.0), Just(0.01), Just(5.0)],
        ) {
            let numbered = (0..).zip(&points);
            let voxels = Voxels { side_m };
            let sum = |(i, (x, y, grey)): (u64, &(f64, f64, u8))| {
                voxels.sum(DVec3::new(*x, *y, -0.5), [*grey; 3], i << 32)
            };
            let sums = merge(numbered.map(sum).collect());
            prop_assert_eq!(decode(&encode(&sums), sums.len()), Some(sums));
        }
    }
}
