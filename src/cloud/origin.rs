//! Origin that is subtracted from `f64` positions before they become `f32`.
//!
//! # How it works
//! Positions vote for cells of [`CELL_M`]. The origin is the first position in the cell with the most votes,
//! in whole meters, so neither a single point nor a run of equal points (invalid returns at a constant
//! position) can move it. A map of bounded size counts the votes (Misra–Gries), so that scattered points
//! cannot fill the memory.
//!
//! # Precision
//! Rounding a coordinate to `f32` at distance d from the origin changes it by at most d · 2⁻²⁴: 0.25 mm
//! within the winning cell, 0.5 mm up to [`PRECISE_WITHIN_M`], and 0.06 mm per kilometer beyond.
//! [`Precision`] counts the points beyond.

use glam::DVec3;
use rustc_hash::FxHashMap;

use crate::geometry::is_position;

/// Side of a cell, meters. Also the distance from zero up to which no origin is needed.
const CELL_M: f64 = 4096.0;
/// Distance along an axis up to which positions relative to an origin are precise to 0.5 mm in `f32`, meters.
pub const PRECISE_WITHIN_M: f64 = 16_384.0;
/// Maximum number of cells counted at a time.
const MAX_CELLS: usize = 4096;

/// Returns the origin for positions in meters: near most of them, in whole meters. Zero if most lie within
/// 4096 m of zero. Positions that are not finite, beyond every place on Earth, or exactly zero (invalid
/// returns) do not count.
pub fn origin_of(positions: impl IntoIterator<Item = DVec3>) -> DVec3 {
    let mut votes = Votes::default();
    positions.into_iter().for_each(|position| votes.add(position));
    votes.origin()
}

/// Returns a position relative to an origin in single precision; `None` if it is not finite there.
pub fn local_position(position: DVec3, origin: DVec3) -> Option<[f32; 3]> {
    let local = (position - origin).as_vec3();
    local.is_finite().then(|| local.to_array())
}

/// Counts positions by cells.
#[derive(Debug, Default)]
pub(super) struct Votes {
    cells: FxHashMap<[i32; 3], Cell>,
    added: usize,
}

#[derive(Debug)]
struct Cell {
    votes: usize,
    /// Number of the vote that created the cell, which breaks ties.
    number: usize,
    first: DVec3,
    last: DVec3,
}

impl Votes {
    /// Adds a position in meters.
    pub(super) fn add(&mut self, position: DVec3) {
        if !is_position(position) || position == DVec3::ZERO {
            return;
        }
        self.added += 1;
        let cell = (position / CELL_M).round().to_array().map(|index| index as i32);
        let new = || Cell { votes: 0, number: self.added, first: position, last: DVec3::NAN };
        let found = self.cells.entry(cell).or_insert_with(new);
        if found.last != position {
            found.votes += 1;
            found.last = position;
        }
        if self.cells.len() > MAX_CELLS {
            self.cells.retain(|_, cell| {
                cell.votes -= 1;
                cell.votes > 0
            });
        }
    }

    /// Returns the origin, as [`origin_of`].
    pub(super) fn origin(&self) -> DVec3 {
        let most = self.cells.values().max_by_key(|cell| (cell.votes, std::cmp::Reverse(cell.number)));
        most.map(|cell| cell.first)
            .filter(|first| first.abs().max_element() > CELL_M)
            .map_or(DVec3::ZERO, DVec3::round)
    }
}

/// Points beyond [`PRECISE_WITHIN_M`] of their origin.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Precision {
    /// Number of such points.
    pub far_points: usize,
    /// Maximum rounding error of their coordinates, meters.
    pub error_m: f64,
}

impl Precision {
    /// Counts a point that [`local_position`] returned, meters.
    pub fn add(&mut self, local: [f32; 3]) {
        let far_m = local.iter().fold(0.0_f32, |far, v| far.max(v.abs()));
        if f64::from(far_m) > PRECISE_WITHIN_M {
            self.far_points += 1;
            self.error_m = self.error_m.max(f64::from(far_m.next_up() - far_m) / 2.0);
        }
    }

    /// Returns a sentence on the far points; `None` without any. `origin` is what was subtracted, in meters,
    /// of positions in double precision.
    pub fn note(&self, points: usize, origin: Option<DVec3>) -> Option<String> {
        let Self { far_points, error_m } = self;
        let from = match origin {
            Some(DVec3 { x, y, z }) => format!("the origin ({x}, {y}, {z}), near which most points lie"),
            None => "zero in single precision".to_owned(),
        };
        let error = if *error_m < 1e4 { format!("{error_m:.3}") } else { format!("{error_m:.0e}") };
        (*far_points > 0).then(|| {
            format!(
                "{far_points} of {points} points lie more than {PRECISE_WITHIN_M} m from {from}: rounded by \
                    up to {error} m"
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Returns points of a scene at UTM coordinates.
    fn scene(count: u32) -> Vec<DVec3> {
        let at = |i: u32| {
            DVec3::new(691_600.0 + f64::from(i * 7 % 31), 5_335_790.0 + f64::from(i * 3 % 17), 520.25)
        };
        (0..count).map(at).collect()
    }

    #[test]
    fn invalid_points_do_not_move_the_origin() {
        let points = scene(400);
        let expected = points[0].round();
        assert_eq!(origin_of(points.iter().copied()), expected);
        let invalid = [
            DVec3::ZERO,
            DVec3::new(0.0, 0.0, -1e20),
            DVec3::new(f64::INFINITY, 0.0, 0.0),
            DVec3::NAN,
            DVec3::splat(-9999.0),
            DVec3::new(1e-3, 0.0, 2.0),
        ];
        for invalid in invalid {
            // Alone first, alone last, and as many as there are points, first.
            for (before, after) in [(1, 0), (0, 1), (400, 0)] {
                let all = std::iter::repeat_n(invalid, before).chain(points.iter().copied());
                let all = all.chain(std::iter::repeat_n(invalid, after));
                assert_eq!(origin_of(all), expected, "{before} times {invalid} before, {after} after");
            }
        }
    }

    #[test]
    fn origin_is_in_the_city_with_most_points() {
        let berlin = scene(300).into_iter().map(|p| p + DVec3::new(-300_000.0, 480_000.0, 0.0));
        let all: Vec<DVec3> = berlin.chain(scene(301)).collect();
        assert_eq!(origin_of(all), scene(1)[0].round());
        // A median by component would lie in neither.
        assert_eq!(origin_of([]), DVec3::ZERO);
    }

    #[test]
    fn coordinates_near_zero_need_no_origin() {
        let near = (0..100).map(|i| DVec3::new(f64::from(i) * 80.0 - 4000.0, 10.0, 0.0));
        assert_eq!(origin_of(near.chain(scene(20))), DVec3::ZERO);
    }

    #[test]
    fn scattered_points_take_bounded_memory() {
        let mut votes = Votes::default();
        let scattered = |i: u32| DVec3::new(f64::from(i) * 5000.0 - 5e7, f64::from(i % 7) * 1e6, 0.0);
        for i in 0..20_000 {
            votes.add(scattered(i));
            if i % 4 == 0 {
                votes.add(scene(i + 1)[i as usize]);
            }
            assert!(votes.cells.len() <= MAX_CELLS);
        }
        assert_eq!(votes.origin(), scene(1)[0].round());
    }

    #[test]
    fn far_points_are_counted_with_their_error() {
        let mut precision = Precision::default();
        for local in [[0.0; 3], [16_384.0, -16_384.0, 0.0], [16_385.0, 0.0, 0.0], [0.0, -700_000.0, 1.0]] {
            precision.add(local);
        }
        assert_eq!(precision, Precision { far_points: 2, error_m: 0.03125 });
        let note = precision.note(4, Some(DVec3::new(7e5, 1.0, 2.0))).unwrap();
        assert_eq!(
            note,
            "2 of 4 points lie more than 16384 m from the origin (700000, 1, 2), near which most points lie: \
                rounded by up to 0.031 m"
        );
        assert_eq!(Precision::default().note(4, None), None);
    }

    proptest! {
        /// The documented bound of the rounding error.
        #[test]
        fn precise_positions_are_off_by_less_than_half_a_millimeter(
            at in prop::array::uniform3(-1e7..1e7_f64),
            offset in prop::array::uniform3(-PRECISE_WITHIN_M..PRECISE_WITHIN_M),
        ) {
            let origin = DVec3::from(at).round();
            let position = origin + DVec3::from(offset);
            let local = local_position(position, origin).unwrap();
            let off = DVec3::from(local.map(f64::from)) + origin - position;
            prop_assert!(off.abs().max_element() <= 0.000_5, "{off}");
        }
    }
}
