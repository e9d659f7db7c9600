//! Choice of how points cover more than their own pixels.

use super::passes::passes;
use super::plan::PlannedItem;
use super::resolve::MAX_GATHERED_RADIUS;
use crate::raster::SplatSchedule;

/// How points cover more than their own pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Coverage {
    /// Radii are small: the resolve shaders gather the neighborhood.
    Gathered,
    /// Points are few: each draws its square.
    Drawn,
    /// Each point writes its own pixel, then keys are spread.
    Spread,
}

/// Cost of a pixel in a pass, relative to an atomic minimum.
const PASS_COST: u64 = 2;

impl Coverage {
    /// Returns the cheapest method for these points and this number of key pixels.
    pub(super) fn choose(schedule: &SplatSchedule, items: &[PlannedItem], key_pixels: u64) -> Self {
        if schedule.max_radius() <= MAX_GATHERED_RADIUS {
            return Self::Gathered;
        }
        let square = |item: &PlannedItem| {
            let [first, end] = item.points;
            let radius = schedule.steps().iter().find(|step| item.nearest_m <= step.z_max_m);
            let side = radius.map_or(0, |step| 2 * u64::from(step.radius) + 1);
            u64::from(end - first) * side * side
        };
        let drawn: u64 = items.iter().map(square).sum();
        let spread = key_pixels * passes(schedule).len() as u64 * PASS_COST;
        if drawn <= spread { Self::Drawn } else { Self::Spread }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_points_draw_their_squares_and_many_are_spread() {
        let item = |points, nearest_m| PlannedItem {
            draw: 0,
            cloud: 0,
            chunk: 0,
            points: [0, points],
            crop: false,
            nearest_m,
        };
        let choose = |schedule: &str, items: &[PlannedItem]| {
            Coverage::choose(&schedule.parse().unwrap(), items, 1_000_000)
        };
        let many = vec![item(4096, 1.0); 1000];
        assert_eq!(choose("9:2", &many), Coverage::Gathered);
        assert_eq!(choose("9:31", &many), Coverage::Spread);
        assert_eq!(choose("9:31", &[item(1000, 1.0)]), Coverage::Drawn);
        // Distant points have small squares.
        assert_eq!(choose("0.5:31,9:0", &many), Coverage::Drawn);
    }
}
