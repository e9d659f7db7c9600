//! Borders of lanes, from their centerlines and outlines.

use glam::DVec2;
use point_skeleton::dataset::Lane;
use point_skeleton::geometry::Polyline;

/// Half the width of lanes whose outline does not enclose their centerline, meters.
const DEFAULT_HALF_WIDTH_M: f64 = 1.75;
/// Largest distance of a border from the centerline, meters: connectors of some maps have the outline of the
/// whole intersection.
const MAX_HALF_WIDTH_M: f64 = 5.0;

/// Returns the left and the right border of a lane, with a point for each point of its centerline, which is
/// midway between them. `None` without a centerline.
pub(super) fn rails(lane: &Lane) -> Option<[Vec<DVec2>; 2]> {
    let line = Polyline::new(lane.centerline.iter().copied())?;
    let points = line.points();
    let pieces: Vec<(DVec2, f64)> = points
        .windows(2)
        .map(|ends| {
            let left = (ends[1] - ends[0]).normalize().perp();
            (left, half_width(&lane.outline.exterior, ends[0].midpoint(ends[1]), left))
        })
        .collect();
    let offset = |i: usize| {
        let around = &pieces[i.saturating_sub(1)..(i + 1).min(pieces.len())];
        let left: DVec2 = around.iter().map(|(left, _)| *left).sum();
        // Pieces that turn back have no common direction.
        let left = left.try_normalize().unwrap_or(around[0].0);
        left * around.iter().map(|(_, width)| width).sum::<f64>() / around.len() as f64
    };
    let side = |sign: f64| points.iter().enumerate().map(|(i, point)| point + sign * offset(i)).collect();
    Some([side(1.0), side(-1.0)])
}

/// Returns half the width of an outline at a point, measured along a direction, meters.
fn half_width(outline: &[DVec2], at: DVec2, left: DVec2) -> f64 {
    let [mut nearest_left, mut nearest_right] = [f64::INFINITY; 2];
    for (from, to) in outline.iter().zip(outline.iter().cycle().skip(1)) {
        let (edge, offset) = (to - from, from - at);
        let sine = left.perp_dot(edge);
        let (distance, along) = (offset.perp_dot(edge) / sine, offset.perp_dot(left) / sine);
        // Not a number for parallel edges.
        if !(0.0..=1.0).contains(&along) || !distance.is_finite() {
            continue;
        }
        let nearest = if distance < 0.0 { &mut nearest_right } else { &mut nearest_left };
        *nearest = nearest.min(distance.abs());
    }
    let width = nearest_left + nearest_right;
    if width.is_finite() { (0.5 * width).min(MAX_HALF_WIDTH_M) } else { DEFAULT_HALF_WIDTH_M }
}

#[cfg(test)]
mod tests {
    use super::*;
    use point_skeleton::dataset::Area;

    fn lane(centerline: &[[f64; 2]], exterior: &[[f64; 2]]) -> Lane {
        let points = |of: &[[f64; 2]]| of.iter().map(|point| DVec2::from_array(*point)).collect();
        let outline = Area { exterior: points(exterior), holes: Vec::new() };
        Lane { id: "lane".into(), outline, centerline: points(centerline), successors: Vec::new() }
    }

    #[test]
    fn borders_follow_the_outline() {
        // From 3 m to 4 m wide, with a centerline that is not in the middle.
        let outline = [[0.0, -1.0], [10.0, -1.0], [10.0, 3.0], [0.0, 2.0]];
        let [left, right] = rails(&lane(&[[0.0, 0.0], [5.0, 0.0], [10.0, 0.0]], &outline)).unwrap();
        assert_eq!(
            left.iter().map(|p| p.to_array()).collect::<Vec<_>>(),
            [[0.0, 1.625], [5.0, 1.75], [10.0, 1.875]]
        );
        for (left, right) in left.iter().zip(&right) {
            assert_eq!(left.midpoint(*right).y, 0.0);
        }
    }

    #[test]
    fn borders_of_bends_are_across_the_centerline() {
        let outline = [[0.0, -2.0], [12.0, -2.0], [12.0, 10.0], [8.0, 10.0], [8.0, 2.0], [0.0, 2.0]];
        let [left, right] = rails(&lane(&[[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]], &outline)).unwrap();
        assert!(left[0].distance(DVec2::new(0.0, 2.0)) < 1e-12);
        assert!(left[1].distance(DVec2::new(10.0, 0.0) + DVec2::new(-1.0, 1.0) * 2f64.sqrt()) < 1e-12);
        assert!(right[2].distance(DVec2::new(12.0, 10.0)) < 1e-12);
    }

    #[test]
    fn lanes_without_a_usable_outline_have_a_usual_width() {
        let line = [[0.0, 0.0], [10.0, 0.0]];
        let aside = [[0.0, 20.0], [10.0, 20.0], [10.0, 30.0]];
        assert_eq!(rails(&lane(&line, &aside)).unwrap()[0][1], DVec2::new(10.0, 1.75));
        let square = [[-50.0, -50.0], [50.0, -50.0], [50.0, 50.0], [-50.0, 50.0]];
        assert_eq!(rails(&lane(&line, &square)).unwrap()[1][0], DVec2::new(0.0, -5.0));
        assert_eq!(rails(&lane(&[], &square)), None);
    }
}
