//! Morton (Z-order) sorting, which places points that are close in space close in memory.

use rayon::prelude::*;

use super::{Bounds, Point};

/// Number of cells along the longest side of the bounds.
const CELLS: f32 = 1024.0;

/// Returns the point indices in Morton order over cubic cells, 1024 along the longest side of the bounds.
/// Points of one cell keep their order. `None` if the points are already sorted. Does not depend on the
/// number of threads.
pub(crate) fn morton_order(points: &[Point], bounds: &Bounds) -> Option<Vec<u32>> {
    let side = (0..3).map(|axis| bounds.max[axis] - bounds.min[axis]).fold(0.0, f32::max);
    let cells_per_m = if side > 0.0 { CELLS / side } else { 0.0 };
    let code = |point: &Point| {
        let cell =
            |axis: usize| ((point.position[axis] - bounds.min[axis]) * cells_per_m).min(CELLS - 1.0) as u32;
        spread(cell(0)) | spread(cell(1)) << 1 | spread(cell(2)) << 2
    };
    let ordered = points.par_windows(2).all(|pair| code(&pair[0]) <= code(&pair[1]));
    if ordered {
        return None;
    }
    let key = |(index, point): (usize, &Point)| u64::from(code(point)) << 32 | index as u64;
    let mut keys: Vec<u64> = points.par_iter().enumerate().map(key).collect();
    keys.par_sort_unstable();
    Some(keys.into_par_iter().map(|key| key as u32).collect())
}

/// Sorts points in Morton order, as renderers are fastest with. Points of one cell, of 1024 along the longest
/// side of the bounds, keep their order.
pub fn sort_in_space(points: &mut Vec<Point>) {
    if let Some(order) = Bounds::of_finite(points).and_then(|bounds| morton_order(points, &bounds)) {
        *points = order.into_par_iter().map(|index| points[index as usize]).collect();
    }
}

/// Spreads the low ten bits to every third bit of thirty.
fn spread(value: u32) -> u32 {
    let v = value & 0x3ff;
    let v = (v | v << 16) & 0x0300_00ff;
    let v = (v | v << 8) & 0x0300_f00f;
    let v = (v | v << 4) & 0x030c_30c3;
    (v | v << 2) & 0x0924_9249
}

#[cfg(test)]
mod tests {
    use super::*;

    fn order(positions: &[[f32; 3]]) -> Option<Vec<u32>> {
        let points: Vec<Point> = positions.iter().map(|p| Point::new(*p, [0; 3], 0)).collect();
        morton_order(&points, &Bounds::of(&points).unwrap())
    }

    #[test]
    fn bits_are_spread() {
        assert_eq!(spread(0b11_1111_1111), 0o1_111_111_111);
        assert_eq!(spread(0b101), 0b100_0001);
    }

    #[test]
    fn cube_corners_sort_by_their_bits() {
        let corner = |i: u32| [0, 1, 2].map(|axis| if i >> axis & 1 == 1 { 1.0 } else { 0.0 });
        let sorted: Vec<[f32; 3]> = (0..8).map(corner).collect();
        assert_eq!(order(&sorted), None);
        let reversed: Vec<[f32; 3]> = (0..8).rev().map(corner).collect();
        assert_eq!(order(&reversed), Some(vec![7, 6, 5, 4, 3, 2, 1, 0]));
    }

    #[test]
    fn points_are_sorted_in_place() {
        let point = |x: f32| Point::new([x, 0.0, 0.0], [x as u8; 3], 0);
        let mut points: Vec<Point> = [5.0, 1.0, 3.0].map(point).into();
        sort_in_space(&mut points);
        assert_eq!(points, [1.0, 3.0, 5.0].map(point));
        sort_in_space(&mut points);
        sort_in_space(&mut Vec::new());
        assert_eq!(points, [1.0, 3.0, 5.0].map(point));
    }

    #[test]
    fn equal_points_keep_their_order_and_nan_is_accepted() {
        assert_eq!(order(&[[1.0; 3], [0.0; 3], [1.0; 3], [0.0; 3]]), Some(vec![1, 3, 0, 2]));
        assert_eq!(order(&[[5.0; 3]; 3]), None);
        let order = order(&[[1.0; 3], [f32::NAN; 3], [0.0; 3]]).unwrap();
        assert_eq!(order.len(), 3);
    }
}
