use rustc_hash::FxHashMap;

/// Returns the indices of points that are at least `spacing_m` apart, ascending (Poisson-disk thinning by
/// dart throwing). Each point in turn is taken unless a taken point is nearer. Every skipped point has a
/// taken point within `spacing_m`.
pub fn poisson_thin(points: impl IntoIterator<Item = [f32; 3]>, spacing_m: f64) -> Vec<usize> {
    let mut taken: FxHashMap<[i32; 3], Vec<[f32; 3]>> = FxHashMap::default();
    let mut retained = Vec::new();
    let cell = |p: [f32; 3]| p.map(|v| (f64::from(v) / spacing_m).floor() as i32);
    for (index, point) in points.into_iter().enumerate() {
        let at = cell(point);
        let near = |other: &[f32; 3]| squared_distance(*other, point) < spacing_m * spacing_m;
        if neighbourhood(at).any(|c| taken.get(&c).is_some_and(|others| others.iter().any(near))) {
            continue;
        }
        taken.entry(at).or_default().push(point);
        retained.push(index);
    }
    retained
}

/// Returns a grid cell and its 26 neighbors.
pub(super) fn neighbourhood(cell: [i32; 3]) -> impl Iterator<Item = [i32; 3]> {
    (0..27).map(move |i| {
        let step = [i / 9, i / 3 % 3, i % 3];
        std::array::from_fn(|axis| cell[axis].saturating_add(step[axis] - 1))
    })
}

pub(super) fn squared_distance(a: [f32; 3], b: [f32; 3]) -> f64 {
    (0..3).map(|axis| f64::from(a[axis]) - f64::from(b[axis])).map(|d| d * d).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn points_keep_their_distance_and_cover_the_rest(
            points in prop::collection::vec(prop::array::uniform3(-0.3_f32..0.3), 1..300),
            spacing_m in 0.02_f64..0.4,
        ) {
            let retained = poisson_thin(points.iter().copied(), spacing_m);
            let nearest = |of: usize| {
                let others = retained.iter().filter(|k| **k != of);
                others.map(|k| squared_distance(points[*k], points[of]).sqrt()).fold(f64::INFINITY, f64::min)
            };
            for index in 0..points.len() {
                let is_first = index == retained[0];
                prop_assert_eq!(retained.contains(&index), is_first || nearest(index) >= spacing_m || {
                    // A later point may be near, since the earlier one was taken.
                    let before = retained.iter().filter(|k| **k < index);
                    before.clone().all(|k| squared_distance(points[*k], points[index]).sqrt() >= spacing_m)
                });
                if retained.contains(&index) {
                    prop_assert!(nearest(index) >= spacing_m);
                }
            }
        }
    }

    #[test]
    fn far_points_do_not_overflow() {
        let far = [[1e30, 0.0, 0.0], [1e30, 0.0, 0.0], [f32::MIN, 0.0, 0.0], [0.0; 3]];
        assert_eq!(poisson_thin(far, 0.01), [0, 2, 3]);
    }
}
